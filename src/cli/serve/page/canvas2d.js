// The same picture without a GPU, for browsers that have no WebGL2: summed in memory, drawn with a 2D canvas.
import { addLayer, encoded, linear, storedTable, HALF } from "./layers.js";

const clamp = (v) => Math.min(1, Math.max(0, v));
const HEAT = [[18, 13, 64], [33, 115, 140], [250, 230, 102]];
function heat(t) {
  const k = t < 0.5 ? 0 : 1, share = 2 * t - k;
  return [0, 1, 2].map((c) => HEAT[k][c] + share * (HEAT[k + 1][c] - HEAT[k][c]));
}

export function createCanvas2d(canvas) {
  const context = canvas.getContext("2d");
  const surface = document.createElement("canvas");
  let layers = [], size = [0, 0], plane, table, tableOf, painted = "";
  const shown = [document.createElement("canvas"), surface];

  function setLayers(given, width, height) {
    size = [width, height];
    const old = new Map(layers.map((each) => [each.digest, each]));
    // Without their scale, as the weights of the scene contain it.
    if (given.some(({ digest, halves }) => !old.has(digest) && !halves)) return false;
    layers = given.map(({ digest, halves }) => old.get(digest) ?? { digest, linear: linear(halves, 1) });
    painted = "";
    return true;
  }

  function setPlane(digest, halves, width, height, channels) {
    plane = { digest, halves, width, height, channels };
    painted = "";
  }

  function image(scene, weights) {
    const sum = new Float32Array(3 * size[0] * size[1]);
    layers.forEach((layer, k) => { if (weights[k].some((w) => w !== 0)) addLayer(sum, layer.linear, weights[k]); });
    const name = JSON.stringify(scene.transfer);
    if (tableOf !== name) { table = storedTable(scene.transfer); tableOf = name; }
    return encoded(sum, ...size, table, scene.exposure);
  }

  function overlay(scene) {
    const { halves, width, height, channels } = plane;
    const { scale, low, high } = scene.plane;
    const data = new ImageData(width, height), pixels = width * height;
    for (let p = 0; p < pixels; p++) {
      const v = [0, 1, 2].map((c) => HALF[halves[channels === 1 ? p : c * pixels + p]] * scale);
      const t = clamp((v[0] - low) / (high - low));
      const color = scene.mode === "normal" ? v.map((x) => 127.5 + 127.5 * x)
        : scene.mode === "color" ? v.map((x) => 255 * clamp(x) ** (1 / 2.2))
        : scene.mode === "depth" ? heat(1 - t) : scene.mode === "heat" ? heat(t)
        : scene.mode === "guess" ? [255 * t, 115 * t, 0] : [255 * t, 255 * t, 255 * t];
      data.data.set([...color, 255], 4 * p);
    }
    return data;
  }

  function onto(target, data) {
    target.width = data.width;
    target.height = data.height;
    target.getContext("2d").putImageData(data, 0, 0);
  }

  function draw(scene) {
    if (layers.length === 0) return;
    const key = JSON.stringify([scene.weights, scene.photo, scene.exposure, scene.transfer, scene.mode, plane?.digest, scene.plane]);
    if (key !== painted) {
      painted = key;
      onto(shown[0], image(scene, layers.map((_, k) => Array(3).fill(k === scene.photo.at ? scene.photo.scale : 0))));
      onto(shown[1], scene.mode === "picture" || !plane ? image(scene, scene.weights) : overlay(scene));
    }
    const { zoom, x, y } = scene.view;
    context.fillStyle = `rgb(${(scene.surround ?? [0.5, 0.5, 0.5]).map((v) => Math.round(255 * v))})`;
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.imageSmoothingEnabled = zoom < 2 && zoom !== 1;
    const half = (target, from, to) => {
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, canvas.height);
      context.clip();
      context.drawImage(target, x, y, size[0] * zoom, size[1] * zoom);
      context.restore();
    };
    half(shown[1], scene.wipe, canvas.width);
    half(shown[0], 0, scene.wipe);
  }

  function read(scene, width = size[0], height = size[1]) {
    if (layers.length === 0) return undefined;
    const full = image(scene, scene.weights);
    if (width === size[0] && height === size[1]) return full;
    const [from, to] = [document.createElement("canvas"), document.createElement("canvas")];
    onto(from, full);
    to.width = width;
    to.height = height;
    const small = to.getContext("2d");
    small.drawImage(from, 0, 0, width, height);
    return small.getImageData(0, 0, width, height);
  }

  // A preview is not worth its time here.
  return { kind: "canvas", isHeld: (digest) => layers.some((each) => each.digest === digest), setLayers, setSmall: () => true, setPlane, setSharp: () => {}, maxSharp: () => 0, draw, read, restore: () => {} };
}
