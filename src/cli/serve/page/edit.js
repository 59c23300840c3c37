// The edit as a text: what it changes, and the splices that change it. Every function that changes something takes a text
// and returns a text.
import { RonError, parse, field, item, source, values, numbers, set, unset, append, remove, replace, splice, quoted, digits, number } from "./ron.js";

export const LISTS = ["materials", "objects"];

// Reads a text to { root, lights, materials, objects } or { error }. An entry has { id, node, item, text, off }: `off` is
// the span of the comment around an entry that is commented out. `id` is a light's name, or the number in its list.
export function read(text) {
  let parsed;
  try {
    parsed = parse(text);
    if (parsed.root.kind !== "call" || parsed.root.name !== "Edit") throw new RonError("wanted `Edit(..)`", parsed.root.start);
  } catch (error) {
    if (!(error instanceof RonError)) throw error;
    return { error, lights: [], materials: [], objects: [] };
  }
  const { root, comments } = parsed;
  const entries = (name) => {
    const node = field(root, name);
    if (!node?.items) return [];
    const shown = node.items.map((each) => ({ id: each.key?.value, node: each.value, item: each, text: source(text, each.value), at: each.start }));
    const hidden = comments.filter((each) => each.block && each.start > node.open && each.end <= node.close && !node.items.some((i) => each.start > i.start && each.end <= i.end));
    for (const off of hidden) {
      const inner = text.slice(off.start + 2, off.end - 2);
      let only;
      try {
        only = parse(node.kind === "map" ? `{${inner}}` : `[${inner}]`).root;
      } catch {
        continue; // a comment in words
      }
      if (only.items.length !== 1 || only.items[0].value.kind !== "call") continue;
      const { key, value } = only.items[0];
      shown.push({ id: key?.value, node: value, text: inner.slice(value.start - 1, value.end - 1), off, at: off.start });
    }
    shown.sort((a, b) => a.at - b.at);
    return shown;
  };
  const list = (name) => entries(name).map((each, id) => ({ ...each, id }));
  return { root, lights: entries("lights"), materials: list("materials"), objects: list("objects") };
}

export const light = (edit, id) => edit.lights.find((each) => each.id === id);

// ---- Changes of an existing light ------------------------------------------------------------------------------------

// The order in which changes may stand in a list.
const ORDER = ["On", "Move", "Scale", "Temperature", "Color"];

export const isMade = (node) => node?.kind === "call" && (node.name === "Lamp" || node.name === "Window");
export const isOff = (node) => node?.kind === "name" && node.name === "Off";
export const changes = (node) => (!node || isMade(node) || isOff(node) ? [] : node.kind === "list" ? values(node) : [node]);
export const change = (node, name) => changes(node).find((each) => each.name === name);

// Sets one change of an existing light, or removes it (argument null): `"lamp_0": [Scale(0.5), Temperature(2700)]`.
export function setChange(text, id, name, argument) {
  const edit = read(text);
  const node = light(edit, id)?.node;
  const excluded = name === "Temperature" ? "Color" : name === "Color" ? "Temperature" : undefined;
  const kept = changes(node).filter((each) => each.name !== name && each.name !== excluded);
  // A color change excludes the temperature of an `On`.
  const parts = kept.map((each) => ({ name: each.name, text: excluded && each.name === "On" ? unsetIn(text, each, "temperature") : source(text, each) }));
  if (argument !== null) parts.push({ name, text: `${name}(${argument})` });
  parts.sort((a, b) => ORDER.indexOf(a.name) - ORDER.indexOf(b.name));
  if (parts.length === 0) return removeLight(text, id);
  return setLight(text, id, parts.length === 1 ? parts[0].text : `[${parts.map((each) => each.text).join(", ")}]`);
}

// The text of a call alone, without a field.
function unsetIn(text, node, key) {
  const alone = source(text, node);
  return unset(alone, parse(alone).root, key);
}

// Sets the entry of a light. An entry that a comment hides is replaced.
export function setLight(text, id, value) {
  return setIn(text, "lights", id, value);
}

function setIn(text, name, id, value) {
  const { root, error } = read(text);
  if (error) throw error;
  const map = field(root, name);
  if (!map) return append(text, root, `${name}: {\n    ${quoted(id)}: ${value},\n}`, true);
  return set(text, map, id, value);
}

// Removes a light's entry, and the field that is empty then.
export function removeLight(text, id) {
  const edit = read(text);
  const entry = light(edit, id);
  return entry ? removeEntry(text, "lights", entry) : text;
}

export function removeEntry(text, name, entry) {
  const { root } = read(text);
  const node = field(root, name);
  let next;
  if (entry.off) next = splice(text, entry.off.start, entry.off.end, "").replace(/^[ \t]+\n/m, "");
  else next = remove(text, node, node.items.find((each) => each.start === entry.item.start));
  const after = read(next).root;
  const empty = field(after, name);
  if (empty?.items?.length === 0 && next.slice(empty.open + 1, empty.close).trim() === "") next = unset(next, after, name);
  return next;
}

// Switches a light that the photo shows: `Off` keeps the changes that it replaces in a comment, and gives them back.
export function switchLight(text, id, on) {
  const entry = light(read(text), id);
  if (on && entry && isOff(entry.node)) {
    const kept = /^\s*\/\* (.*?) \*\//s.exec(text.slice(entry.node.end));
    return kept ? splice(text, entry.node.start, entry.node.end + kept[0].length, kept[1]) : removeLight(text, id);
  }
  if (!on && !isOff(entry?.node)) return setLight(text, id, entry ? `Off /* ${entry.text} */` : "Off");
  return text;
}

// Comments an inserted light or object out, or in again.
export function switchEntry(text, name, entry, on) {
  if (on === !entry.off) return text;
  let next;
  if (on) {
    next = splice(text, entry.off.start, entry.off.end, text.slice(entry.off.start + 2, entry.off.end - 2).trim());
    // A hidden entry stands behind the last one without a comma of it.
    const node = field(read(text).root, name);
    const before = node.items.findLast((each) => each.end <= entry.off.start);
    if (before && (before.comma < 0 || before.comma > entry.off.start)) next = splice(next, before.end, before.end, ",");
  } else {
    const end = entry.item.comma < 0 ? entry.item.end : entry.item.comma + 1;
    next = splice(text, entry.item.start, end, `/* ${text.slice(entry.item.start, end)}${entry.item.comma < 0 ? "," : ""} */`);
  }
  const now = read(next);
  if (now.error || now[name].length !== read(text)[name].length) throw new Error("the entry has comments or strings that cannot be commented out; remove it instead");
  return next;
}

export function renameLight(text, id, name) {
  const entry = light(read(text), id);
  if (!entry?.item) return text;
  return replace(text, entry.item.key, quoted(name));
}

export const nameFault = (edit, name, known) =>
  !/^[A-Za-z][A-Za-z0-9_]*$/.test(name) ? "a name has letters, digits and _, and begins with a letter"
  : name === "rest" || known.includes(name) || light(edit, name) ? `the name ${name} is taken` : undefined;

// A name that is free: lamp, lamp_2, ..
export function freeName(edit, stem, known) {
  for (let k = 1; ; k++) {
    const name = k === 1 ? stem : `${stem}_${k}`;
    if (!nameFault(edit, name, known)) return name;
  }
}

// ---- Fields of an inserted entry -------------------------------------------------------------------------------------

// Sets fields of a light's or an object's own call, one after the other; null removes a field.
export function setFields(text, name, id, fields) {
  for (const [key, value] of Object.entries(fields)) {
    const node = read(text)[name].find((each) => each.id === id)?.node;
    if (!node) return text;
    text = value === null ? unset(text, node, key) : set(text, node, key, value);
  }
  return text;
}

// Sets the direction of a window's sun, { azimuth, elevation } in degrees; its other fields stay. null: no sun.
export function setSun(text, id, direction) {
  if (!direction) return setFields(text, "lights", id, { sun: null });
  for (const [key, value] of Object.entries(direction)) {
    const old = field(light(read(text), id)?.node, "sun");
    if (old?.name === "Direction") text = set(text, old, key, number(value, 1));
    else return setFields(text, "lights", id, { sun: `Direction(azimuth: ${number(direction.azimuth, 1)}, elevation: ${number(direction.elevation, 1)})` });
  }
  return text;
}

// Adds an item to `materials` or `objects`.
export function addItem(text, name, value) {
  const { root, error } = read(text);
  if (error) throw error;
  const node = field(root, name);
  return node ? append(text, node, value) : append(text, root, `${name}: [\n    ${value},\n]`, true);
}

export const pixel = ({ x, y, lift = 0 }) => `Pixel(x: ${digitsOf(x)}, y: ${digitsOf(y)}${lift ? `, lift: ${digits(lift)}` : ""})`;
const digitsOf = (x) => String(Math.round(x));
export const corners = (points) => `[${points.map(([x, y]) => `(${digitsOf(x)}, ${digitsOf(y)})`).join(", ")}]`;

// The position that a value of `at` gives: { x, y, lift } of a photo pixel, or { point }.
export function place(node) {
  if (node?.name === "Pixel") {
    const of = (key) => field(node, key)?.value;
    return { x: of("x"), y: of("y"), lift: of("lift") ?? 0 };
  }
  const point = numbers(node);
  return node?.name === "Point" && point.length === 3 && point.every(Number.isFinite) ? { point } : undefined;
}

// ---- Weights -----------------------------------------------------------------------------------------------------------

const luminance = ([r, g, b]) => 0.2126 * r + 0.7152 * g + 0.0722 * b;
const scaled = (color, factor) => color.map((x) => x * factor);

const amount = (node) => node?.value;

// The radiance after the changes of an existing light, from what its layer was made with.
function radiance(node, start, blackBody) {
  return changes(node).reduce((w, each) => {
    const argument = amount(values(each)[0]);
    switch (each.name) {
      case "Scale": return Number.isFinite(argument) ? scaled(w, argument) : w;
      case "Temperature": return Number.isFinite(argument) ? scaled(blackBody(argument), luminance(w)) : w;
      case "Color": {
        const color = numbers(each);
        return luminance(color) > 0 ? scaled(color, luminance(w) / luminance(color)) : w;
      }
      default: return w;
    }
  }, start);
}

// The level and the color that an entry's own fields give, up to a factor that its form determines.
function emission(node, blackBody) {
  const fields = (key) => field(node, key);
  if (node.name === "Lamp" || node.name === "On") {
    const color = fields("radiance");
    if (color) return { rgb: numbers(color), rest: "radiance" };
    const kelvin = amount(fields("temperature")), flux = amount(fields("flux"));
    if (flux === undefined || (node.name === "On" && kelvin === undefined)) return undefined;
    return { rgb: scaled(blackBody(kelvin ?? 2700), flux), rest: "flux" };
  }
  if (node.name === "Window") {
    const sky = fields("sky");
    if (fields("ground") || fields("sun")) return sky && sky.name !== "Radiance" ? { rgb: scaled([1, 1, 1], amount(fields("scale")) ?? 1), rest: "scale" } : undefined;
    if (!sky) return { rgb: [4, 4.4, 5], rest: "sky" };
    if (sky.name === "Radiance") return { rgb: numbers(sky), rest: "sky" };
    return { rgb: scaled([1, 1, 1], amount(fields("scale")) ?? 1), rest: "scale" };
  }
  return undefined;
}

const OWN = { radiance: ["radiance"], flux: ["flux", "temperature"], scale: ["scale"], sky: ["sky"] };
// What a value says without blanks, comments and the fields that only weight it.
const bare = (text, node, without) => `${node.name}(${node.items.filter((each) => !without.includes(each.key)).map((each) => `${each.key ?? ""}:${plain(source(text, each.value))}`).join(",")})`;
const plain = (text) => text.replace(/\/\*.*?\*\/|\/\/[^\n]*|\s/gs, "").replace(/,(?=[)\]}])/g, "");

function callOf(text) {
  try {
    return text ? parse(text).root : undefined;
  } catch {
    return undefined;
  }
}

// The factor of a light's layer under an entry of this text (null: unchanged), where `made` is the text of the entry that
// the layer was made with. { weight, stale }: stale where only a run can show the entry.
export function weight(now, made, start, blackBody) {
  const [new_, old] = [callOf(now), callOf(made)];
  if (isOff(new_)) return { weight: [0, 0, 0], stale: false };
  const shape = new_ && isMade(new_) ? new_ : undefined;
  const from = old && isMade(old) ? old : undefined;
  const ratio = (to, base, one, other) => {
    const [a, b] = [emission(to, blackBody), emission(base, blackBody)];
    if (!a || !b || a.rest !== b.rest) return undefined;
    const same = bare(one, to, OWN[a.rest]) === bare(other, base, OWN[b.rest]);
    const weight = a.rgb.map((x, c) => (b.rgb[c] > 0 ? x / b.rgb[c] : x > 0 ? NaN : 0));
    return weight.every(Number.isFinite) ? { weight, stale: !same } : undefined;
  };
  if (shape || from) {
    if (!now) return { weight: [0, 0, 0], stale: false };
    if (shape && from && plain(now) === plain(made)) return { weight: [1, 1, 1], stale: false };
    return (shape && from && ratio(shape, from, now, made)) ?? { weight: [1, 1, 1], stale: true };
  }
  // What the changes of radiance leave: `On` and `Move`.
  const rest = (node, text) => changes(node).filter((each) => !["Scale", "Temperature", "Color"].includes(each.name)).map((each) => plain(source(text, each))).join();
  let stale = rest(new_, now) !== rest(old, made);
  let base = [1, 1, 1];
  const [on, was] = [change(new_, "On"), change(old, "On")];
  if (on && was && stale) {
    const switched = ratio(on, was, now, made);
    if (switched) base = switched.weight;
  }
  const level = start && start.some((x) => x > 0) ? start : [1, 1, 1];
  const from_ = radiance(old, level, blackBody);
  const to = radiance(new_, level, blackBody);
  const factor = to.map((x, c) => (from_[c] > 0 ? x / from_[c] : x > 0 ? 1 : 0));
  return { weight: factor.map((x, c) => x * base[c]), stale };
}

// The color of a black body from the program's table of [kelvin, r, g, b], which has even steps in the inverse.
export function blackBodyOf(table) {
  if (!table?.length) return () => [1, 1, 1];
  return (kelvin) => {
    const t = Math.min(Math.max(kelvin, table[0][0]), table.at(-1)[0]);
    const k = Math.max(1, table.findIndex((row) => row[0] >= t));
    const [a, b] = [table[k - 1], table[k] ?? table[k - 1]];
    const share = b[0] > a[0] ? (t - a[0]) / (b[0] - a[0]) : 0;
    return [1, 2, 3].map((c) => a[c] + share * (b[c] - a[c]));
  };
}

// ---- Two changes of one text -------------------------------------------------------------------------------------------

// The text of somebody else with the changes from `base` to `mine` on top, entry by entry. Where it cannot be told, mine.
export function merge(base, mine, theirs) {
  if (mine === base || mine === theirs) return theirs;
  if (theirs === base) return mine;
  const [from, to, other] = [read(base), read(mine), read(theirs)];
  if (from.error || to.error || other.error) return mine;
  let text = theirs;
  for (const id of new Set([...from.lights, ...to.lights].map((each) => each.id))) {
    const [was, is] = [light(from, id), light(to, id)];
    if (was?.text === is?.text && !was?.off === !is?.off) continue;
    if (!is) { text = removeLight(text, id); continue; }
    const there = light(read(text), id);
    if (there?.off) text = switchEntry(text, "lights", there, true);
    text = setLight(text, id, is.text);
    if (is.off) text = switchEntry(text, "lights", light(read(text), id), false);
  }
  for (const name of [...LISTS, "frames"]) {
    const [was, is] = [item(from.root, name), item(to.root, name)];
    const [before, after] = [was && source(base, was.value), is && source(mine, is.value)];
    if (before === after) continue;
    const { root } = read(text);
    text = is ? set(text, root, name, after) : unset(text, root, name);
  }
  return text;
}
