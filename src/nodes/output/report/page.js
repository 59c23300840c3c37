// The page of a run: light is summed as the program sums it, linear, then goes through the photo's encoding. layers.js
// stands before this text.
const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
const { report, size: [width, height], lights } = data;

const make = (name, text, className) => {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
};

// The packed layers of the data.
const unpack = async ({ scale, packed }) => linear(await halves(Uint8Array.from(atob(packed), (c) => c.charCodeAt(0))), scale);

const TABLE = storedTable(data.transfer);

function show(canvas, sum) {
  canvas.width = width;
  canvas.height = height;
  canvas.getContext("2d").putImageData(encoded(sum, width, height, TABLE), 0, 0);
}

// ---- Light mix -------------------------------------------------------------------------------------------------------

// Per light: how much, and a colour whose largest part is 1.
const state = lights.map(() => ({ gain: 1, tint: [1, 1, 1] }));
const rows = [];
let rest, waiting = false;

const weight = ({ gain, tint }) => tint.map((channel) => gain * channel);

function mix() {
  waiting = false;
  const sum = new Float32Array(rest);
  lights.forEach((light, k) => {
    addLayer(sum, light.linear, weight(state[k]));
  });
  show(byId("picture"), sum);
  document.documentElement.dataset.mixed = fragment();
}

const digits = (x) => String(Number(x.toPrecision(4)));

// The state as text, only what differs from the run: lamp_0=0.5&inv_lamp=1,0.63,0.35
function fragment() {
  const changed = lights.map((light, k) => [light.id, weight(state[k])]).filter(([, w]) => w.some((x) => x !== 1));
  return changed.map(([id, w]) => id + "=" + (w.every((x) => x === w[0]) ? digits(w[0]) : w.map(digits).join(","))).join("&");
}

// What follows # in the address: a weight is 0.5, or 2,1,0.5, or ffd0a0, or 0.5*ffd0a0.
function take(text) {
  state.forEach((s) => { s.gain = 1; s.tint = [1, 1, 1]; });
  for (const part of decodeURIComponent(text).split("&")) {
    const [id, value = ""] = part.split("=");
    const k = lights.findIndex((light) => light.id === id);
    if (k < 0) continue;
    const [factor, colour] = value.includes("*") ? value.split("*") : ["1", value];
    const hex = /^#?([0-9a-f]{6})$/i.exec(colour);
    const numbers = hex ? fromHex(hex[1]) : colour.split(",").map(Number);
    const rgb = (numbers.length === 3 ? numbers : [numbers[0], numbers[0], numbers[0]]).map((x) => x * Number(factor));
    if (!rgb.every((x) => Number.isFinite(x) && x >= 0)) continue;
    const most = Math.max(...rgb);
    state[k] = { gain: most, tint: most > 0 ? rgb.map((x) => x / most) : [1, 1, 1] };
  }
}

// Controls after the state, and a mix before the next frame; `from` is the control that a person is moving.
function changed(from) {
  rows.forEach((row, k) => {
    const { gain, tint } = state[k];
    if (row.slider !== from) row.slider.value = Math.sqrt(gain);
    if (row.number !== from) row.number.value = digits(gain);
    if (row.colour !== from) row.colour.value = toHex(tint);
  });
  const now = fragment();
  byId("command").textContent = "relight mix ." + now.split("&").filter(Boolean).map((part) => " --set " + part).join("") + " --out mix";
  try { history.replaceState(null, "", now ? "#" + now : location.pathname + location.search); } catch { /* some viewers forbid it */ }
  if (!waiting) requestAnimationFrame(mix);
  waiting = true;
}

function light(k) {
  const row = make("div", undefined, "light");
  const control = (type, label, attributes) => {
    const input = Object.assign(make("input"), { type, ...attributes });
    input.setAttribute("aria-label", `${lights[k].id}: ${label}`);
    return input;
  };
  // The slider is the square root of the weight: fine steps where little light is.
  const slider = control("range", "weight", { min: 0, max: 2, step: 0.005, value: 1 });
  const number = control("number", "weight", { min: 0, step: 0.1, value: 1 });
  const colour = control("color", "colour", { value: "#ffffff" });
  slider.dataset.light = lights[k].id;
  slider.addEventListener("input", () => { state[k].gain = Number(slider.value) ** 2; changed(slider); });
  number.addEventListener("input", () => {
    const gain = Number(number.value);
    if (number.value !== "" && Number.isFinite(gain) && gain >= 0) { state[k].gain = gain; changed(number); }
  });
  colour.addEventListener("input", () => { state[k].tint = fromHex(colour.value.slice(1)); changed(colour); });
  const name = make("b", lights[k].id);
  if (lights[k].dark) name.append(" ", make("small", "gives no light in this run"));
  row.append(make("canvas"), name, slider, number, colour);
  rows.push({ slider, number, colour, thumbnail: row.firstChild });
  byId("lights").append(row);
}

// ---- Planes ------------------------------------------------------------------------------------------------------------

function figure(content, caption) {
  const figure = make("figure");
  if (content) figure.append(content);
  if (caption) figure.append(make("figcaption", caption));
  return figure;
}

function plane(source, alt) {
  return source ? Object.assign(make("img"), { src: source, alt }) : undefined;
}

function layers() {
  const grid = byId("layers");
  ["", "light", "shadow", "unknown", "standard error", "guesswork"].forEach((text) => grid.append(make("span", text, "head")));
  for (const light of [...lights, data.rest].filter((layer) => !layer.dark)) {
    const canvas = make("canvas");
    show(canvas, light.linear);
    grid.append(
      make("b", light.id),
      figure(canvas),
      figure(plane(light.shadow, `shadow of ${light.id}`), light.shadow && `${percent(light.lit)} lit`),
      figure(plane(light.unknown, `unknown share of ${light.id}`), light.unknown && `${percent(light.unknown_share)} unknown`),
      figure(plane(light.stderr, `standard error of ${light.id}`), light.stderr && `white is ${light.stderr_white.toPrecision(2)}`),
      figure(plane(light.room_error, `guesswork in ${light.id}`), light.room_error && `\u00b1 ${percent(light.room_share)} by the unseen room`),
    );
  }
  rows.forEach((row, k) => show(row.thumbnail, lights[k].linear));
}

const percent = (share) => (share === 0 ? "0 %" : `${(100 * share).toPrecision(2)} %`);

// ---- Room --------------------------------------------------------------------------------------------------------------

function room() {
  if (!data.room) return;
  const svg = roomBox(data.room, width, height);
  if (data.photo) {
    const photo = document.createElementNS("http://www.w3.org/2000/svg", "image");
    Object.entries({ href: data.photo, width, height, opacity: 0.7 }).forEach(([key, value]) => photo.setAttribute(key, value));
    svg.prepend(photo);
  }
  const section = byId("room");
  section.hidden = false;
  section.insertBefore(svg, section.querySelector("ul"));
  const rays = report.nodes.filter((node) => node.kind === "Transport").flatMap((node) => node.notes);
  const lines = [...data.room.summary.split(", "), ...new Set(rays)];
  lines.forEach((line) => section.querySelector("ul").append(make("li", line)));
}

// ---- Tables --------------------------------------------------------------------------------------------------------------

function tables() {
  const most = Math.max(1e-9, ...report.nodes.map((node) => node.seconds));
  for (const node of report.nodes) {
    const row = make("tr", undefined, node.status);
    const ran = node.status === "ran" || node.status === "failed";
    const cell = (text, className) => row.appendChild(make("td", text, className));
    cell(node.name);
    cell(node.kind);
    cell(node.status, `status ${node.status}`);
    cell(ran ? node.seconds.toFixed(3) : "", "n");
    const bar = cell("").appendChild(make("span", undefined, "time"));
    bar.style.width = ran ? `${(100 * node.seconds) / most}%` : "0";
    bar.hidden = !ran;
    cell(node.rays ? node.rays.toLocaleString("en") : "", "n");
    cell(node.samples === null ? "" : node.samples.toFixed(1), "n");
    cell(node.stderr === null ? "" : percent(node.stderr), "n");
    cell(node.bytes ? (node.bytes / 1e6).toFixed(2) : "", "n");
    cell(node.why ?? "");
    document.querySelector("#nodes tbody").append(row);
  }
  const list = (id, lines) => {
    byId(id).hidden = lines.length === 0;
    lines.forEach((line) => byId(id).querySelector("ul").append(make("li", line)));
  };
  list("warnings", report.warnings);
  list("notes", report.nodes.flatMap((node) => node.notes.map((note) => `${node.name}: ${note}`)));
  const count = (status) => report.nodes.filter((node) => node.status === status).length;
  byId("edit").textContent = `${report.edit ?? "no change"} on ${report.graph}`;
  const facts = [`${count("hit")} hit`, `${count("ran")} ran`, `${report.seconds.toFixed(2)} s`, `${report.threads} threads`];
  if (report.backend) facts.push(report.backend);
  byId("facts").textContent = facts.join(" \u00b7 ");
}

// ---- Begin ---------------------------------------------------------------------------------------------------------------

async function begin() {
  tables();
  room();
  const [full, tall] = data.full;
  byId("size").textContent = full === width ? `${full} x ${tall}` : `${full} x ${tall}, shown at ${width} x ${height}`;
  if (data.photo) byId("before").src = data.photo;
  else document.querySelector(".wipe").style.setProperty("--at", "0%");
  lights.forEach((_, k) => light(k));
  await Promise.all([data.rest, ...lights].map(async (layer) => { layer.linear = await unpack(layer); }));
  rest = data.rest.linear;
  layers();
  take(location.hash.slice(1));
  changed();
  const split = byId("split");
  split.addEventListener("input", () => split.parentElement.style.setProperty("--at", `${split.value}%`));
  window.addEventListener("hashchange", () => { take(location.hash.slice(1)); changed(); });
  byId("reset").addEventListener("click", () => { take(""); changed(); });
  byId("save").addEventListener("click", (event) => { event.currentTarget.href = byId("picture").toDataURL(); });
  byId("only").addEventListener("change", (event) => byId("nodes").classList.toggle("quiet", event.target.checked));
}

begin().catch((error) => {
  byId("facts").textContent = `This browser cannot show the layers: ${error}`;
});
