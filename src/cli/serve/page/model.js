// The state of the page. The text of the edit is the truth: whatever is moved, switched or typed becomes a new text, and
// everything shown is read from it. Undo and redo are texts, too.
import * as api from "./api.js";
import { read, merge, weight, blackBodyOf, light } from "./edit.js";

export const model = {
  text: "",
  edit: read("Edit(version: 1)"),
  // The newest text and revision that the server has taken.
  accepted: { text: "", revision: 0 },
  server: undefined,
  // The newest layers, and those of a preview that is newer.
  manifest: undefined,
  previewed: undefined,
  // Faults that the server found in `faultsOf`.
  faults: [],
  faultsOf: "",
  run: { status: "idle" },
  connected: false,
  // Of the layers, pixels; the view chooses it by the size of the screen.
  longSide: 1280,
  // Whether the picture holds the layer of a digest: the view sets it.
  isHeld: () => false,
  undo: [],
  redo: [],
};

const listeners = new Map();
export function on(name, f) {
  listeners.set(name, [...(listeners.get(name) ?? []), f]);
}
export function emit(name, value) {
  for (const f of listeners.get(name) ?? []) f(value);
}

// A line for people, read out by screen readers. `bad` stays until the next one.
export const say = (text, bad = false) => emit("say", { text, bad });

// ---- Changes -----------------------------------------------------------------------------------------------------------

const MAX_UNDO = 500;
const DRAFT = "relight.draft";
const DELAY = 150;
// The name of changes in the text itself: what is typed until it is saved is undone as one.
export const TYPING = "typing";
// The text that is on its way.
let sending;
let timer, again = false, group;

function keepDraft() {
  try {
    if (model.text === model.accepted.text) sessionStorage.removeItem(DRAFT);
    else sessionStorage.setItem(DRAFT, JSON.stringify({ text: model.text, base: model.accepted.text }));
  } catch { /* storage is forbidden: the server has all but the last moment */ }
}

function setText(text) {
  model.text = text;
  model.edit = read(text);
  keepDraft();
  emit("text");
}

// Makes a text the newest. Changes of one `name` in a row (a slider that moves) are undone as one.
export function change(text, name) {
  if (text === model.text) return;
  if (!name || name !== group) {
    model.undo.push(model.text);
    if (model.undo.length > MAX_UNDO) model.undo.shift();
  }
  group = name;
  model.redo.length = 0;
  setText(text);
  sendSoon();
}

// Ends a group of changes: a slider was let go.
export function settle() {
  group = undefined;
}

function step(from, to, word) {
  if (from.length === 0) return say(`Nothing to ${word}`);
  settle();
  to.push(model.text);
  setText(from.pop());
  sendSoon();
}
export const undo = () => step(model.undo, model.redo, "undo");
export const redo = () => step(model.redo, model.undo, "redo");

// Shows a text without keeping it: a light that is being dragged. `undefined` goes back.
let before;
export function preview(text) {
  if (before === undefined) before = model.text;
  model.text = text ?? before;
  model.edit = read(model.text);
  emit("text");
  if (text !== undefined) return sendPreview();
  before = undefined;
  sendSoon(true); // the server leaves the preview, too
}
// Keeps the text that the drag ended with.
export function keepPreview() {
  const text = model.text;
  if (before === undefined) return;
  model.text = before;
  before = undefined;
  change(text);
}

let previewing = false, previewAgain = false;
async function sendPreview() {
  if (previewing) { previewAgain = true; return; }
  previewing = true;
  const text = model.text;
  try {
    await api.putEdit(text, model.accepted.revision, true);
  } catch { /* the final text says what is wrong with it */ }
  previewing = false;
  if (previewAgain && before !== undefined) {
    previewAgain = false;
    if (model.text !== text) sendPreview();
  }
}

// ---- To the server -------------------------------------------------------------------------------------------------------

export function sendSoon(force = false) {
  clearTimeout(timer);
  timer = setTimeout(() => send(force), DELAY);
}

// Whether the text is on its way, or waits for it.
export const isPending = () => model.text !== model.accepted.text && model.text !== model.faultsOf;

async function send(force) {
  if (sending !== undefined) { again = true; return; }
  if (before !== undefined || !force && model.text === model.accepted.text && model.faults.length === 0) return;
  const text = sending = model.text;
  try {
    const { revision } = await api.putEdit(text, model.accepted.revision);
    model.accepted = { text, revision };
    setFaults([], "");
    if (group === TYPING) settle();
  } catch (error) {
    if (error.status === 409) takeOver(error.body);
    else if (error.status === 422) setFaults(error.body?.diagnostics ?? [{ message: error.message }], text);
    else if (error.status) say(`The edit was not taken: ${error.message}`, true);
    else emit("lost", "The server does not answer");
  }
  sending = undefined;
  keepDraft();
  emit("sent");
  if (again) { again = false; sendSoon(); }
}

function setFaults(faults, of) {
  model.faults = faults;
  model.faultsOf = of;
  emit("faults");
}

// Another page or an editor was faster: its text, with what is new here on top.
function takeOver({ revision, text }) {
  if (revision < model.accepted.revision) return;
  const base = model.accepted.text;
  model.accepted = { text, revision };
  if (text === model.text) return keepDraft();
  const mine = before ?? model.text;
  const merged = merge(base, mine, text);
  const own = mine !== base;
  if (before !== undefined) { before = merged; return; }
  model.undo.push(model.text);
  model.redo.length = 0;
  settle();
  setText(merged);
  setFaults([], "");
  say(own && merged !== text ? "The edit was changed elsewhere too; both changes are kept" : "The edit was changed elsewhere");
  if (merged !== text) sendSoon();
}

// ---- From the server -------------------------------------------------------------------------------------------------------

let loaded = false, wasLost = false;

async function load() {
  const state = await api.getJson("/api/state");
  model.server = state;
  model.blackBody = blackBodyOf(state.temperatures);
  model.run = state.run ?? model.run;
  const { text, revision } = state.edit;
  if (!loaded) {
    loaded = true;
    model.accepted = { text, revision };
    let draft;
    try { draft = JSON.parse(sessionStorage.getItem(DRAFT) ?? "null"); } catch { /* none */ }
    setText(text);
    if (draft && typeof draft.text === "string" && draft.text !== text) {
      change(merge(String(draft.base), draft.text, text));
      say("A change that had not reached the server is back");
    } else if (state.draft && state.draft.text !== text) {
      model.undo.push(text);
      setText(state.draft.text);
      setFaults(state.draft.diagnostics, state.draft.text);
    }
  } else {
    // A server that was started anew counts from the beginning.
    if (revision < model.accepted.revision) model.accepted.revision = revision;
    takeOver({ text, revision });
    if (model.text !== model.accepted.text) sendSoon();
  }
  emit("state");
  emit("run");
  await loadLayers();
}

let loading = false, loadAgain = false, allAgain = false;

// Loads the newest layers: those that the picture does not hold already, or all.
export async function loadLayers(all = false) {
  allAgain ||= all;
  if (loading) { loadAgain = true; return; }
  loading = true;
  const every = allAgain;
  allAgain = false;
  try {
    const manifest = await api.getJson(`/api/layers?long_side=${model.longSide}`);
    const layers = [manifest.rest, manifest.photo, ...manifest.lights].filter((each) => each?.digest);
    const asked = layers.filter((each) => every || manifest.preview || manifest.size.join() !== model.manifest?.size.join() || !model.isHeld(each.digest));
    const planar = await Promise.all(asked.map((each) => api.layer(each.digest)));
    asked.forEach((each, k) => { each.halves = planar[k]; });
    if (manifest.preview && model.manifest) model.previewed = manifest;
    else {
      model.manifest = manifest;
      model.previewed = undefined;
    }
    emit("layers");
    // The picture has them now; only what a preview or an overlay comes back to is kept.
    api.keepOnly(new Set([...(manifest.preview ? layers : []), ...(model.manifest.planes ?? [])].map((each) => each.digest)));
  } catch (error) {
    // Before the first run there are none; without a server, that is said already.
    if (error.status !== 404 && (error.status || model.connected)) say(`The layers cannot be shown: ${error.message}`, true);
  }
  loading = false;
  if (loadAgain) { loadAgain = false; loadLayers(); }
}

export function begin() {
  // A page that is closed within the delay.
  window.addEventListener("pagehide", () => { if (isPending() && before === undefined) api.putAtEnd(model.text, model.accepted.revision); });
  api.follow({
    async open() {
      try {
        await load();
      } catch (error) {
        return say(`The server's state cannot be read: ${error.message}`, true);
      }
      model.connected = true;
      emit("connection");
      if (wasLost) say("The server is back; nothing is lost");
      wasLost = false;
    },
    lost(reason) {
      model.connected = false;
      wasLost = true;
      emit("connection");
      emit("lost", reason);
    },
    state(run) { model.run = { ...run, progress: undefined }; emit("run"); },
    progress(progress) { model.run = { ...model.run, progress }; emit("run"); },
    finished(finished) { model.run = { ...model.run, progress: undefined, finished }; emit("run"); emit("finished"); },
    // The own text comes as an event, too, and may be faster than the answer.
    edit(news) { if (news.revision > model.accepted.revision && news.text !== sending) takeOver(news); },
    layers() { loadLayers(); },
    problem(problem) { emit("problem", problem); },
  });
}

// ---- What is shown ---------------------------------------------------------------------------------------------------------

// All lights: those of the photo, then those that the edit inserts.
export function lights() {
  const known = model.server?.lights ?? [];
  const made = new Map((model.manifest?.lights ?? []).map((each) => [each.id, each]));
  const own = model.edit.lights.filter((each) => each.id !== undefined && !known.some((k) => k.id === each.id));
  return [
    ...known.map((each) => ({ ...each, own: false, entry: light(model.edit, each.id), layer: made.get(each.id) })),
    ...own.map((entry) => ({ id: entry.id, kind: entry.node.name, own: true, entry, layer: made.get(entry.id) })),
  ];
}

// While a text cannot be read, the weights before it stay.
let lastWeights = new Map();

// Per layer of a manifest { weight, stale }.
export function weights(manifest = model.previewed ?? model.manifest) {
  const { edit, blackBody } = model;
  if (edit.error) return lastWeights;
  const result = new Map();
  for (const layer of manifest?.lights ?? []) {
    const entry = light(edit, layer.id);
    const known = model.server?.lights?.some((each) => each.id === layer.id);
    const gone = entry?.off || (!entry && !known);
    const lobes = layer.radiance ?? [];
    const total = lobes.reduce((sum, lobe) => sum.map((x, c) => x + lobe[c]), [0, 0, 0]);
    result.set(layer.id, gone ? { weight: [0, 0, 0], stale: false } : weight(entry?.text ?? null, layer.entry ?? null, lobes.length ? total : undefined, blackBody));
  }
  lastWeights = result;
  return result;
}
