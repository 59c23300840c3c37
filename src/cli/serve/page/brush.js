// The brush: masks of lamps, windows and sunlight, painted and erased on the picture. A stroke is written when it ends; strokes have
// an undo of their own, as masks are files of the scene and not part of the edit.
import { model, on, say } from "./model.js";
import { cover, toStage } from "./view.js";
import { byId, make, labelled } from "./dom.js";
import * as api from "./api.js";

const MAX_UNDO = 20;

export function brush() {
  const mask = document.createElement("canvas");
  const context = mask.getContext("2d", { willReadFrequently: true });
  mask.id = "mask";
  mask.setAttribute("aria-hidden", "true");
  const which = make("select", { "aria-label": "mask that is painted", onchange: () => load() });
  const erase = make("input", { type: "checkbox", "aria-label": "erase" });
  const size = make("input", { type: "range", min: 1, max: 200, value: 12, "aria-label": "size of the brush in photo pixels", oninput: () => ring() });
  const back = make("button", { type: "button", onclick: () => undoStroke() }, "Undo stroke");
  const state = make("output", {});
  const circle = make("i", { class: "ring", hidden: true });
  const undo = [];
  let last, light, at;

  const tool = {
    name: "Brush", key: "b", hint: "Paint what belongs to the lamp or window, or what the sun lights. The mask is a file of the scene; the old one is kept beside it.", cursor: "none",
    options: [labelled("mask of", which), labelled("size", size, "px"), make("label", { class: "check" }, erase, "erase"), back, state],
    enter() {
      which.replaceChildren(...(model.server?.masks ?? []).map((id) => make("option", { value: id }, id)));
      byId("stage").append(mask, circle);
      cover(mask);
      load();
    },
    leave() {
      mask.remove();
      circle.remove();
    },
    down(point, event) {
      if (!light) return false;
      undo.push(context.getImageData(0, 0, mask.width, mask.height));
      if (undo.length > MAX_UNDO || undo.length * mask.width * mask.height > 5e7) undo.shift();
      last = point;
      stroke(point, event);
      return true;
    },
    move: (point, event) => { ring(point); stroke(point, event); },
    up: () => { save(); },
    cancel: () => { if (undo.length) context.putImageData(undo.pop(), 0, 0); },
    hover: (point) => ring(point),
    click: (point) => { tool.down(point, {}); save(); },
    undoStroke: () => undoStroke(),
  };

  // What belongs to the light is opaque in the accent of masks, all else clear.
  const INK = "#ff7a00";

  async function load() {
    light = undefined;
    undo.length = 0;
    const id = which.value;
    if (!id) { state.textContent = "the scene has no masks"; return; }
    try {
      const bitmap = await createImageBitmap(await api.getBlob(`/api/masks/${id}`));
      if (id !== which.value) return;
      const [width, height] = model.server.full;
      mask.width = width;
      mask.height = height;
      context.drawImage(bitmap, 0, 0, width, height);
      const data = context.getImageData(0, 0, width, height);
      for (let i = 0; i < data.data.length; i += 4) {
        const share = (0.2126 * data.data[i] + 0.7152 * data.data[i + 1] + 0.0722 * data.data[i + 2]) * data.data[i + 3] / 255;
        data.data.set([255, 122, 0, share], i);
      }
      context.putImageData(data, 0, 0);
      light = id;
      state.textContent = `${width} x ${height}`;
    } catch (error) {
      state.textContent = "";
      say(`The mask of ${id} cannot be read: ${error.message}`, true);
    }
  }

  function stroke(point, event) {
    context.save();
    context.globalCompositeOperation = erase.checked !== Boolean(event.shiftKey) ? "destination-out" : "source-over";
    context.strokeStyle = context.fillStyle = INK;
    context.lineWidth = Number(size.value);
    context.lineCap = context.lineJoin = "round";
    context.beginPath();
    context.moveTo(last.x + 0.5, last.y + 0.5);
    context.lineTo(point.x + 0.5, point.y + 0.5 + (last.x === point.x && last.y === point.y ? 0.01 : 0));
    context.stroke();
    context.restore();
    last = point;
  }

  async function save() {
    const id = light;
    if (!id) return;
    // Gray as the scene has it: white where the light is.
    const { width, height } = mask;
    const data = context.getImageData(0, 0, width, height);
    for (let i = 0; i < data.data.length; i += 4) {
      const share = data.data[i + 3];
      data.data.set([share, share, share, 255], i);
    }
    const out = document.createElement("canvas");
    out.width = width;
    out.height = height;
    out.getContext("2d").putImageData(data, 0, 0);
    const blob = await new Promise((done) => out.toBlob(done, "image/png"));
    try {
      await api.put(`/api/masks/${id}`, blob, "image/png");
      say(`Mask of ${id} saved`);
    } catch (error) {
      say(`The mask of ${id} was not saved: ${error.message}`, true);
    }
  }

  function undoStroke() {
    if (undo.length === 0) return say("No stroke to undo");
    context.putImageData(undo.pop(), 0, 0);
    save();
  }

  function ring(point = at) {
    at = point;
    circle.hidden = !at;
    if (!at) return;
    const here = toStage(at.x, at.y), edge = toStage(at.x + Number(size.value) / 2, at.y);
    const far = Math.max(2, edge.x - here.x);
    Object.assign(circle.style, { left: `${here.x}px`, top: `${here.y}px`, width: `${2 * far}px`, height: `${2 * far}px` });
  }

  on("view", () => { cover(mask); ring(); });
  return tool;
}
