// The page of `relight serve`: joins its parts, and its keys.
import { model, on, begin, undo, redo, say, lights } from "./model.js";
import { view, beginView, fit, zoomBy, zoomTo, zoomToOne, zoomShare, toggleWipe, holdPhoto, setExposure, panBy, readPicture, readShown, toStage, toPhoto, isInside, layerSize, fullSize, renderer } from "./view.js";
import { beginLights, toggle, toggleSolo } from "./lights.js";
import { beginTools, choose, toolOf, escape } from "./tools.js";
import { beginOverlays } from "./overlays.js";
import { beginPanels } from "./panels.js";
import { byId } from "./dom.js";

// ---- Words to a person ---------------------------------------------------------------------------------------------------

let quiet;
on("say", ({ text, bad }) => {
  const line = byId("said");
  line.textContent = text;
  line.classList.toggle("bad", bad);
  clearTimeout(quiet);
  if (!bad) quiet = setTimeout(() => { line.textContent = ""; }, 6000);
});

on("connection", () => {
  byId("lost").hidden = model.connected;
  document.documentElement.dataset.connected = String(model.connected);
});
on("lost", (reason) => {
  byId("lost").hidden = false;
  byId("lost").textContent = `${reason}. What you change is kept here, and sent when it is back.`;
});

on("state", () => {
  const { scene, graph } = model.server;
  byId("scene").textContent = scene;
  byId("scene").title = `${scene}, ${graph}`;
  document.title = `${scene.split("/").at(-1)} - relight`;
});

function updateButtons() {
  byId("undo").disabled = model.undo.length === 0;
  byId("redo").disabled = model.redo.length === 0;
}
on("text", updateButtons);

// ---- Controls of the view ----------------------------------------------------------------------------------------------------

function updateView() {
  const share = 100 * zoomShare();
  byId("zoom").textContent = `${share < 10 ? share.toFixed(1) : Math.round(share)} %`;
  byId("ab").setAttribute("aria-pressed", String(view.wipe !== undefined));
  if (document.activeElement !== byId("exposurenumber")) byId("exposurenumber").value = view.exposure;
  byId("exposure").value = view.exposure;
}
on("view", updateView);

on("pointer", (at) => {
  byId("at").textContent = at && isInside(at) ? `x ${Math.round(at.x)}  y ${Math.round(at.y)}` : `${fullSize().join(" x ")}${layerSize()[0] < fullSize()[0] ? `, shown at ${layerSize().join(" x ")}` : ""}`;
});

function help(open = !byId("help").open) {
  if (open) byId("help").showModal();
  else byId("help").close();
}

// ---- Keys ------------------------------------------------------------------------------------------------------------------------

const typesText = (element) => element.matches?.("textarea, select, input:not([type=range]):not([type=checkbox]):not([type=color])");

function keys(event) {
  const { key } = event;
  const command = event.ctrlKey || event.metaKey;
  // The text has an undo of its own in the browser, which would not know of other changes.
  if (command && !event.altKey && key.toLowerCase() === "z") { event.preventDefault(); return event.shiftKey ? redo() : undo(); }
  if (command && key.toLowerCase() === "y") { event.preventDefault(); return redo(); }
  if (command || event.altKey || document.querySelector("dialog[open]")) return;
  if (key === "Escape") {
    if (typesText(event.target)) return event.target.blur();
    if (!escape() && view.solo.size) toggleSolo([...view.solo][0]);
    return;
  }
  if (typesText(event.target)) return;
  const digit = /^(?:Digit|Numpad)([1-9])$/.exec(event.code);
  if (digit) {
    const light = lights()[Number(digit[1]) - 1];
    if (light) event.shiftKey ? toggleSolo(light.id) : toggle(light.id);
    return event.preventDefault();
  }
  const onControl = event.target.matches?.("button, input, summary");
  if (key === " " && !onControl) { event.preventDefault(); return holdPhoto(true); }
  const act = {
    "?": () => help(), w: toggleWipe, f: fit, z: zoomToOne, "0": fit,
    "+": () => zoomBy(1.25), "=": () => zoomBy(1.25), "-": () => zoomBy(0.8),
    "[": () => setExposure(view.exposure - 0.25), "]": () => setExposure(view.exposure + 0.25), "\\": () => setExposure(0),
    e: () => { byId("textbox").open = true; byId("text").focus(); },
    h: () => byId("showhandles").click(),
    x: () => byId("room").click(),
    g: () => byId("showgraph").click(),
  }[key] ?? (toolOf(key) && (() => { choose(toolOf(key)); byId("stage").focus(); }));
  if (!act) return;
  event.preventDefault();
  act();
}

function stagePan(event) {
  const by = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[event.key];
  if (by && event.altKey) { event.preventDefault(); panBy(...by); }
}

// ---- Begin -------------------------------------------------------------------------------------------------------------------------

beginView();
beginLights();
beginTools();
beginOverlays();
beginPanels();
document.addEventListener("keydown", keys);
document.addEventListener("keyup", (event) => { if (event.key === " ") holdPhoto(false); });
window.addEventListener("blur", () => holdPhoto(false));
byId("stage").addEventListener("keydown", stagePan);
byId("undo").addEventListener("click", undo);
byId("redo").addEventListener("click", redo);
byId("fit").addEventListener("click", fit);
byId("one").addEventListener("click", zoomToOne);
byId("zoomin").addEventListener("click", () => zoomBy(1.25));
byId("zoomout").addEventListener("click", () => zoomBy(0.8));
byId("ab").addEventListener("click", toggleWipe);
byId("exposure").addEventListener("input", () => setExposure(byId("exposure").valueAsNumber));
byId("exposurenumber").addEventListener("change", () => setExposure(byId("exposurenumber").valueAsNumber || 0));
byId("exposurereset").addEventListener("click", () => setExposure(0));
byId("helpbutton").addEventListener("click", () => help());
for (const dialog of document.querySelectorAll("dialog")) {
  dialog.querySelector(".close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
}
window.addEventListener("error", (event) => say(`A fault of this page: ${event.message}`, true));
window.addEventListener("unhandledrejection", (event) => say(`A fault of this page: ${event.reason?.message ?? event.reason}`, true));

// For scripts and tests of this page: its state, and the picture in stored numbers.
window.relight = { model, view, readPicture, readShown, zoomTo, toStage, toPhoto, get renderer() { return renderer.kind; } };
begin();
