// Overlays: a light alone, or a plane of the run in the place of the picture, each with a legend.
import { model, on, say } from "./model.js";
import { view, renderer, redraw, cover, layerSize } from "./view.js";
import { roomBox, SIDES, HALF } from "./layers.js";
import { byId, make } from "./dom.js";
import { update as updateLights } from "./lights.js";
import * as api from "./api.js";

// Planes by the beginning of their names: mode of gl.js, title, legend, and the numbers at the ends of the scale.
const KINDS = [
  ["shadow_", "gray", "Shadow", "lit part, 0 to 1: white is lit"],
  ["unknown_", "guess", "Unknown part", "orange: visibility unknown, behind a depth edge or out of view"],
  ["room_error_", "guess", "Guessed part", "orange: standard error by guesses about the unseen room"],
  ["stderr_", "heat", "Standard error", "standard error of the shading's luminance"],
  ["direct_", "color", "Direct light", "irradiance / \u03c0 of this light, without bounces"],
  ["indirect_", "color", "Indirect light", "irradiance / \u03c0 of this light after bounces"],
  ["glare_", "color", "Glare", "light that the lens scatters"],
  ["filled", "guess", "Filled in", "orange: the photo does not show the surface here"],
  ["depth", "depth", "Depth", "planar distance, meters"],
  ["normal", "normal", "Normals", "red: right, green: up, blue: toward the camera"],
  ["albedo", "color", "Albedo", "diffuse reflectance, as sRGB"],
  ["rough", "gray", "Roughness", "GGX roughness, 0 to 1: white is dull"],
];
const kindOf = (name) => KINDS.find(([start]) => name === start || name.startsWith(start) && start.endsWith("_"));

const select = () => byId("show");

function options() {
  if (model.previewed) return; // the planes stay those of the last run
  const chosen = select().value;
  const group = (label, entries) => {
    const element = document.createElement("optgroup");
    element.label = label;
    element.append(...entries.map(([value, text]) => make("option", { value }, text)));
    return element;
  };
  const { lights = [], planes = [] } = model.manifest ?? {};
  const groups = [make("option", { value: "picture" }, "Picture")];
  groups.push(group("Alone", [...lights.map((each) => [`light ${each.id}`, `alone: ${each.id}`]), ["light rest", "alone: rest, which no light explains"]]));
  for (const kind of KINDS) {
    const found = planes.filter((each) => kindOf(each.name) === kind);
    if (found.length) groups.push(group(kind[2], found.map((each) => [`plane ${each.name}`, kind[0].endsWith("_") ? `${kind[2].toLowerCase()}: ${each.name.slice(kind[0].length)}` : kind[2].toLowerCase()])));
  }
  select().replaceChildren(...groups);
  select().value = [...select().options].some((each) => each.value === chosen) ? chosen : "picture";
  if (select().value !== chosen) show();
  else if (chosen.startsWith("plane ")) show();
}

let wanted;
async function show() {
  const [what, name] = select().value.split(" ");
  const solo = what === "light" ? name : undefined;
  if (solo || wanted?.startsWith("light ")) {
    view.solo.clear();
    if (solo) view.solo.add(solo);
    updateLights();
  }
  wanted = select().value;
  if (what !== "plane") {
    view.mode = "picture";
    view.plane = undefined;
    legend(solo ? [`${solo} alone`, "linear light of this layer, encoded as the photo is"] : undefined);
    return redraw();
  }
  const plane = model.manifest.planes.find((each) => each.name === name);
  const [, mode, title, text] = kindOf(name);
  try {
    const halves = await api.layer(plane.digest);
    if (wanted !== `plane ${name}`) return;
    const size = plane.size ?? model.manifest.size;
    renderer.setPlane(plane.digest, halves, ...size, plane.channels);
    const [low, high] = mode === "depth" ? range(halves, plane.scale) : [0, plane.white || 1];
    view.plane = { scale: plane.scale, low, high };
    view.mode = mode;
    legend([title, text], mode, low, high);
    redraw();
  } catch (error) {
    say(`${name} cannot be shown: ${error.message}`, true);
  }
}

// From the nearest to the farthest, but for one pixel in a hundred at each end.
function range(halves, scale) {
  const some = Array.from({ length: 2000 }, (_, k) => HALF[halves[Math.floor((k * halves.length) / 2000)]] * scale).filter(Number.isFinite).sort((a, b) => a - b);
  return [some[20] ?? 0, Math.max(some.at(-21) ?? 1, (some[20] ?? 0) + 0.01)];
}

const short = (x) => String(Number(x.toPrecision(3)));

function legend(words, mode, low, high) {
  const box = byId("legend");
  box.hidden = !words && !byId("room").checked;
  byId("legendtext").replaceChildren(...(words ? [make("b", {}, words[0]), ` ${words[1]}`] : []));
  const scale = mode && !["color", "normal"].includes(mode);
  byId("ramp").hidden = !scale;
  if (scale) {
    byId("ramp").className = mode;
    byId("ramp").replaceChildren(make("span", {}, mode === "depth" ? `${short(low)} m` : short(low)), make("span", {}, mode === "depth" ? `${short(high)} m` : short(high)));
  }
}

// ---- The room as a box -----------------------------------------------------------------------------------------------------

let box;
async function room() {
  const wants = byId("room").checked;
  byId("sides").hidden = !wants;
  box?.remove();
  box = undefined;
  if (wants) {
    try {
      const found = await api.getJson("/api/room");
      if (!found) { say("This graph finds no box of the room"); byId("room").checked = false; return room(); }
      if (!byId("room").checked) return;
      box?.remove();
      box = roomBox(found, ...layerSize());
      box.id = "roombox";
      byId("stage").insertBefore(box, byId("handles"));
      byId("sides").replaceChildren(...Object.entries(SIDES).flatMap(([name, color]) => {
        const dot = make("i", { class: "dot" });
        dot.style.background = color;
        return [dot, `${name.toLowerCase()} `];
      }), make("span", {}, found.summary ?? ""));
      cover(box);
    } catch (error) {
      say(`The room cannot be shown: ${error.message}`, true);
    }
  }
  byId("legend").hidden = !wants && byId("legendtext").textContent === "";
}

export function beginOverlays() {
  select().addEventListener("change", show);
  byId("room").addEventListener("change", room);
  on("layers", options);
  on("layers", () => { if (byId("room").checked) room(); });
  on("view", () => { if (box) cover(box); });
  on("restored", show);
}
