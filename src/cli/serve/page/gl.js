// The picture on the GPU: encode(exposure * (rest + sum of weight * layer)) at every pixel of the canvas.
//
// All layers are one array of RGB16F textures. The scale of a layer, a power of two, is part of its weight.

// Layers of a picture. WebGL2 promises 224 uniforms, and there are two rows of weights.
export const MAX_LAYERS = 96;

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray layers;
uniform sampler2DArray small; // of a preview, at its own size
uniform vec3 weights[${MAX_LAYERS}], smallWeights[${MAX_LAYERS}];
uniform ivec2 photo;          // the layer that is the photo, of the picture and of a preview
uniform vec2 photoScale;      // its scale there, 0 without a photo
uniform sampler2D plane;      // of an overlay
uniform sampler2D sharp[2];   // picture and photo in stored numbers, of the photo's own size
uniform bvec2 isSharp;
uniform int count, smallCount; // of layers; a preview has some
uniform vec2 size;            // of a layer, pixels
uniform vec2 origin;          // of the picture, pixels of the canvas, from its top left
uniform float zoom;           // pixels of the canvas per pixel of a layer
uniform float height;         // of the canvas
uniform float wipe;           // pixels of the canvas left of which the photo is
uniform float exposure;
uniform float gamma;          // 0 for linear, -1 for sRGB
uniform int mode;
uniform float planeScale, planeLow, planeHigh;
uniform vec3 surround;
out vec4 shown;

vec3 encode(vec3 linear) {
  vec3 l = clamp(linear, 0.0, 1.0);
  if (gamma == 0.0) return l;
  if (gamma > 0.0) return pow(l, vec3(1.0 / gamma));
  return mix(1.055 * pow(l, vec3(1.0 / 2.4)) - 0.055, 12.92 * l, vec3(lessThanEqual(l, vec3(0.0031308))));
}

vec3 srgb(vec3 linear) {
  vec3 l = clamp(linear, 0.0, 1.0);
  return mix(1.055 * pow(l, vec3(1.0 / 2.4)) - 0.055, 12.92 * l, vec3(lessThanEqual(l, vec3(0.0031308))));
}

vec3 layer(vec2 at, int k) {
  return zoom >= 2.0 || zoom == 1.0 ? texelFetch(layers, ivec3(ivec2(at), k), 0).rgb : texture(layers, vec3(at / size, float(k))).rgb;
}

// The sum of the layers, or the photo, at a position in pixels of a layer.
vec3 sum(vec2 at, bool isPhoto) {
  if (isPhoto) return photoScale.x * layer(at, photo.x);
  vec3 total = vec3(0.0);
  for (int k = 0; k < count; k++)
    if (weights[k] != vec3(0.0)) total += weights[k] * layer(at, k);
  return total;
}

// Where a canvas pixel covers several of a layer, their mean, in linear light.
vec3 sampled(vec2 at, bool isPhoto) {
  int taps = clamp(int(ceil(0.5 / zoom)), 1, 4);
  if (taps == 1) return sum(at, isPhoto);
  vec3 total = vec3(0.0);
  for (int y = 0; y < taps; y++)
    for (int x = 0; x < taps; x++) {
      vec2 offset = ((vec2(x, y) + 0.5) / float(taps) - 0.5) / zoom;
      total += sum(clamp(at + offset, vec2(0.0), size - 0.001), isPhoto);
    }
  return total / float(taps * taps);
}

// A preview is coarse: the photo over its coarse self gives it detail.
vec3 previewed(vec2 at) {
  vec3 total = vec3(0.0);
  for (int k = 0; k < smallCount; k++)
    if (smallWeights[k] != vec3(0.0)) total += smallWeights[k] * texture(small, vec3(at / size, float(k))).rgb;
  if (photoScale.y == 0.0) return total;
  vec3 coarse = photoScale.y * texture(small, vec3(at / size, float(photo.y))).rgb;
  vec3 detail = clamp(sampled(at, true) / max(coarse, 1e-4), 0.0, 8.0);
  return total * mix(vec3(1.0), detail, vec3(greaterThan(coarse, vec3(1e-4))));
}

vec3 picture(vec2 at, bool isPhoto) {
  if (!isPhoto && isSharp.x) return texture(sharp[0], at / size).rgb;
  if (isPhoto && isSharp.y) return texture(sharp[1], at / size).rgb;
  return encode(exposure * (!isPhoto && smallCount > 0 ? previewed(at) : sampled(at, isPhoto)));
}

// Dark blue, teal, yellow: lightness rises evenly.
vec3 heat(float t) {
  vec3 low = mix(vec3(0.07, 0.05, 0.25), vec3(0.13, 0.45, 0.55), clamp(2.0 * t, 0.0, 1.0));
  return mix(low, vec3(0.98, 0.90, 0.40), clamp(2.0 * t - 1.0, 0.0, 1.0));
}

void main() {
  vec2 at = (vec2(gl_FragCoord.x, height - gl_FragCoord.y) - origin) / zoom;
  if (any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, size))) { shown = vec4(surround, 1.0); return; }
  vec3 color;
  if (gl_FragCoord.x < wipe) color = picture(at, true);
  else if (mode == 0) color = picture(at, false);
  else {
    vec3 v = texture(plane, at / size).rgb * planeScale;
    float t = clamp((v.r - planeLow) / (planeHigh - planeLow), 0.0, 1.0);
    if (mode == 1) color = vec3(t);
    else if (mode == 2) color = srgb(v);
    else if (mode == 3) color = 0.5 + 0.5 * v;
    else if (mode == 4) color = heat(1.0 - t);
    else if (mode == 5) color = heat(t);
    else color = mix(vec3(dot(picture(at, false), vec3(0.2126, 0.7152, 0.0722))), vec3(1.0, 0.45, 0.0), 0.85 * t);
  }
  shown = vec4(color, 1.0);
}`;

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
  let program, places, textures, target;
  // The layers of the picture, and those of a preview.
  let main = array(0), small = array(5);
  let planeOf, sharpOf = [];

  function compile() {
    program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    const names = ["layers", "small", "weights", "smallWeights", "photo", "photoScale", "plane", "sharp", "isSharp", "count", "smallCount", "size", "origin", "zoom", "height", "wipe", "exposure", "gamma", "mode", "planeScale", "planeLow", "planeHigh", "surround"];
    places = Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)]));
    gl.uniform1i(places.layers, 0);
    gl.uniform1i(places.plane, 2);
    gl.uniform1iv(places.sharp, [3, 4]);
    gl.uniform1i(places.small, 5);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    textures = { plane: texture(gl.TEXTURE_2D, gl.LINEAR, 2), sharp: [3, 4].map((unit) => texture(gl.TEXTURE_2D, gl.NEAREST, unit)) };
    // A texture without an image is incomplete, and some drivers warn.
    for (const unit of [2, 3, 4]) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    }
    main = array(0);
    small = array(5);
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

  // Weights by place.
  function placed(into, weights) {
    const row = new Float32Array(3 * MAX_LAYERS);
    into.places.forEach((place, k) => { if (place < MAX_LAYERS) weights[k].forEach((w, c) => { row[3 * place + c] += w; }); });
    return row;
  }

  function setPlane(digest, halves, width, height, channels) {
    if (planeOf === digest) return;
    planeOf = digest;
    gl.activeTexture(gl.TEXTURE2);
    const [inner, format] = channels === 1 ? [gl.R16F, gl.RED] : [gl.RGB16F, gl.RGB];
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, gl.HALF_FLOAT, interleaved(halves, channels));
  }

  // A picture of the photo's own size, in stored numbers; which: 0 picture, 1 photo.
  function setSharp(which, key, bitmap) {
    if (sharpOf[which] === key) return;
    sharpOf[which] = key;
    gl.activeTexture(gl.TEXTURE3 + which);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
  }

  const maxSharp = () => gl.getParameter(gl.MAX_TEXTURE_SIZE);

  // scene: { weights ([[r, g, b]] with the scales in), photo: { at (number of its layer), scale }, preview: the same two
  // or undefined, exposure, transfer, view: { zoom, x, y }, wipe, mode, plane: { scale, low, high }, sharp: [bool, bool], surround }
  function paint(scene, height, view, wipe) {
    const preview = small.places.length === scene.preview?.weights.length ? scene.preview : undefined;
    gl.uniform3fv(places.weights, placed(main, scene.weights));
    if (preview) gl.uniform3fv(places.smallWeights, placed(small, preview.weights));
    gl.uniform2i(places.photo, main.places[scene.photo.at], preview ? small.places[preview.photo.at] : 0);
    gl.uniform2f(places.photoScale, scene.photo.scale, preview?.photo.scale ?? 0);
    gl.uniform2i(places.isSharp, ...(scene.sharp ?? [false, false]).map(Number));
    gl.uniform1i(places.count, Math.min(MAX_LAYERS, main.capacity));
    gl.uniform1i(places.smallCount, preview ? Math.min(MAX_LAYERS, small.capacity) : 0);
    gl.uniform2f(places.size, ...main.size);
    gl.uniform2f(places.origin, view.x, view.y);
    gl.uniform1f(places.zoom, view.zoom);
    gl.uniform1f(places.height, height);
    gl.uniform1f(places.wipe, wipe);
    gl.uniform1f(places.exposure, scene.exposure);
    gl.uniform1f(places.gamma, gammaOf(scene.transfer));
    gl.uniform1i(places.mode, planeOf === undefined ? 0 : MODES[scene.mode] ?? 0);
    gl.uniform1f(places.planeScale, scene.plane?.scale ?? 1);
    gl.uniform1f(places.planeLow, scene.plane?.low ?? 0);
    gl.uniform1f(places.planeHigh, scene.plane?.high ?? 1);
    gl.uniform3f(places.surround, ...(scene.surround ?? [0.5, 0.5, 0.5]));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function draw(scene) {
    if (main.places.length === 0) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    paint(scene, canvas.height, scene.view, scene.wipe);
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
    gl.viewport(0, 0, width, height);
    paint({ ...scene, sharp: [false, false] }, height, { zoom: width / main.size[0], x: 0, y: 0 }, 0);
    const flipped = new Uint8Array(4 * width * height), out = new Uint8ClampedArray(flipped.length);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, flipped);
    for (let y = 0; y < height; y++) out.set(flipped.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    return new ImageData(out, width, height);
  }

  compile();
  return { kind: "WebGL2", isHeld, setLayers, setSmall, setPlane, setSharp, maxSharp, draw, read, restore: compile };
}
