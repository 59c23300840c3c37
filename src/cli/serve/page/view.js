// The picture on the page: zoom, pan, the wipe against the photo, exposure; none of it is part of the edit.
import { model, on, emit, weights, loadLayers, say } from "./model.js";
import { createGl, MAX_LAYERS } from "./gl.js";
import { createCanvas2d } from "./canvas2d.js";
import { byId } from "./dom.js";
import * as api from "./api.js";

export const view = {
  zoom: 1, // canvas pixels per layer pixel
  x: 0,
  y: 0,
  fits: true,
  wipe: undefined, // share of the picture's width that is the photo
  held: false, // the photo is shown while a key is held
  exposure: 0, // stops
  solo: new Set(), // lights (or rest) that are shown alone
  mode: "picture", // of an overlay, as in gl.js
  plane: undefined,
};

const stage = byId("stage");
const canvas = byId("picture");
export let renderer;
const MAX_ZOOM = 64;

const density = () => window.devicePixelRatio || 1;
export const layerSize = () => model.manifest?.size ?? [1, 1];
export const fullSize = () => model.manifest?.full ?? model.server?.full ?? [1, 1];

// ---- Drawing -------------------------------------------------------------------------------------------------------------

let waiting = false;
export function redraw() {
  if (!waiting) requestAnimationFrame(() => { waiting = false; draw(); });
  waiting = true;
}

// The layers of a manifest in their order on the GPU: rest, photo, lights.
const layersOf = (manifest) => [manifest.rest, manifest.photo, ...manifest.lights].filter((each) => each?.digest);

// Their weights in the picture, with the layers' scales in them, and the one that is the photo.
function weighted(manifest) {
  const found = weights(manifest);
  const alone = view.solo.size > 0;
  const scaled = (each) => {
    if (alone && !view.solo.has(each.id)) return [0, 0, 0];
    return (found.get(each.id)?.weight ?? [1, 1, 1]).map((w) => w * each.scale);
  };
  const layers = layersOf(manifest);
  return {
    weights: layers.map((each) => (each === manifest.photo ? [0, 0, 0] : scaled(each))),
    photo: { at: Math.max(0, layers.indexOf(manifest.photo)), scale: manifest.photo?.digest ? manifest.photo.scale : 0 },
  };
}

export const scene = () => ({
  ...weighted(model.manifest),
  preview: model.previewed && weighted(model.previewed),
  exposure: 2 ** view.exposure,
  transfer: model.manifest.transfer,
  view,
  mode: view.mode,
  plane: view.plane,
});

function wipeAt() {
  if (view.held) return canvas.width;
  return view.wipe === undefined ? 0 : view.x + view.wipe * layerSize()[0] * view.zoom;
}

let surround = [0.5, 0.5, 0.5];
export function readSurround() {
  const found = /(\d+)[, ]+(\d+)[, ]+(\d+)/.exec(getComputedStyle(stage).backgroundColor);
  if (found) surround = found.slice(1, 4).map((v) => Number(v) / 255);
}

function draw() {
  if (!model.manifest || !renderer) return;
  renderer.draw({ ...scene(), wipe: wipeAt(), surround, sharp: sharpSides() });
  document.documentElement.dataset.drawn = String(Number(document.documentElement.dataset.drawn ?? 0) + 1);
}

// The picture at the layers' size under the present weights, for comparison and thumbnails.
export const readPicture = (width, height) => renderer?.read({ ...scene(), exposure: 1 }, width, height);
export const readShown = (width, height) => renderer?.read(scene(), width, height);

// ---- Photo pixels beyond the layers' -----------------------------------------------------------------------------------------

// Where the layers are smaller than the photo and a person looks at single pixels, the files of the photo and of the last
// run are shown; the picture only while it is that of the text.
let sharpKeys = [undefined, undefined], sharpFailed = new Set();
const wantsSharp = () => {
  const [full, own] = [fullSize()[0], layerSize()[0]];
  return renderer?.kind === "WebGL2" && full > own && view.zoom > 1 && view.exposure === 0 && Math.max(...fullSize()) <= renderer.maxSharp();
};
const pictureKey = () => (model.run.status === "done" && model.run.revision >= model.accepted.revision && model.text === model.accepted.text && view.solo.size === 0 && !model.previewed
  ? `picture ${model.accepted.revision} ${model.run.finished?.seconds ?? ""}` : undefined);

function sharpSides() {
  if (!wantsSharp()) return [false, false];
  const wanted = [pictureKey(), "photo"];
  wanted.forEach((key, which) => {
    if (!key || sharpKeys[which] === key || sharpFailed.has(key)) return;
    sharpFailed.add(key);
    const path = which === 0 ? `/api/picture.png?revision=${model.accepted.revision}` : `/api/photo?long_side=${Math.max(...fullSize())}`;
    api.getBlob(path).then((blob) => createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" })).then((bitmap) => {
      sharpFailed.delete(key);
      renderer.setSharp(which, key, bitmap);
      bitmap.close();
      sharpKeys[which] = key;
      redraw();
    }, () => { /* the layers stay */ });
  });
  return wanted.map((key, which) => key !== undefined && sharpKeys[which] === key);
}

// ---- Zoom and pan ----------------------------------------------------------------------------------------------------------

export function fit() {
  const [w, h] = layerSize();
  const pad = Math.min(canvas.width, canvas.height) > 700 ? 24 * density() : 0;
  view.zoom = Math.min((canvas.width - 2 * pad) / w, (canvas.height - 2 * pad) / h);
  view.fits = true;
  view.x = Math.round((canvas.width - w * view.zoom) / 2);
  view.y = Math.round((canvas.height - h * view.zoom) / 2);
  moved();
}

function moved() {
  const [w, h] = layerSize();
  // Some of the picture stays in sight.
  const keep = 40 * density();
  view.x = Math.min(canvas.width - keep, Math.max(keep - w * view.zoom, view.x));
  view.y = Math.min(canvas.height - keep, Math.max(keep - h * view.zoom, view.y));
  emit("view");
  redraw();
}

// Zooms about a point of the canvas, in its pixels.
export function zoomTo(zoom, cx = canvas.width / 2, cy = canvas.height / 2) {
  const least = Math.min(canvas.width / layerSize()[0], canvas.height / layerSize()[1], 1) / 2;
  const next = Math.min(MAX_ZOOM * density(), Math.max(least, zoom));
  view.x = cx - ((cx - view.x) * next) / view.zoom;
  view.y = cy - ((cy - view.y) * next) / view.zoom;
  view.zoom = next;
  view.fits = false;
  moved();
}
export const zoomBy = (factor, cx, cy) => zoomTo(view.zoom * factor, cx, cy);
// One photo pixel is one pixel of the screen.
export const zoomToOne = () => zoomTo(fullSize()[0] / layerSize()[0]);
export function panBy(dx, dy) {
  view.x += dx * density();
  view.y += dy * density();
  view.fits = false;
  moved();
}
// Percent: 100 where a photo pixel takes one pixel of the screen.
export const zoomShare = () => (view.zoom * layerSize()[0]) / fullSize()[0];

// Photo pixels (a pixel's center is its number) of a point of the window, and back to the stage's own pixels.
export function toPhoto(clientX, clientY) {
  const box = canvas.getBoundingClientRect();
  const scale = fullSize()[0] / layerSize()[0];
  return {
    x: (((clientX - box.left) * density() - view.x) / view.zoom) * scale - 0.5,
    y: (((clientY - box.top) * density() - view.y) / view.zoom) * scale - 0.5,
  };
}
export function toStage(x, y) {
  const scale = layerSize()[0] / fullSize()[0];
  return { x: (view.x + (x + 0.5) * scale * view.zoom) / density(), y: (view.y + (y + 0.5) * scale * view.zoom) / density() };
}
export const isInside = ({ x, y }) => x >= -0.5 && y >= -0.5 && x < fullSize()[0] - 0.5 && y < fullSize()[1] - 0.5;

// Puts an element of the stage exactly over the picture.
export function cover(element) {
  const [w, h] = layerSize();
  Object.assign(element.style, {
    left: `${view.x / density()}px`, top: `${view.y / density()}px`,
    width: `${(w * view.zoom) / density()}px`, height: `${(h * view.zoom) / density()}px`,
  });
}

// Layers of twice the size for large screens; four times as many numbers, so that others do without.
const LARGE = 1700;

function resize() {
  const { width, height } = stage.getBoundingClientRect();
  const [w, h] = [Math.max(1, Math.round(width * density())), Math.max(1, Math.round(height * density()))];
  if (w === canvas.width && h === canvas.height) return;
  if (Math.max(w, h) > LARGE && model.longSide < 2560) {
    model.longSide = 2560;
    if (model.manifest) loadLayers();
  }
  const [dx, dy] = [(w - canvas.width) / 2, (h - canvas.height) / 2];
  canvas.width = w;
  canvas.height = h;
  if (view.fits) return fit();
  view.x += dx;
  view.y += dy;
  moved();
}

// ---- Pointers ----------------------------------------------------------------------------------------------------------------

// The tool that gets pointers: { down(point, event) -> true to take the drag, move, up, cancel, hover, cursor }.
let tool = {};
export function setTool(next) {
  tool = next;
  stage.style.cursor = next.cursor ?? "grab";
}

const pointers = new Map();
let pinch, drag;

function down(event) {
  if (event.target.closest?.("button, input, .box")) return;
  pointers.set(event.pointerId, event);
  stage.setPointerCapture(event.pointerId);
  if (pointers.size === 2) {
    if (drag?.tool) tool.cancel?.();
    drag = undefined;
    pinch = spread();
    return;
  }
  const pans = event.button === 1 || event.altKey;
  if (event.button > 1) return;
  const taken = !pans && tool.down?.(toPhoto(event.clientX, event.clientY), event);
  drag = { tool: Boolean(taken), x: event.clientX, y: event.clientY, moved: false };
  event.preventDefault();
  stage.focus({ preventScroll: true });
}

function spread() {
  const [a, b] = [...pointers.values()];
  return { x: (a.clientX + b.clientX) / 2, y: (a.clientY + b.clientY) / 2, far: Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) };
}

function move(event) {
  if (!pointers.has(event.pointerId)) {
    tool.hover?.(toPhoto(event.clientX, event.clientY), event);
    emit("pointer", toPhoto(event.clientX, event.clientY));
    return;
  }
  pointers.set(event.pointerId, event);
  if (pinch && pointers.size === 2) {
    const now = spread(), box = canvas.getBoundingClientRect();
    view.x += (now.x - pinch.x) * density();
    view.y += (now.y - pinch.y) * density();
    zoomBy(now.far / Math.max(1, pinch.far), (now.x - box.left) * density(), (now.y - box.top) * density());
    pinch = now;
    return;
  }
  if (!drag) return;
  if (drag.tool) return tool.move?.(toPhoto(event.clientX, event.clientY), event);
  if (!drag.moved && Math.hypot(event.clientX - drag.x, event.clientY - drag.y) < 3) return;
  panBy(event.clientX - drag.x, event.clientY - drag.y);
  drag = { ...drag, x: event.clientX, y: event.clientY, moved: true };
}

function up(event) {
  if (!pointers.delete(event.pointerId)) return;
  pinch = undefined;
  if (!drag) return;
  if (drag.tool) {
    if (event.type === "pointercancel") tool.cancel?.();
    else tool.up?.(toPhoto(event.clientX, event.clientY), event);
  } else if (!drag.moved && event.type === "pointerup") {
    const at = toPhoto(event.clientX, event.clientY);
    if (isInside(at)) tool.click?.(at, event);
  }
  drag = undefined;
}

// ---- The wipe ------------------------------------------------------------------------------------------------------------------

const line = byId("wipe");

export function setWipe(share) {
  view.wipe = share === undefined ? undefined : Math.min(1, Math.max(0, share));
  emit("view");
  redraw();
}
// It begins in the middle of what is in sight.
export const toggleWipe = () => setWipe(view.wipe === undefined ? (canvas.width / 2 - view.x) / (layerSize()[0] * view.zoom) : undefined);
export function holdPhoto(held) {
  if (view.held === held) return;
  view.held = held;
  redraw();
}

function placeWipe() {
  line.hidden = view.wipe === undefined;
  if (line.hidden) return;
  line.style.left = `${wipeAt() / density()}px`;
  line.setAttribute("aria-valuenow", Math.round(100 * view.wipe));
}

function wipeKeys(event) {
  const by = { ArrowLeft: -0.01, ArrowRight: 0.01, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 }[event.key];
  if (!by) return;
  event.preventDefault();
  event.stopPropagation();
  setWipe(view.wipe + by * (event.shiftKey ? 10 : 1));
}

function wipeDrag(event) {
  event.preventDefault();
  line.focus();
  line.setPointerCapture(event.pointerId);
  const go = (each) => {
    const box = canvas.getBoundingClientRect();
    setWipe(((each.clientX - box.left) * density() - view.x) / (layerSize()[0] * view.zoom));
  };
  const end = () => line.removeEventListener("pointermove", go);
  line.addEventListener("pointermove", go);
  line.addEventListener("pointerup", end, { once: true });
  line.addEventListener("pointercancel", end, { once: true });
}

// ---- Begin -----------------------------------------------------------------------------------------------------------------------

export function setExposure(stops) {
  view.exposure = Math.min(10, Math.max(-10, Math.round(100 * stops) / 100));
  emit("view");
  redraw();
}

let shownSize;
function upload() {
  const { manifest, previewed } = model;
  const now = previewed ?? manifest, layers = layersOf(now);
  const done = previewed ? renderer.setSmall(layers, ...now.size) : renderer.setLayers(layers, ...now.size);
  // They are on the GPU now; where it was too small for them, all are loaded again.
  layers.forEach((each) => { delete each.halves; });
  if (!done) return loadLayers(true);
  if (!previewed) {
    if (layers.length > MAX_LAYERS) say(`The page shows ${MAX_LAYERS} layers, and there are ${layers.length}: the last lights are missing here, not in the files`, true);
    const size = manifest.size.join();
    if (size !== shownSize) {
      // The same part of the photo stays in sight.
      const old = shownSize?.split(",").map(Number);
      shownSize = size;
      if (view.fits || !old) fit();
      else { view.zoom *= old[0] / manifest.size[0]; moved(); }
    }
  }
  redraw();
}

export function beginView() {
  renderer = (new URLSearchParams(location.search).has("2d") ? undefined : createGl(canvas)) ?? createCanvas2d(canvas);
  if (renderer.kind !== "WebGL2") say("This browser has no WebGL2: the picture is summed without a GPU, more slowly");
  model.isHeld = renderer.isHeld;
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    renderer.restore();
    sharpKeys = [undefined, undefined];
    model.previewed = undefined;
    shownSize = undefined;
    loadLayers(true);
    emit("restored");
  });
  readSurround();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readSurround(); redraw(); });
  new ResizeObserver(resize).observe(stage);
  resize();
  stage.addEventListener("pointerdown", down);
  stage.addEventListener("pointermove", move);
  stage.addEventListener("pointerup", up);
  stage.addEventListener("pointercancel", up);
  stage.addEventListener("pointerleave", () => emit("pointer", undefined));
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    zoomBy(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : event.ctrlKey ? 0.01 : 0.002)), (event.clientX - box.left) * density(), (event.clientY - box.top) * density());
  }, { passive: false });
  line.addEventListener("pointerdown", wipeDrag);
  line.addEventListener("keydown", wipeKeys);
  on("view", placeWipe);
  on("layers", upload);
  on("text", redraw);
  on("finished", redraw);
  on("sent", redraw);
}
