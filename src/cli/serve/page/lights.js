// The panel of lights: a row for each, whose controls write the light's entry.
import { model, on, change, settle, lights, weights, say } from "./model.js";
import * as e from "./edit.js";
import { field, values, numbers, digits, number } from "./ron.js";
import { fromHex, toHex } from "./layers.js";
import { view, redraw } from "./view.js";
import { byId, make, labelled, showValue } from "./dom.js";
import { sunDial } from "./sun.js";

const STOPS = [-8, 6];
const KELVIN = [1000, 12000];
const rows = new Map();

// ---- What an entry says ------------------------------------------------------------------------------------------------------

const numberOf = (node) => (node?.kind === "number" && Number.isFinite(node.value) ? node.value : undefined);
const hasKeys = (entry) => /\bKeys\s*\(/.test(entry?.text ?? "");

// What a light's row shows: { isOn, stops, level (in words), kelvin, hex }.
function reading({ own, entry }) {
  const node = entry?.node;
  if (!own && !e.isMade(node)) {
    const scale = e.change(node, "Scale"), kelvin = e.change(node, "Temperature"), color = e.change(node, "Color");
    const factor = scale ? numberOf(values(scale)[0]) ?? 1 : 1;
    const rgb = color && numbers(color);
    const most = Math.max(...(rgb ?? [1]));
    const switched = e.change(node, "On");
    return {
      isOn: !e.isOff(node),
      stops: factor > 0 ? Math.log2(factor) : STOPS[0],
      level: factor > 0 ? `${signed(Math.log2(factor))} EV` : "0",
      kelvin: kelvin ? numberOf(values(kelvin)[0]) : numberOf(field(switched, "temperature")),
      hex: rgb?.every(Number.isFinite) ? toHex(rgb.map((x) => x / most)) : undefined,
      flux: numberOf(field(switched, "flux")),
      moved: Boolean(e.change(node, "Move")),
    };
  }
  const isOn = !entry.off;
  const of = (key) => numberOf(field(node, key));
  if (node.name === "Lamp") {
    const rgb = field(node, "radiance") && numbers(field(node, "radiance"));
    if (rgb?.every(Number.isFinite)) {
      const most = Math.max(...rgb);
      return { isOn, stops: most > 0 ? Math.log2(most) : STOPS[0], level: digits(most), hex: most > 0 ? toHex(rgb.map((x) => x / most)) : "#ffffff" };
    }
    const flux = of("flux");
    return { isOn, stops: flux > 0 ? Math.log2(flux / 800) : undefined, level: flux === undefined ? "" : `${digits(flux)} lm`, kelvin: of("temperature") ?? 2700, inserted: true };
  }
  const sky = field(node, "sky");
  if (!sky || sky.name === "Radiance") {
    const rgb = sky ? numbers(sky) : [4, 4.4, 5], most = Math.max(...rgb);
    return { isOn, stops: most > 0 ? Math.log2(most) : STOPS[0], level: digits(most), hex: most > 0 ? toHex(rgb.map((x) => x / most)) : "#ffffff" };
  }
  const scale = of("scale") ?? 1;
  return { isOn, stops: scale > 0 ? Math.log2(scale) : STOPS[0], level: `x ${digits(scale)}` };
}

const signed = (x) => `${x > 0 ? "+" : x < 0 ? "\u2212" : ""}${number(Math.abs(x), 2)}`;

// ---- Changes of it -------------------------------------------------------------------------------------------------------------

const find = (id) => lights().find((each) => each.id === id);
const isChange = (light) => !light.own && !e.isMade(light.entry?.node);

// Runs a change of the text; a text that cannot be read has none.
function edit(id, name, f) {
  if (model.edit.error) return say("The text of the edit cannot be read; mend it first", true);
  const light = find(id);
  if (!light) return;
  try {
    change(f(model.text, light), name && `${id} ${name}`);
  } catch (error) {
    say(error.message, true);
  }
}

export function switchTo(id, isOn) {
  edit(id, undefined, (text, light) => (isChange(light) ? e.switchLight(text, id, isOn) : e.switchEntry(text, "lights", light.entry, isOn)));
}
export function toggle(id) {
  const light = find(id);
  if (!light) return;
  const isOn = !reading(light).isOn;
  switchTo(id, isOn);
  say(`${id} ${isOn ? "on" : "off"}`);
}

// A light that is off and gets a level or a color is switched on by it.
function awake(text, light) {
  if (isChange(light)) return e.switchLight(text, light.id, true);
  return e.switchEntry(text, "lights", light.entry, true);
}

function setStops(id, stops) {
  edit(id, "stops", (text, light) => {
    text = awake(text, light);
    const factor = 2 ** stops;
    if (isChange(light)) return e.setChange(text, id, "Scale", Math.abs(stops) < 1e-6 ? null : digits(factor));
    const node = e.light(e.read(text), id).node;
    const level = (rgb) => { const most = Math.max(...rgb) || 1; return rgb.map((x) => digits((x / most) * factor)).join(", "); };
    if (node.name === "Lamp") {
      const rgb = field(node, "radiance");
      return e.setFields(text, "lights", id, rgb ? { radiance: `(${level(numbers(rgb))})` } : { flux: digits(800 * factor) });
    }
    const sky = field(node, "sky");
    if (!sky || sky.name === "Radiance") return e.setFields(text, "lights", id, { sky: `Radiance(${level(sky ? numbers(sky) : [4, 4.4, 5])})` });
    return e.setFields(text, "lights", id, { scale: digits(factor) });
  });
}

function setFlux(id, flux) {
  edit(id, "flux", (text, light) => {
    text = awake(text, light);
    if (!isChange(light)) return e.setFields(text, "lights", id, { flux: digits(flux, 4) });
    return e.setChange(text, id, "On", flux === undefined ? null : `flux: ${digits(flux, 4)}`);
  });
}

function setKelvin(id, kelvin) {
  edit(id, "kelvin", (text, light) => {
    text = awake(text, light);
    const value = kelvin === undefined ? null : String(Math.round(kelvin));
    if (isChange(light)) return e.setChange(value === null ? e.setChange(text, id, "Color", null) : text, id, "Temperature", value);
    return e.setFields(text, "lights", id, { temperature: value });
  });
}

function setColor(id, hex) {
  edit(id, "color", (text, light) => {
    text = awake(text, light);
    const rgb = fromHex(hex), most = Math.max(...rgb);
    if (most === 0) return text;
    const color = rgb.map((x) => number(x / most));
    if (isChange(light)) return e.setChange(text, id, "Color", color.join(", "));
    const node = e.light(e.read(text), id).node;
    const as = (old) => rgb.map((x) => digits((x / most) * Math.max(...old))).join(", ");
    if (node.name === "Window") return e.setFields(text, "lights", id, { sky: `Radiance(${as(numbers(field(node, "sky")).length === 3 ? numbers(field(node, "sky")) : [4, 4.4, 5])})` });
    return e.setFields(text, "lights", id, { radiance: `(${as(numbers(field(node, "radiance")))})` });
  });
}

// ---- Rows ------------------------------------------------------------------------------------------------------------------------

export function toggleSolo(id, more = false) {
  const alone = view.solo.has(id) && view.solo.size === 1;
  if (more) { if (!view.solo.delete(id)) view.solo.add(id); }
  else { view.solo.clear(); if (!alone) view.solo.add(id); }
  update();
  redraw();
}

function slider(name, [min, max], step, act) {
  const range = make("input", { type: "range", min, max, step, "aria-label": name, oninput: () => act(Number(range.value)), onchange: settle });
  return range;
}

function row(light) {
  const { id } = light;
  const isOn = make("input", { type: "checkbox", class: "switch", role: "switch", "aria-label": `${id}: on`, onchange: () => switchTo(id, isOn.checked) });
  const solo = make("button", { class: "solo", type: "button", "aria-pressed": "false", title: "Show this light alone", "aria-label": `${id}: show alone`, onclick: (event) => toggleSolo(id, event.shiftKey) }, "S");
  const name = make("b", { class: "name" }, id);
  const kind = make("small", {});
  const head = make("div", { class: "head" }, isOn, name, kind, solo);

  const stops = slider(`${id}: stops`, STOPS, 0.05, (v) => setStops(id, v));
  const level = make("input", { type: "number", step: 0.1, min: -20, max: 20, "aria-label": `${id}: stops, in numbers`, onchange: () => { if (Number.isFinite(level.valueAsNumber)) { settle(); setStops(id, level.valueAsNumber); settle(); } } });
  const said = make("output", {});
  const kelvin = slider(`${id}: color temperature`, KELVIN, 50, (v) => setKelvin(id, v));
  const degrees = make("input", { type: "number", min: 1000, max: 40000, step: 100, "aria-label": `${id}: kelvin`, placeholder: "as is", onchange: () => { settle(); setKelvin(id, degrees.value === "" ? undefined : degrees.valueAsNumber); settle(); } });
  const color = make("input", { type: "color", "aria-label": `${id}: color`, title: "Color", oninput: () => setColor(id, color.value), onchange: settle });
  const controls = make("div", { class: "controls" }, make("span", {}, "stops"), stops, level, said, make("span", {}, "kelvin"), kelvin, degrees, color);

  const more = make("details", { class: "more" }, make("summary", {}, "more"));
  const body = make("div", { class: "body" });
  more.append(body);
  const stale = make("span", { class: "stale", title: "The picture shows this light as it was until the run is done" }, "rendering");
  const element = make("li", { class: "light", "data-light": id }, head, controls, more);
  head.insertBefore(stale, solo);
  return { element, isOn, solo, kind, stops, level, said, kelvin, degrees, color, more, body, stale, filled: "" };
}

const KINDS = { Lamp: "lamp", Window: "window" };

// What stands under "more": rename, position, flux, the sun, remove.
function fill(each, light) {
  const { id, own, entry } = light;
  const node = entry?.node;
  // As the entry has it, so that it is only made anew where it differs.
  const key = `${own} ${entry?.off ? "off" : ""} ${node && e.isMade(node) ? node.name : e.changes(node).map((c) => c.name).join()} ${Boolean(field(node, "sun"))} ${field(node, "sky")?.name}`;
  if (each.filled === key) return each.refresh?.();
  each.filled = key;
  each.body.replaceChildren();
  const refreshes = [];
  const add = (...children) => each.body.append(...children);
  const set = (fields) => edit(id, undefined, (text) => e.setFields(text, "lights", id, fields));
  const current = () => find(id)?.entry?.node;
  const input = (label, unit, of, act, attributes = {}) => {
    const control = make("input", { type: "number", step: "any", ...attributes, "aria-label": `${id}: ${label}`, onchange: () => { settle(); act(control.value === "" ? undefined : control.valueAsNumber); } });
    add(labelled(label, control, unit));
    refreshes.push(() => showValue(control, of() ?? ""));
  };
  if (own && entry.item) {
    const rename = make("input", {
      type: "text", value: id, spellcheck: "false", "aria-label": `${id}: name`,
      onchange: () => {
        if (rename.value === id) return;
        const fault = e.nameFault(model.edit, rename.value, [...(model.server?.lights ?? []).map((l) => l.id)]);
        if (fault) { say(fault, true); rename.value = id; return; }
        edit(id, undefined, (text) => e.renameLight(text, id, rename.value));
      },
    });
    add(labelled("name", rename));
  }
  const placed = () => e.place(own ? field(current(), "at") : field(e.change(current(), "Move"), "to"));
  const setPlace = (value) => edit(id, "place", (text, now) => placeText(text, now, value));
  if (placed()) {
    const at = placed();
    if (at.point) {
      ["right", "up", "back"].forEach((word, c) => input(word, "m", () => placed()?.point && number(placed().point[c]), (v) => {
        const point = [...placed().point];
        if (Number.isFinite(v)) { point[c] = v; setPlace(`Point(${point.map((x) => number(x)).join(", ")})`); }
      }));
    } else input("height above", "m", () => number(placed()?.lift ?? 0), (v) => setPlace(e.pixel({ ...placed(), lift: Number.isFinite(v) ? v : 0 })), { min: 0, step: 0.05 });
  }
  const size = () => field(field(current(), "shape"), "radius");
  if (own && node.name === "Lamp" && size()) input("radius", "m", () => numberOf(size()), (v) => { if (v > 0) set({ shape: `Sphere(radius: ${digits(v)})` }); }, { min: 0.001, step: 0.01 });
  if (isChange(light) && light.kind === "Lamp") input("flux", "lm", () => reading(find(id)).flux, (v) => setFlux(id, v), { min: 0, step: 50, placeholder: "as is" });
  if (own && node.name === "Window") {
    const sun = sunDial(id, () => field(current(), "sun"), (value, done) => {
      edit(id, "sun", (text) => e.setSun(text, id, value));
      if (done) settle();
    });
    add(sun.element);
    refreshes.push(sun.refresh);
  }
  if (isChange(light) && light.kind === "Lamp") {
    add(make("button", { type: "button", onclick: () => document.dispatchEvent(new CustomEvent("relight:place", { detail: id })) }, e.change(node, "Move") ? "Move by a click" : "Move: click its new place"));
  }
  if (!isChange(light)) {
    add(make("button", { type: "button", class: "bad", onclick: () => { edit(id, undefined, (text, now) => e.removeEntry(text, "lights", now.entry)); say(`${id} removed`); } }, own ? "Remove" : "As it was"));
  } else if (entry) {
    add(make("button", { type: "button", onclick: () => edit(id, undefined, (text) => e.removeLight(text, id)) }, "As in the photo"));
  }
  each.more.hidden = each.body.childElementCount === 0;
  each.refresh = () => refreshes.forEach((f) => f());
  each.refresh();
}

// The text with a light at another place: of an inserted one `at`, of one of the photo `Move(to: ..)`.
export function placeText(text, light, value) {
  if (!isChange(light)) return e.setFields(text, "lights", light.id, { at: value });
  return e.setChange(e.switchLight(text, light.id, true), light.id, "Move", `to: ${value}`);
}

export function update() {
  const list = byId("lights");
  const all = lights(), found = weights();
  const seen = new Set();
  all.forEach((light, k) => {
    const key = `${light.own} ${light.id}`;
    seen.add(key);
    if (!rows.has(key)) rows.set(key, row(light));
    const each = rows.get(key);
    if (list.children[k] !== each.element) list.insertBefore(each.element, list.children[k] ?? null);
    const now = reading(light);
    const locked = Boolean(model.edit.error) || hasKeys(light.entry);
    each.isOn.checked = now.isOn;
    each.isOn.disabled = Boolean(model.edit.error);
    each.element.classList.toggle("off", !now.isOn);
    each.element.classList.toggle("dark", Boolean(light.layer?.dark) && now.isOn);
    each.kind.textContent = [light.own ? "inserted" : light.in_view === false ? "out of view" : "", KINDS[light.kind] ?? "", hasKeys(light.entry) ? "keyframes" : ""].filter(Boolean).join(" ");
    each.solo.setAttribute("aria-pressed", view.solo.has(light.id));
    each.stops.value = now.stops ?? 0;
    each.stops.disabled = locked || now.stops === undefined;
    showValue(each.level, number(now.stops ?? 0, 2));
    each.level.disabled = each.stops.disabled;
    each.said.textContent = now.level;
    each.stops.setAttribute("aria-valuetext", now.level);
    const isFlux = now.kelvin !== undefined || (!light.own && isChange(light));
    for (const control of [each.kelvin, each.degrees]) {
      control.hidden = !isFlux;
      control.disabled = locked;
    }
    each.kelvin.previousElementSibling.textContent = isFlux ? "kelvin" : "color";
    each.kelvin.value = now.kelvin ?? 6500;
    each.kelvin.classList.toggle("unset", now.kelvin === undefined);
    each.kelvin.setAttribute("aria-valuetext", now.kelvin === undefined ? "as it is" : `${now.kelvin} kelvin`);
    showValue(each.degrees, now.kelvin ?? "");
    each.color.hidden = now.inserted || (light.kind === "Window" && light.own && now.hex === undefined);
    each.color.disabled = locked;
    each.color.classList.toggle("unset", now.hex === undefined);
    showValue(each.color, now.hex ?? shownTint(now.kelvin));
    each.stale.hidden = !(now.isOn && (found.get(light.id)?.stale ?? true)) || Boolean(model.edit.error);
    fill(each, light);
  });
  for (const [key, each] of rows) {
    if (seen.has(key)) continue;
    each.element.remove();
    rows.delete(key);
    view.solo.delete(key.split(" ")[1]);
  }
  byId("solo-note").hidden = view.solo.size === 0;
  byId("solo-note").firstElementChild.textContent = `Shown alone: ${[...view.solo].join(", ")}`;
}

const shownTint = (kelvin) => {
  if (kelvin === undefined || !model.blackBody) return "#ffffff";
  const rgb = model.blackBody(kelvin), most = Math.max(...rgb);
  return toHex(rgb.map((x) => Math.max(0, x / most)));
};

export function beginLights() {
  for (const name of ["text", "layers", "state", "sent"]) on(name, update);
  byId("solo-note").lastElementChild.addEventListener("click", () => { view.solo.clear(); update(); redraw(); });
}
