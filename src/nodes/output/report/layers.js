"use strict";
// Layers of light for a browser: unpacking, mixing, encoding. The page of a run inlines this file without its `export`s,
// the page of `relight serve` loads it as a module.

export const HALF = Float32Array.from({ length: 65536 }, (_, bits) => {
  const exponent = (bits >> 10) & 31, mantissa = bits & 1023;
  const value = exponent ? (1 + mantissa / 1024) * 2 ** (exponent - 15) : mantissa * 2 ** -24;
  return bits >> 15 ? -value : value;
});

// The halves, channel by channel, that src/image/ops/pack.rs packs: zlib; low bytes, then high bytes; each number as the
// difference from the one before.
export async function halves(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  const out = new Uint16Array(raw.length / 2);
  for (let i = 0, bits = 0; i < out.length; i++) {
    bits = (bits + raw[i] + 256 * raw[out.length + i]) & 65535;
    out[i] = bits;
  }
  return out;
}

export function linear(halves, scale) {
  const out = new Float32Array(halves.length);
  for (let i = 0; i < out.length; i++) out[i] = HALF[halves[i]] * scale;
  return out;
}

// Adds a layer to a sum of layers, both channel by channel.
export function addLayer(sum, layer, weight) {
  const pixels = sum.length / 3;
  weight.forEach((w, c) => {
    for (let i = c * pixels; i < (c + 1) * pixels; i++) sum[i] += w * layer[i];
  });
}

export const decodeSrgb = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
export const encodeSrgb = (l) => (l <= 0.0031308 ? 12.92 * l : 1.055 * l ** (1 / 2.4) - 0.055);

// The transfer of a photo as the program's JSON has it: "Srgb", "Linear", { "Gamma": 2.2 }.
function encode(transfer, value) {
  if (transfer.Gamma) return value ** (1 / transfer.Gamma);
  return transfer === "Srgb" ? encodeSrgb(value) : value;
}

// By the square root, so that the steep start of the curve is met by many entries.
const STEPS = 16384;
export const storedTable = (transfer) => Uint8ClampedArray.from({ length: STEPS + 1 }, (_, i) => Math.round(255 * encode(transfer, (i / STEPS) ** 2)));

// A linear sum as pixels for a canvas.
export function encoded(sum, width, height, table, exposure = 1) {
  const pixels = width * height;
  const image = new ImageData(width, height);
  for (let p = 0; p < pixels; p++) {
    for (let c = 0; c < 3; c++) {
      const v = exposure * sum[c * pixels + p];
      image.data[4 * p + c] = table[v <= 0 ? 0 : v >= 1 ? STEPS : Math.round(Math.sqrt(v) * STEPS)];
    }
    image.data[4 * p + 3] = 255;
  }
  return image;
}

// A color of the picker as linear channels, and back.
export const fromHex = (hex) => [0, 2, 4].map((at) => decodeSrgb(parseInt(hex.replace("#", "").slice(at, at + 2), 16) / 255));
export const toHex = (tint) => "#" + tint.map((x) => Math.round(255 * encodeSrgb(Math.min(1, x))).toString(16).padStart(2, "0")).join("");

// Colors of the room's box, by the source of a side.
export const SIDES = { Seen: "#3ef06d", Given: "#5ab9ff", Guessed: "#ff9400", Open: "#bcbcbc" };

// The box of the room as an SVG element of the picture's size.
export function roomBox({ lines }, width, height) {
  const drawing = (name, attributes) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    Object.entries(attributes).forEach(([key, value]) => element.setAttribute(key, value));
    return element;
  };
  const svg = drawing("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "the room as a box over the photo" });
  for (const [source, edge, [x1, y1, x2, y2]] of lines) {
    const ends = { x1: x1 * width, y1: y1 * height, x2: x2 * width, y2: y2 * height };
    svg.append(drawing("line", { ...ends, stroke: SIDES[source], "stroke-width": edge ? 3 : 1 }));
  }
  return svg;
}
