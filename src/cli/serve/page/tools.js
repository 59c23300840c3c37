// Tools on the picture: insert lamps, objects and windows, paint walls, brush masks, and handles to move what has a place.
import { model, on, emit, change, settle, preview, keepPreview, lights, say } from "./model.js";
import * as e from "./edit.js";
import { field, values, numbers, digits, quoted, number } from "./ron.js";
import { setTool, toStage, toPhoto, isInside, fullSize, cover } from "./view.js";
import { placeText } from "./lights.js";
import { brush } from "./brush.js";
import { byId, make, drawing, labelled } from "./dom.js";
import * as api from "./api.js";

const number_ = (name, value, attributes = {}) => make("input", { type: "number", value, step: "any", "aria-label": name, ...attributes });
const known = () => (model.server?.lights ?? []).map((each) => each.id);
const rounded = ({ x, y }) => ({ x: Math.round(x), y: Math.round(y) });

// Adds something, where the text can be read.
function insert(f, what) {
  if (model.edit.error) return say("The text of the edit cannot be read; mend it first", true);
  settle();
  change(f(model.text));
  settle();
  say(`${what} inserted`);
}

// ---- The tools -----------------------------------------------------------------------------------------------------------------

// A tool: { name, key, hint, options (elements), click(point), .. } as view.js uses it.
function lamp() {
  const form = make("select", { "aria-label": "form" }, ...[["Sphere", "globe"], ["Box", "tube or box"], ["Rect", "panel, light down"], ["Mesh", "model"]].map(([value, text]) => make("option", { value }, text)));
  const size = number_("size in meters", 0.06, { min: 0.001, step: 0.01 });
  const path = make("input", { type: "text", placeholder: "lantern.obj", "aria-label": "path of the model, from the edit's folder" });
  const flux = number_("lumens", 800, { min: 0, step: 50 });
  const kelvin = number_("kelvin", 2700, { min: 1000, max: 40000, step: 100 });
  const lift = number_("height above the surface in meters", 0, { min: 0, step: 0.05 });
  const pathField = labelled("file", path);
  pathField.hidden = true;
  form.addEventListener("change", () => {
    pathField.hidden = form.value !== "Mesh";
    size.value = { Sphere: 0.06, Box: 0.2, Rect: 0.25, Mesh: 0.3 }[form.value];
  });
  const shape = () => {
    const s = Number(size.value) || 0.06;
    switch (form.value) {
      case "Box": return `Box(half: (${digits(s / 4)}, ${digits(s)}, ${digits(s / 4)}))`;
      case "Rect": return `Rect(half: (${digits(s)}, ${digits(s)}), normal: (0, -1, 0))`;
      case "Mesh": return `Mesh(path: ${quoted(path.value)}, height: ${digits(s)})`;
      default: return `Sphere(radius: ${digits(s)})`;
    }
  };
  return {
    name: "Lamp", key: "l", hint: "Click where the lamp stands or hangs.", cursor: "crosshair",
    options: [labelled("form", form), pathField, labelled("size", size, "m"), labelled("flux", flux, "lm"), labelled("color", kelvin, "K"), labelled("height above", lift, "m")],
    click(point) {
      if (form.value === "Mesh" && !path.value.trim()) return say("Type the path of the model first", true);
      const at = e.pixel({ ...point, lift: Number(lift.value) || 0 });
      const name = e.freeName(model.edit, "lamp", known());
      insert((text) => e.setLight(text, name, `Lamp(shape: ${shape()}, at: ${at}, flux: ${digits(Number(flux.value) || 0, 4)}, temperature: ${Math.round(Number(kelvin.value) || 2700)})`), name);
    },
  };
}

function material() {
  const albedo = make("input", { type: "color", value: "#c8c4bc", "aria-label": "color of the surface" });
  const finish = make("select", { "aria-label": "finish" }, ...[["", "dull"], ["roughness: 0.3", "satin"], ["roughness: 0.1", "glossy"], ["roughness: 0.05, metallic: 1", "metal"]].map(([value, text]) => make("option", { value }, text)));
  const text = () => `(albedo: Srgb("${albedo.value}")${finish.value && `, ${finish.value}`})`;
  return { options: [labelled("color", albedo), labelled("finish", finish)], text };
}

function sphere() {
  const radius = number_("radius in meters", 0.1, { min: 0.001, step: 0.01 });
  const lift = number_("height above the surface in meters", 0, { min: 0, step: 0.05 });
  const stuff = material();
  return {
    name: "Sphere", key: "o", hint: "Click where the ball lies.", cursor: "crosshair",
    options: [labelled("radius", radius, "m"), labelled("height above", lift, "m"), ...stuff.options],
    click: (point) => insert((text) => e.addItem(text, "objects", `Sphere(radius: ${digits(Number(radius.value) || 0.1)}, at: ${e.pixel({ ...point, lift: Number(lift.value) || 0 })}, material: ${stuff.text()})`), "sphere"),
  };
}

function mesh() {
  const path = make("input", { type: "text", placeholder: "chair.glb", "aria-label": "path of the model, from the edit's folder" });
  const height = number_("height of the model in meters", 0.5, { min: 0.0001, step: 0.05 });
  const yaw = number_("turn to the left in degrees", 0, { step: 5 });
  return {
    name: "Model", key: "m", hint: "Type the path of a PLY, OBJ, glTF or GLB file, then click where it stands.", cursor: "crosshair",
    options: [labelled("file", path), labelled("height", height, "m"), labelled("turn", yaw, "\u00b0")],
    click(point) {
      if (!path.value.trim()) return say("Type the path of the model first", true);
      const turn = Number(yaw.value) ? `, yaw: ${digits(Number(yaw.value))}` : "";
      insert((text) => e.addItem(text, "objects", `Mesh(path: ${quoted(path.value.trim())}, at: ${e.pixel(point)}, height: ${digits(Number(height.value) || 0.5)}${turn})`), "model");
    },
  };
}

function pane() {
  let points = [];
  const sky = make("select", { "aria-label": "sky" }, ...[["Radiance(4, 4.4, 5)", "overcast"], ["Radiance(1.5, 1.9, 2.6)", "dusk"], ["Turbidity(3)", "clear, with sun"]].map(([value, text]) => make("option", { value }, text)));
  const show = () => {
    draft.setAttribute("points", points.map(({ x, y }) => `${x + 0.5},${y + 0.5}`).join(" "));
    emit("hint", points.length === 0 ? undefined : `Corners to go: ${4 - points.length}. Backspace takes the last one back, Escape ends.`);
  };
  return {
    name: "Window", key: "n", hint: "Click the four corners of the window on a wall, in order around it.", cursor: "crosshair",
    options: [labelled("sky", sky)],
    click(point) {
      points.push(rounded(point));
      show();
      if (points.length < 4) return;
      const name = e.freeName(model.edit, "window", known());
      // A clear sky has the units of daylight; this is the scale of a photo that is exposed for it.
      const clear = sky.value === "Turbidity(3)" ? ", sun: Direction(azimuth: 20, elevation: 35), scale: 0.03" : "";
      const around = ordered(points);
      points = [];
      show();
      insert((text) => e.setLight(text, name, `Window(corners: ${e.corners(around)}, sky: ${sky.value}${clear})`), name);
    },
    hover(point) {
      if (points.length) draft.setAttribute("points", [...points, point].map(({ x, y }) => `${x + 0.5},${y + 0.5}`).join(" "));
    },
    back() { points.pop(); show(); },
    leave() { points = []; show(); },
  };
}

// Corners in order around their middle, so that a click in the wrong order makes no bow tie.
function ordered(points) {
  const x = points.reduce((sum, p) => sum + p.x, 0) / 4, y = points.reduce((sum, p) => sum + p.y, 0) / 4;
  return [...points].sort((a, b) => Math.atan2(a.y - y, a.x - x) - Math.atan2(b.y - y, b.x - x)).map((p) => [p.x, p.y]);
}

function paint() {
  const color = make("input", { type: "color", value: "#b5563c", "aria-label": "color of the wall" });
  const polish = make("select", { "aria-label": "finish" }, ...[["", "as it is"], [", roughness: 0.3", "satin"], [", roughness: 0.1", "polished"]].map(([value, text]) => make("option", { value }, text)));
  return {
    name: "Paint", key: "p", hint: "Choose a color, then click a wall or another surface.", cursor: "crosshair",
    options: [labelled("color", color), labelled("finish", polish)],
    click: (point) => insert((text) => e.addItem(text, "materials", `Paint(region: Grow(${Math.round(point.x)}, ${Math.round(point.y)}), albedo: Srgb("${color.value}")${polish.value})`), "paint"),
  };
}

const look = { name: "Look", key: "v", hint: "Drag to move the picture, wheel or two fingers to zoom. Drag a handle to move a light or an object.", options: [] };
let tools, active = look;
const draft = drawing("polygon", { class: "draft" });

// ---- The bar of tools ------------------------------------------------------------------------------------------------------------

export function choose(tool) {
  if (active === tool) return;
  active.leave?.();
  active = tool;
  tool.enter?.();
  setTool(tool);
  tools.forEach((each) => each.button.setAttribute("aria-pressed", each === tool));
  const box = byId("options");
  box.replaceChildren(...(tool.options.length ? tool.options : []), make("p", { class: "hint" }, tool.hint));
  byId("toolname").textContent = tool.name;
  byId("toolbox").hidden = tool === look;
  cursor = undefined;
  placeCursor();
}

export const toolOf = (key) => tools.find((each) => each.key === key);
export const escape = () => {
  if (active === look) return false;
  choose(look);
  return true;
};

// ---- A cursor for the keyboard ------------------------------------------------------------------------------------------------------

let cursor;
function placeCursor() {
  const element = byId("cursor");
  element.hidden = !cursor;
  if (!cursor) return;
  const at = toStage(cursor.x, cursor.y);
  element.style.left = `${at.x}px`;
  element.style.top = `${at.y}px`;
}

function stageKeys(event) {
  if (event.target !== byId("stage") || event.ctrlKey || event.metaKey) return;
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (arrow) {
    event.preventDefault();
    const [w, h] = fullSize();
    const by = event.shiftKey ? 1 : Math.max(1, Math.round(w / 50));
    cursor ??= { x: Math.round(w / 2), y: Math.round(h / 2) };
    cursor = { x: Math.min(w - 1, Math.max(0, cursor.x + by * arrow[0])), y: Math.min(h - 1, Math.max(0, cursor.y + by * arrow[1])) };
    placeCursor();
    emit("pointer", cursor);
    active.hover?.(cursor);
  } else if (event.key === "Enter" && cursor && active.click) {
    event.preventDefault();
    active.click(cursor);
  } else if (event.key === "Backspace" && active.back) active.back();
}

// ---- Handles ---------------------------------------------------------------------------------------------------------------------------

// What has a place on the picture: { key, label, kind, at: { x, y }, move(text, point) -> text }.
function placed() {
  const found = [];
  for (const each of lights()) {
    const node = each.entry?.node;
    if (each.entry?.off) continue;
    const label = each.id;
    if (node?.name === "Window" && e.isMade(node)) {
      const points = values(field(node, "corners")).map(numbers);
      if (points.length !== 4 || !points.flat().every(Number.isFinite)) continue;
      const put = (text, moved) => e.setFields(text, "lights", each.id, { corners: e.corners(moved) });
      points.forEach(([x, y], k) => found.push({
        key: `${label} ${k}`, label: `${label}: corner ${k + 1}`, kind: "corner", at: { x, y },
        move: (text, to) => put(text, points.map((p, i) => (i === k ? [to.x, to.y] : p))),
      }));
      continue;
    }
    const at = e.place(e.isMade(node) ? field(node, "at") : field(e.change(node, "Move"), "to"));
    const shown = at?.point ? projected(at.point) : at?.x !== undefined ? at : middle(each);
    if (!shown || (each.kind === "Window" && !each.own)) continue;
    found.push({
      key: label, label, kind: "light", at: shown,
      move: (text, to) => placeText(text, lights().find((l) => l.id === each.id) ?? each, e.pixel({ ...to, lift: at?.lift ?? 0 })),
    });
  }
  for (const each of model.edit.objects) {
    const at = e.place(field(each.node, "at"));
    const shown = at?.point ? projected(at.point) : at;
    if (!shown || each.off) continue;
    const name = `${each.node.name === "Mesh" ? "model" : "sphere"} ${each.id + 1}`;
    found.push({ key: name, label: name, kind: "object", at: shown, move: (text, to) => e.setFields(text, "objects", each.id, { at: e.pixel({ ...to, lift: at.lift ?? 0 }) }) });
  }
  return found;
}

// The photo pixel of a point in camera space.
function projected([x, y, z]) {
  const camera = model.server?.camera;
  if (!camera || !(z < 0)) return undefined;
  return { x: camera.cx + (camera.fx * x) / -z - 0.5, y: camera.cy + (camera.fy * -y) / -z - 0.5 };
}

// The middle of the mask of each lamp in view.
const middles = new Map();
const middle = ({ id }) => middles.get(id);

async function findMiddles() {
  for (const { id, kind, in_view } of model.server.lights) {
    if (!in_view || kind !== "Lamp" || middles.has(id)) continue;
    try {
      const bitmap = await createImageBitmap(await api.getBlob(`/api/masks/${id}`));
      const [w, h] = [256, Math.max(1, Math.round((256 * bitmap.height) / bitmap.width))];
      const canvas = make("canvas", { width: w, height: h });
      const context = canvas.getContext("2d");
      context.drawImage(bitmap, 0, 0, w, h);
      const { data } = context.getImageData(0, 0, w, h);
      let [x, y, sum] = [0, 0, 0];
      for (let p = 0; p < w * h; p++) {
        x += data[4 * p] * (p % w);
        y += data[4 * p] * Math.floor(p / w);
        sum += data[4 * p];
      }
      const [full, tall] = model.server.full;
      if (sum > 0) middles.set(id, { x: ((x / sum + 0.5) * full) / w - 0.5, y: ((y / sum + 0.5) * tall) / h - 0.5 });
    } catch { /* a light without a handle */ }
  }
  updateHandles();
}

const handles = new Map();
function updateHandles() {
  const found = byId("showhandles").checked && !model.edit.error ? placed() : [];
  const seen = new Set(found.map((each) => each.key));
  for (const [key, each] of handles) {
    if (seen.has(key)) continue;
    each.element.remove();
    handles.delete(key);
  }
  for (const thing of found) {
    if (!handles.has(thing.key)) {
      const element = make("button", { type: "button", class: `handle ${thing.kind}`, "aria-label": `${thing.label}: drag, or move with the arrow keys` }, make("span", {}, thing.kind === "corner" ? "" : thing.label));
      const each = { element };
      element.addEventListener("pointerdown", (event) => dragHandle(event, each));
      element.addEventListener("keydown", (event) => handleKeys(event, each));
      handles.set(thing.key, each);
      byId("handles").append(element);
    }
    handles.get(thing.key).thing = thing;
  }
  placeHandles();
}

function placeHandles() {
  for (const { element, thing } of handles.values()) {
    const at = toStage(thing.at.x, thing.at.y);
    element.style.left = `${at.x}px`;
    element.style.top = `${at.y}px`;
  }
  cover(byId("drafts"));
  byId("drafts").setAttribute("viewBox", `0 0 ${fullSize().join(" ")}`);
  placeCursor();
}

function dragHandle(event, each) {
  if (event.button > 0) return;
  event.preventDefault();
  const { element } = each;
  element.focus();
  element.setPointerCapture(event.pointerId);
  const start = toPhoto(event.clientX, event.clientY), from = each.thing.at, text = model.text;
  const { move } = each.thing;
  let moved = false;
  const go = (now) => {
    const at = toPhoto(now.clientX, now.clientY);
    const to = rounded({ x: from.x + at.x - start.x, y: from.y + at.y - start.y });
    if (!moved && Math.hypot(now.clientX - event.clientX, now.clientY - event.clientY) < 3) return;
    if (!isInside(to)) return;
    moved = true;
    preview(move(text, to));
  };
  const end = (last) => {
    element.removeEventListener("pointermove", go);
    element.removeEventListener("pointerup", end);
    element.removeEventListener("pointercancel", end);
    if (!moved) return;
    if (last.type === "pointercancel") preview(undefined);
    else { settle(); keepPreview(); settle(); }
  };
  element.addEventListener("pointermove", go);
  element.addEventListener("pointerup", end);
  element.addEventListener("pointercancel", end);
}

function handleKeys(event, { thing }) {
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!arrow) return;
  event.preventDefault();
  event.stopPropagation();
  const by = event.shiftKey ? 10 : 1;
  const to = rounded({ x: thing.at.x + by * arrow[0], y: thing.at.y + by * arrow[1] });
  if (isInside(to)) change(thing.move(model.text, to), `move ${thing.key}`);
}

// ---- Surfaces and objects ------------------------------------------------------------------------------------------------------------

function things() {
  const list = byId("things");
  const rows = e.LISTS.flatMap((name) => model.edit[name].map((entry) => thingRow(name, entry)));
  if (list.contains(document.activeElement)) {
    // Controls keep the focus where the list stays the same.
    if (list.dataset.key === rows.map((each) => each.key).join()) return;
  }
  list.dataset.key = rows.map((each) => each.key).join();
  list.replaceChildren(...rows.map((each) => each.element));
  byId("nothing").hidden = rows.length > 0;
}

function thingRow(name, entry) {
  const { node, id } = entry;
  const now = () => model.edit[name][id];
  const what = name === "materials" ? `paint ${id + 1}` : `${node.name === "Mesh" ? "model" : "sphere"} ${id + 1}`;
  const where = name === "materials" ? summary(field(node, "region")) : summary(field(node, "path")) || `${number(field(node, "radius")?.value ?? 0)} m`;
  const isOn = make("input", { type: "checkbox", class: "switch", role: "switch", "aria-label": `${what}: on`, onchange: () => {
    try { change(e.switchEntry(model.text, name, now(), isOn.checked)); } catch (error) { say(error.message, true); isOn.checked = !isOn.checked; }
  } });
  isOn.checked = !entry.off;
  const surface = name === "materials" ? node : field(node, "material");
  const albedo = field(surface, "albedo");
  let color;
  if (albedo?.name === "Srgb" && !entry.off) {
    color = make("input", { type: "color", value: values(albedo)[0]?.value ?? "#808080", "aria-label": `${what}: color`, onchange: settle, oninput: () => {
      const part = name === "materials" ? now().node : field(now().node, "material");
      const old = values(field(part, "albedo"))[0];
      change(model.text.slice(0, old.start) + quoted(color.value) + model.text.slice(old.end), `${what} color`);
    } });
  }
  const gone = make("button", { type: "button", class: "bad", "aria-label": `${what}: remove`, title: "Remove", onclick: () => { change(e.removeEntry(model.text, name, now())); say(`${what} removed`); } }, "\u00d7");
  const element = make("li", { class: entry.off ? "thing off" : "thing" }, isOn, make("b", {}, what), make("small", {}, where), color ?? make("span"), gone);
  return { element, key: `${what}${Boolean(entry.off)}` };
}

const summary = (node) => (!node ? "" : node.kind === "string" ? node.value : node.name === "Grow" ? `from ${numbers(node).join(", ")}` : values(node)[0]?.value ?? "");

// ---- Begin -----------------------------------------------------------------------------------------------------------------------------

export function beginTools() {
  tools = [look, lamp(), sphere(), mesh(), pane(), paint(), brush()];
  for (const tool of tools) {
    tool.button = make("button", { type: "button", class: "tool", "aria-pressed": String(tool === look), title: `${tool.name} (${tool.key.toUpperCase()})`, "aria-keyshortcuts": tool.key, onclick: () => choose(tool) }, tool.name);
    byId("tools").append(tool.button);
  }
  byId("drafts").append(draft);
  setTool(look);
  byId("stage").addEventListener("keydown", stageKeys);
  byId("showhandles").addEventListener("change", updateHandles);
  byId("closetool").addEventListener("click", () => choose(look));
  for (const name of ["text", "state", "layers"]) { on(name, updateHandles); on(name, things); }
  on("state", findMiddles);
  on("view", placeHandles);
  on("hint", (text) => { const line = byId("options").querySelector(".hint"); if (line) line.textContent = text ?? active.hint; });
  // From the panel: a lamp of the photo is to go where the next click is.
  document.addEventListener("relight:place", ({ detail: id }) => {
    const placing = {
      name: `Move ${id}`, hint: `Click the new place of ${id}.`, cursor: "crosshair", options: [],
      click(point) {
        const light = lights().find((each) => each.id === id);
        if (light) change(placeText(model.text, light, e.pixel(point)));
        choose(look);
      },
    };
    choose(placing);
    byId("stage").focus();
  });
}
