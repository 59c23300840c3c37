// RON texts, changed in place: a parser that keeps the span of every value, and splices that leave all other characters
// as a person wrote them, comments too.

// A fault of a text, at an offset in it.
export class RonError extends Error {
  constructor(message, at) {
    super(message);
    this.at = at;
  }
}

const BLANK = /\s/;
const WORD = /[A-Za-z_]/;
const WORDS = /[A-Za-z0-9_.+-]/;
const MAX_DEPTH = 64;

// Parses a text to { root, comments }. A node has { kind, start, end }, and
//   number, bool, string: value;  name: name;
//   call: name ("" for a tuple), items;  list: items;  map: items.
// An item of a container has { start, end, comma, key, value }: key is the name of a field, the node of a map's key, or
// undefined; comma is the offset of the comma after it, or -1. Containers have `open` and `close`, offsets of brackets.
export function parse(text) {
  const comments = [];
  let at = 0;
  const fail = (wanted) => {
    const got = at < text.length ? JSON.stringify(text[at]) : "the end of the text";
    throw new RonError(`wanted ${wanted}, got ${got}`, Math.min(at, text.length));
  };

  function blank() {
    for (;;) {
      while (at < text.length && BLANK.test(text[at])) at++;
      if (text.startsWith("//", at)) {
        const end = text.indexOf("\n", at);
        const start = at;
        at = end < 0 ? text.length : end;
        comments.push({ start, end: at, block: false });
      } else if (text.startsWith("/*", at)) {
        const start = at;
        let depth = 0;
        do {
          if (text.startsWith("/*", at)) { depth++; at += 2; }
          else if (text.startsWith("*/", at)) { depth--; at += 2; }
          else if (at >= text.length) fail("`*/`");
          else at++;
        } while (depth > 0);
        comments.push({ start, end: at, block: true });
      } else return;
    }
  }

  function word() {
    const start = at;
    if (text.startsWith("r#", at) && WORD.test(text[at + 2] ?? "")) at += 2;
    while (at < text.length && /[A-Za-z0-9_]/.test(text[at])) at++;
    return text.slice(start, at);
  }

  function string() {
    const start = at;
    const raw = /^b?r(#*)"/.exec(text.slice(at, at + 70));
    if (raw) {
      const end = text.indexOf('"' + raw[1], at + raw[0].length);
      if (end < 0) fail(`\`"${raw[1]}\``);
      const value = text.slice(at + raw[0].length, end);
      at = end + 1 + raw[1].length;
      return { kind: "string", start, end: at, value };
    }
    const quote = text[at] === "b" ? text[++at] : text[at];
    let value = "";
    for (at++; text[at] !== quote; at++) {
      if (at >= text.length) fail("the end of the string");
      if (text[at] !== "\\") { value += text[at]; continue; }
      at++;
      const escape = { n: "\n", r: "\r", t: "\t", 0: "\0" }[text[at]];
      const unicode = /^u\{([0-9A-Fa-f]{1,6})\}/.exec(text.slice(at, at + 10));
      const code = unicode && parseInt(unicode[1], 16);
      if (unicode && code <= 0x10ffff) { value += String.fromCodePoint(code); at += unicode[0].length - 1; }
      else value += escape ?? text[at] ?? "";
    }
    at++;
    return { kind: "string", start, end: at, value };
  }

  // The items up to a closing bracket; `at` is behind the opening one.
  function items(close, keyed, depth) {
    const found = [];
    for (blank(); text[at] !== close; blank()) {
      if (at >= text.length) fail(`\`${close}\``);
      if (found.length > 0 && found.at(-1).comma < 0) fail(`\`,\` or \`${close}\``);
      const item = { start: at, key: undefined, comma: -1 };
      if (keyed === "map") {
        item.key = value(depth);
        blank();
        if (text[at] !== ":") fail("`:`");
        at++;
        blank();
      } else if (keyed === "fields" && WORD.test(text[at])) {
        // A word is a field's name if a colon follows it.
        const back = [at, comments.length];
        const name = word();
        blank();
        if (text[at] === ":") { item.key = name; at++; blank(); }
        else { at = back[0]; comments.length = back[1]; }
      }
      item.value = value(depth);
      item.end = item.value.end;
      blank();
      if (text[at] === ",") { item.comma = at; at++; }
      found.push(item);
    }
    return found;
  }

  function value(depth) {
    if (depth > MAX_DEPTH) fail(`at most ${MAX_DEPTH} brackets within each other`);
    const start = at, first = text[at] ?? "";
    const container = (kind, name, close, keyed) => {
      const open = at++;
      const node = { kind, name, start, open, items: items(close, keyed, depth + 1), close: at };
      node.end = ++at;
      return node;
    };
    if (/^(["']|b["']|b?r#*")/.test(text.slice(at, at + 70))) return string();
    if (first === "[") return container("list", undefined, "]", undefined);
    if (first === "{") return container("map", undefined, "}", "map");
    if (first === "(") return container("call", "", ")", "fields");
    if (WORD.test(first)) {
      const name = word(), end = at;
      const here = comments.length;
      blank();
      if (text[at] === "(") return container("call", name, ")", "fields");
      at = end;
      comments.length = here;
      if (name === "true" || name === "false") return { kind: "bool", start, end, value: name === "true" };
      if (name === "inf" || name === "NaN") return { kind: "number", start, end, value: Number(name.replace("inf", "Infinity")) };
      return { kind: "name", start, end, name };
    }
    if (/[-+.0-9]/.test(first)) {
      while (at < text.length && WORDS.test(text[at])) at++;
      const digits = text.slice(start, at).replaceAll("_", "").replace(/(?<![0-9a-fxA-F])(inf)$/, "Infinity").replace(/(f32|f64)$/, "");
      const number = Number(digits);
      if (digits === "" || Number.isNaN(number)) { at = start; fail("a number"); }
      return { kind: "number", start, end: at, value: number };
    }
    return fail("a value");
  }

  for (blank(); text.startsWith("#!", at); blank()) {
    const end = text.indexOf("]", at);
    if (end < 0) fail("`]`");
    at = end + 1;
  }
  const root = value(0);
  blank();
  if (at < text.length) fail("the end of the text");
  return { root, comments };
}

// A field of a call or of a map with text keys.
export const item = (node, key) => node?.items?.find((each) => (each.key?.value ?? each.key) === key);
export const field = (node, key) => item(node, key)?.value;
export const source = (text, node) => text.slice(node.start, node.end);
// The values of a container in order.
export const values = (node) => node?.items?.map((each) => each.value) ?? [];
export const numbers = (node) => values(node).map((each) => (each.kind === "number" ? each.value : NaN));

// Line and column, from 1, of an offset; and the offset of them.
export function position(text, at) {
  const before = text.slice(0, at);
  const line = before.split("\n").length;
  return { line, column: [...before.slice(before.lastIndexOf("\n") + 1)].length + 1 };
}
export function offset(text, line, column) {
  const lines = text.split("\n");
  const start = lines.slice(0, line - 1).reduce((sum, each) => sum + each.length + 1, 0);
  return Math.min(text.length, start + [...(lines[line - 1] ?? "")].slice(0, column - 1).join("").length);
}

// ---- Writing -------------------------------------------------------------------------------------------------------

// A number as a person writes it: up to so many places, without zeros at its end.
export function number(value, places = 3) {
  const text = Number(value).toFixed(places);
  const short = text.includes(".") ? text.replace(/\.?0+$/, "") : text;
  return short === "-0" ? "0" : short;
}

// A number of so many significant digits, never in the form 1e-7.
export function digits(value, significant = 3) {
  if (value === 0) return "0";
  const places = significant - 1 - Math.floor(Math.log10(Math.abs(value)));
  return number(places < 0 ? Number(value.toPrecision(significant)) : value, Math.min(20, Math.max(0, places)));
}

export const quoted = (text) => '"' + text.replace(/[\\"]/g, "\\$&").replaceAll("\n", "\\n").replaceAll("\t", "\\t") + '"';

// ---- Splices -------------------------------------------------------------------------------------------------------

export const splice = (text, start, end, inserted) => text.slice(0, start) + inserted + text.slice(end);
export const replace = (text, node, inserted) => splice(text, node.start, node.end, inserted);

const WIDE = 100;
const lineStart = (text, at) => text.lastIndexOf("\n", at - 1) + 1;
const lineEnd = (text, at) => { const end = text.indexOf("\n", at); return end < 0 ? text.length : end; };
const indentAt = (text, at) => /^[ \t]*/.exec(text.slice(lineStart(text, at), at))[0];
const indented = (text, indent) => text.replaceAll("\n", "\n" + indent);

// Adds an item at the end of a container, on a line of its own where the others stand on theirs, or where the line would
// get long. `added` may have lines of its own, indented from 0.
export function append(text, node, added, own = false) {
  const last = node.items.at(-1);
  const inner = text.slice(node.open + 1, node.close);
  if (!last && inner.trim() !== "") {
    // Comments only: behind them.
    const at = node.open + 1 + inner.trimEnd().length;
    const indent = indentAt(text, at) || "    ";
    return inner.includes("\n") ? splice(text, at, at, `\n${indent}${indented(added, indent)},`) : splice(text, at, at, ` ${added}${/^\/\//.test(inner.trim()) ? "," : ""}`);
  }
  const multi = last && text.slice(node.open, last.start).includes("\n");
  if (multi) {
    // The first item that begins a line has the indent.
    const first = node.items.find((each) => indentAt(text, each.start).length === each.start - lineStart(text, each.start)) ?? last;
    const indent = indentAt(text, first.start);
    const comma = last.comma < 0;
    const done = comma ? last.end : last.comma + 1;
    // Behind a comment that ends with the line; a bracket on the last item's line comes onto its own.
    const end = lineEnd(text, done), shares = end > node.close;
    const line = shares || text.slice(done, end).includes("/*") ? done : end;
    const mid = splice(text, line, line, `\n${indent}${indented(added, indent)},${shares ? "\n" + indentAt(text, lineStart(text, node.open)) : ""}`);
    return comma ? splice(mid, last.end, last.end, ",") : mid;
  }
  const start = lineStart(text, node.open);
  // The fields of an entry stay on its line, however long.
  const short = node.kind === "call" || (lineEnd(text, node.open) - start + added.length + 2 <= WIDE && !added.includes("\n"));
  if (short && !own) {
    if (!last) {
      const pad = node.kind === "map" ? " " : "";
      return splice(text, node.open + 1, node.close, pad + added + pad);
    }
    return last.comma < 0 ? splice(text, last.end, last.end, `, ${added}`) : splice(text, last.comma + 1, last.comma + 1, ` ${added},`);
  }
  // One item a line; a comment goes with the item before it.
  const base = /^[ \t]*/.exec(text.slice(start))[0];
  const indent = base + "    ";
  const lines = node.items.map((each, k) => {
    const until = node.items[k + 1]?.start ?? node.close;
    const after = text.slice(each.comma < 0 ? each.end : each.comma + 1, until).trim();
    const before = k === 0 ? text.slice(node.open + 1, each.start).trim() : "";
    return `${before && before + " "}${text.slice(each.start, each.end)},${after && " " + after}`;
  });
  const all = [...lines, `${indented(added, indent)},`].map((line) => `\n${indent}${line}`).join("");
  return splice(text, node.open + 1, node.close, `${all}\n${base}`);
}

// Removes an item with its comma, and its line where nothing else stands on it.
export function remove(text, node, each) {
  let start = each.start, end = each.comma < 0 ? each.end : each.comma + 1;
  const from = lineStart(text, start), to = lineEnd(text, end);
  if (text.slice(from, start).trim() === "" && text.slice(end, to).trim() === "" && to < text.length) return splice(text, from, to + 1, "");
  const k = node.items.indexOf(each);
  if (k + 1 < node.items.length) {
    while (end < node.items[k + 1].start && /[ \t]/.test(text[end])) end++;
  } else if (k > 0) {
    const before = node.items[k - 1];
    if (each.comma < 0 && text.slice(before.comma + 1, start).trim() === "") start = before.comma;
    else while (/[ \t]/.test(text[start - 1])) start--;
  } else if (text.slice(node.open + 1, start).trim() === "" && text.slice(end, node.close).trim() === "") {
    return splice(text, node.open + 1, node.close, "");
  }
  return splice(text, start, end, "");
}

// Sets a field of a call, or the entry of a map under a text key.
export function set(text, node, key, value) {
  const old = field(node, key);
  if (old) return replace(text, old, value);
  return append(text, node, `${node.kind === "map" ? quoted(key) : key}: ${value}`);
}

export function unset(text, node, key) {
  const old = item(node, key);
  return old ? remove(text, node, old) : text;
}
