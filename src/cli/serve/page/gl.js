// The picture on the GPU: encode(exposure * (rest + sum of weight * layer)) at every pixel of the canvas.
//
// All layers are one array of RGB16F textures. The scale of a layer, a power of two, is part of its weight.

// Layers of a picture. WebGL2 promises 224 uniforms, and there are two rows of weights.
export const MAX_LAYERS = 96;

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

// The shader of one half of the canvas. Renderers in software evaluate both sides of a branch, so that what is the same
// for all pixels is chosen when the shader is compiled: KIND, NEAREST, CURVE.
const FRAGMENT = `
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray layers;
uniform sampler2DArray small; // of a preview, at its own size
uniform sampler2D plane;      // of an overlay
uniform sampler2D sharp;      // stored numbers at the photo's own size
uniform vec3 weights[${MAX_LAYERS}], smallWeights[${MAX_LAYERS}];
uniform int places[${MAX_LAYERS}], smallPlaces[${MAX_LAYERS}]; // the layers of the weights
uniform int count, smallCount;
uniform ivec2 photo;          // the layer that is the photo, of the picture and of a preview
uniform vec2 photoScale;      // its scale there
uniform vec2 size;            // of a layer, pixels
uniform vec2 origin;          // of the picture, pixels of the canvas, from its top left
uniform float zoom;           // pixels of the canvas per pixel of a layer
uniform float height;         // of the canvas
uniform float exposure, gamma;
uniform int taps, mode;
uniform float planeScale, planeLow, planeHigh;
uniform vec3 surround;
out vec4 shown;

vec3 srgb(vec3 l) {
  return mix(1.055 * pow(l, vec3(1.0 / 2.4)) - 0.055, 12.92 * l, vec3(lessThanEqual(l, vec3(0.0031308))));
}

vec3 encode(vec3 linear) {
  vec3 l = clamp(linear, 0.0, 1.0);
#if CURVE == 0
  return l;
#elif CURVE == 1
  return pow(l, vec3(1.0 / gamma));
#else
  return srgb(l);
#endif
}

vec3 layer(vec2 at, int k) {
#if NEAREST
  return texelFetch(layers, ivec3(ivec2(at), k), 0).rgb;
#else
  return texture(layers, vec3(at / size, float(k))).rgb;
#endif
}

// The sum of the layers at a position in their pixels; where a canvas pixel covers several, the mean in linear light.
vec3 sum(vec2 at) {
  vec3 total = vec3(0.0);
  for (int tap = 0; tap < taps * taps; tap++) {
    vec2 offset = ((vec2(tap % taps, tap / taps) + 0.5) / float(taps) - 0.5) / zoom;
    vec2 there = clamp(at + offset, vec2(0.0), size - 0.001);
    for (int k = 0; k < count; k++) total += weights[k] * layer(there, places[k]);
  }
  return total / float(taps * taps);
}

#if KIND == 1
// A preview is coarse: the photo over its coarse self gives it detail.
vec3 previewed(vec2 at) {
  vec3 total = vec3(0.0);
  for (int k = 0; k < smallCount; k++) total += smallWeights[k] * texture(small, vec3(at / size, float(smallPlaces[k]))).rgb;
  vec3 coarse = photoScale.y * texture(small, vec3(at / size, float(photo.y))).rgb;
  vec3 detail = clamp(photoScale.x * layer(at, photo.x) / max(coarse, 1e-4), 0.0, 8.0);
  return total * mix(vec3(1.0), detail, vec3(greaterThan(coarse, vec3(1e-4))));
}
#endif

// Dark blue, teal, yellow: lightness rises evenly.
vec3 heat(float t) {
  vec3 low = mix(vec3(0.07, 0.05, 0.25), vec3(0.13, 0.45, 0.55), clamp(2.0 * t, 0.0, 1.0));
  return mix(low, vec3(0.98, 0.90, 0.40), clamp(2.0 * t - 1.0, 0.0, 1.0));
}

vec3 color(vec2 at) {
#if KIND == 0
  return encode(exposure * sum(at));
#elif KIND == 1
  return encode(exposure * previewed(at));
#elif KIND == 2
  return texture(sharp, at / size).rgb;
#else
  vec3 v = texture(plane, at / size).rgb * planeScale;
  float t = clamp((v.r - planeLow) / (planeHigh - planeLow), 0.0, 1.0);
#if KIND == 4
  return mix(vec3(dot(encode(exposure * sum(at)), vec3(0.2126, 0.7152, 0.0722))), vec3(1.0, 0.45, 0.0), 0.85 * t);
#else
  if (mode == 1) return vec3(t);
  if (mode == 2) return srgb(clamp(v, 0.0, 1.0));
  if (mode == 3) return 0.5 + 0.5 * v;
  return heat(mode == 4 ? 1.0 - t : t);
#endif
#endif
}

void main() {
  vec2 at = (vec2(gl_FragCoord.x, height - gl_FragCoord.y) - origin) / zoom;
  bool outside = any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, size));
  shown = vec4(outside ? surround : color(clamp(at, vec2(0.0), size - 0.001)), 1.0);
}`;

// Of a half: a sum of layers, of a preview's, a picture in stored numbers, a plane, and a plane over the picture.
const KINDS = { layers: 0, preview: 1, sharp: 2, plane: 3, guess: 4 };

export const MODES = { picture: 0, gray: 1, color: 2, normal: 3, depth: 4, heat: 5, guess: 6 };

export const gammaOf = (transfer) => (transfer?.Gamma ? transfer.Gamma : transfer === "Linear" ? 0 : -1);

// From halves channel by channel to pixels.
export function interleaved(planar, channels) {
  if (channels === 1) return planar;
  const pixels = planar.length / 3;
  const out = new Uint16Array(planar.length);
  for (let p = 0; p < pixels; p++) {
    out[3 * p] = planar[p];
    out[3 * p + 1] = planar[pixels + p];
    out[3 * p + 2] = planar[2 * pixels + p];
  }
  return out;
}

// A renderer on a canvas, or undefined where the browser has no WebGL2.
export function createGl(canvas) {
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: false, powerPreference: "high-performance" });
  if (!gl) return undefined;
  let programs, textures, target;
  // The layers of the picture, and those of a preview.
  let main = array(0), small = array(5);
  let planeOf, sharpOf = [];

  const UNITS = { layers: 0, plane: 2, small: 5 };
  const SHARP = [3, 4];

  // The program for a half of the canvas, compiled when it is first needed.
  function program(...choice) {
    const key = choice.join();
    if (programs.has(key)) return programs.get(key);
    const made = gl.createProgram();
    const head = `#version 300 es\n#define KIND ${choice[0]}\n#define NEAREST ${choice[1]}\n#define CURVE ${choice[2]}\n`;
    for (const [type, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, head + FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    const at = new Map();
    const uniform = (name) => { if (!at.has(name)) at.set(name, gl.getUniformLocation(made, name)); return at.get(name); };
    gl.useProgram(made);
    for (const [name, unit] of Object.entries(UNITS)) gl.uniform1i(uniform(name), unit);
    programs.set(key, { made, uniform });
    return programs.get(key);
  }

  function begin() {
    programs = new Map();
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    textures = { plane: texture(gl.TEXTURE_2D, gl.LINEAR, UNITS.plane), sharp: SHARP.map((unit) => texture(gl.TEXTURE_2D, gl.NEAREST, unit)) };
    // A texture without an image is incomplete, and some drivers warn.
    for (const unit of [UNITS.plane, ...SHARP]) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    }
    main = array(UNITS.layers);
    small = array(UNITS.small);
    target = planeOf = undefined;
    sharpOf = [];
  }

  function texture(kind, filter, unit) {
    const made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, made);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(kind, name, gl.CLAMP_TO_EDGE);
    return made;
  }

  // An array of layers on a texture unit: of each place the digest that it holds, of each layer of the picture its place.
  function array(unit) {
    return { unit, held: [], places: [], size: [0, 0], capacity: 0, texture: undefined };
  }
  const isHeld = (digest) => main.held.includes(digest);

  // layers: [{ digest, halves }] of one size. What the GPU holds stays at its place, and needs no halves.
  function fill(into, layers, width, height) {
    gl.activeTexture(gl.TEXTURE0 + into.unit);
    if (width !== into.size[0] || height !== into.size[1] || layers.length > into.capacity) {
      if (layers.some((each) => !each.halves)) return false;
      if (into.texture) gl.deleteTexture(into.texture);
      // Some room for lights that are inserted.
      into.capacity = layers.length + 2;
      into.texture = texture(gl.TEXTURE_2D_ARRAY, gl.LINEAR, into.unit);
      into.size = [width, height];
      into.held = Array(into.capacity).fill(undefined);
      gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGB16F, width, height, into.capacity);
    }
    const wanted = new Set(layers.map((each) => each.digest));
    into.held = into.held.map((digest) => (wanted.has(digest) ? digest : undefined));
    for (const { digest, halves } of layers) {
      if (into.held.includes(digest)) continue;
      if (!halves) return false;
      const free = into.held.indexOf(undefined);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, free, width, height, 1, gl.RGB, gl.HALF_FLOAT, interleaved(halves, 3));
      into.held[free] = digest;
    }
    into.places = layers.map((each) => into.held.indexOf(each.digest));
    return true;
  }
  // Whether all layers could be placed; else they are needed with their halves.
  const setLayers = (layers, width, height) => fill(main, layers, width, height);
  const setSmall = (layers, width, height) => fill(small, layers, width, height);

  // What of an array is to be summed: places and weights of all that is not dark.
  function summed(into, weights) {
    const used = into.places.map((place, k) => [place, weights[k]]).filter(([, w]) => w.some((x) => x !== 0)).slice(0, MAX_LAYERS);
    return { count: used.length, places: new Int32Array(used.map(([place]) => place)), weights: new Float32Array(used.flatMap(([, w]) => w)) };
  }

  function setPlane(digest, halves, width, height, channels) {
    if (planeOf === digest) return;
    planeOf = digest;
    gl.activeTexture(gl.TEXTURE0 + UNITS.plane);
    const [inner, format] = channels === 1 ? [gl.R16F, gl.RED] : [gl.RGB16F, gl.RGB];
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, gl.HALF_FLOAT, interleaved(halves, channels));
  }

  // A picture of the photo's own size, in stored numbers; which: 0 picture, 1 photo.
  function setSharp(which, key, bitmap) {
    if (sharpOf[which] === key) return;
    sharpOf[which] = key;
    gl.activeTexture(gl.TEXTURE0 + SHARP[which]);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
  }

  const maxSharp = () => gl.getParameter(gl.MAX_TEXTURE_SIZE);

  // scene: { weights ([[r, g, b]] with the scales in), photo: { at (number of its layer), scale }, preview: the same two
  // or undefined, exposure, transfer, view: { zoom, x, y }, wipe, mode, plane: { scale, low, high }, sharp: [bool, bool], surround }
  // Draws columns from..to; isPhoto: of the photo.
  function half(scene, height, view, [from, to], isPhoto) {
    if (to <= from) return;
    const preview = !isPhoto && scene.preview && small.places.length === scene.preview.weights.length ? scene.preview : undefined;
    const overlay = !isPhoto && planeOf !== undefined && scene.mode !== "picture";
    const kind = overlay ? (scene.mode === "guess" ? KINDS.guess : KINDS.plane) : scene.sharp?.[Number(isPhoto)] ? KINDS.sharp : preview ? KINDS.preview : KINDS.layers;
    const gamma = gammaOf(scene.transfer);
    const { made, uniform } = program(kind, Number(view.zoom >= 2 || view.zoom === 1), gamma < 0 ? 2 : gamma > 0 ? 1 : 0);
    gl.useProgram(made);
    const sum = (into, weights, names) => {
      const { count, places, weights: rgb } = summed(into, weights);
      gl.uniform1i(uniform(names[0]), count);
      if (count === 0) return;
      gl.uniform1iv(uniform(names[1]), places);
      gl.uniform3fv(uniform(names[2]), rgb);
    };
    const { photo } = scene;
    sum(main, isPhoto ? scene.weights.map((_, k) => Array(3).fill(k === photo.at ? photo.scale : 0)) : scene.weights, ["count", "places", "weights"]);
    if (preview) {
      sum(small, preview.weights, ["smallCount", "smallPlaces", "smallWeights"]);
      gl.uniform2i(uniform("photo"), main.places[photo.at], small.places[preview.photo.at]);
      gl.uniform2f(uniform("photoScale"), photo.scale, preview.photo.scale);
    }
    gl.uniform1i(uniform("sharp"), SHARP[Number(isPhoto)]);
    gl.uniform2f(uniform("size"), ...main.size);
    gl.uniform2f(uniform("origin"), view.x, view.y);
    gl.uniform1f(uniform("zoom"), view.zoom);
    gl.uniform1f(uniform("height"), height);
    gl.uniform1f(uniform("exposure"), scene.exposure);
    gl.uniform1f(uniform("gamma"), gamma);
    gl.uniform1i(uniform("taps"), Math.min(4, Math.max(1, Math.ceil(0.5 / view.zoom))));
    gl.uniform1i(uniform("mode"), MODES[scene.mode] ?? 0);
    gl.uniform1f(uniform("planeScale"), scene.plane?.scale ?? 1);
    gl.uniform1f(uniform("planeLow"), scene.plane?.low ?? 0);
    gl.uniform1f(uniform("planeHigh"), scene.plane?.high ?? 1);
    gl.uniform3f(uniform("surround"), ...(scene.surround ?? [0.5, 0.5, 0.5]));
    gl.scissor(from, 0, to - from, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function paint(scene, width, height, view, wipe) {
    gl.viewport(0, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    const edge = Math.min(width, Math.max(0, Math.round(wipe)));
    half(scene, height, view, [0, edge], true);
    half(scene, height, view, [edge, width], false);
    gl.disable(gl.SCISSOR_TEST);
  }

  function draw(scene) {
    if (main.places.length === 0) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    paint(scene, canvas.width, canvas.height, scene.view, scene.wipe);
  }

  // The picture alone at a size, in stored numbers from the top: RGBA.
  function read(scene, width = main.size[0], height = main.size[1]) {
    if (main.places.length === 0) return undefined;
    if (!target || target.width !== width || target.height !== height) {
      if (target) { gl.deleteRenderbuffer(target.buffer); gl.deleteFramebuffer(target.frame); }
      target = { width, height, buffer: gl.createRenderbuffer(), frame: gl.createFramebuffer() };
      gl.bindRenderbuffer(gl.RENDERBUFFER, target.buffer);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, width, height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, target.buffer);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    paint({ ...scene, mode: "picture", sharp: undefined }, width, height, { zoom: width / main.size[0], x: 0, y: 0 }, 0);
    const flipped = new Uint8Array(4 * width * height), out = new Uint8ClampedArray(flipped.length);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, flipped);
    for (let y = 0; y < height; y++) out.set(flipped.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    return new ImageData(out, width, height);
  }

  begin();
  return { kind: "WebGL2", isHeld, setLayers, setSmall, setPlane, setSharp, maxSharp, draw, read, restore: begin };
}
