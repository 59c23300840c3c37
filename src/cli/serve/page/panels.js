// The panels beside the picture: the text of the edit with its faults, snapshots, the run.
import { model, on, change, settle, say, isPending, TYPING } from "./model.js";
import { offset, position } from "./ron.js";
import { readShown } from "./view.js";
import { byId, make } from "./dom.js";
import * as api from "./api.js";

// ---- The text --------------------------------------------------------------------------------------------------------------

const area = byId("text");

function showText() {
  if (area.value !== model.text) {
    // The caret stays at its place in the text.
    const { selectionStart, selectionEnd } = area;
    area.value = model.text;
    area.setSelectionRange(selectionStart, selectionEnd);
  }
  showFaults();
}

// The faults of the text as it is now: the server's, else where this page's own reader stops. A fault in another file
// has its place in its message.
function faults() {
  if (model.faultsOf === model.text && model.faults.length > 0) {
    const own = model.server?.edit.path;
    return model.faults.map((each) => (each.path && own && each.path !== own && each.line ? { message: `${each.path}:${each.line}:${each.column}: ${each.message}`, help: each.help } : each));
  }
  const { error } = model.edit;
  return error ? [{ message: error.message, ...position(model.text, error.at) }] : [];
}

function showFaults() {
  const lines = model.text.split("\n");
  const found = faults();
  byId("lines").replaceChildren(...lines.map((_, k) => make("span", found.some((f) => f.line === k + 1) ? { class: "bad" } : {}, `${k + 1}\n`)));
  // A twin of the text behind it carries the marks.
  const marks = byId("marks");
  const parts = [];
  let at = 0;
  for (const fault of found.filter((f) => f.line).map((f) => ({ f, start: offset(model.text, f.line, f.column ?? 1) })).sort((a, b) => a.start - b.start)) {
    const { f, start } = fault;
    if (start < at) continue;
    const end = Math.max(start + 1, f.end_column ? offset(model.text, f.line, f.end_column) : start + 1);
    parts.push(model.text.slice(at, start), make("mark", {}, model.text.slice(start, end).replace("\n", " \n") || " "));
    at = end;
  }
  parts.push(model.text.slice(at), "\n");
  marks.replaceChildren(...parts);
  byId("faults").replaceChildren(...found.map((fault) => {
    const line = lines[(fault.line ?? 1) - 1] ?? "";
    const go = () => {
      const start = offset(model.text, fault.line ?? 1, fault.column ?? 1);
      area.focus();
      area.setSelectionRange(start, fault.end_column ? offset(model.text, fault.line, fault.end_column) : start + 1);
    };
    const width = Math.max(1, (fault.end_column ?? 0) - (fault.column ?? 1));
    const cut = Math.max(0, (fault.column ?? 1) - 40);
    const excerpt = fault.line ? make("pre", {}, `${line.slice(cut, cut + 90)}\n${" ".repeat((fault.column ?? 1) - 1 - cut)}${"^".repeat(width)}`) : undefined;
    return make("li", { "data-line": fault.line },
      fault.line ? make("button", { type: "button", class: "where", onclick: go }, `line ${fault.line}, column ${fault.column ?? 1}`) : undefined,
      make("span", {}, fault.message), excerpt, fault.help ? make("small", {}, fault.help) : undefined);
  }));
  area.setAttribute("aria-invalid", String(found.length > 0));
  byId("faultcount").textContent = found.length ? `${found.length} ${found.length === 1 ? "fault" : "faults"}` : "";
  byId("textstate").textContent = found.length ? "Not run until it is mended; the last picture stays." : isPending() ? "Not saved yet" : model.server ? `Saved in ${model.server.edit.path}` : "";
}

function scrolled() {
  byId("lines").scrollTop = area.scrollTop;
  byId("marks").scrollTop = area.scrollTop;
  byId("marks").scrollLeft = area.scrollLeft;
}

// ---- Snapshots -----------------------------------------------------------------------------------------------------------------

async function listSnapshots() {
  let names;
  try {
    names = await api.getJson("/api/snapshots");
  } catch (error) {
    return say(`Snapshots cannot be listed: ${error.message}`, true);
  }
  const pictures = new Map(JSON.parse(localStorage.getItem("relight.thumbnails") ?? "[]"));
  byId("snapshots").replaceChildren(...names.map((name) => {
    const load = async () => {
      try {
        settle();
        change(await api.getText(`/api/snapshots/${encodeURIComponent(name)}`));
        settle();
        say(`Snapshot ${name} loaded; undo goes back`);
      } catch (error) {
        say(`Snapshot ${name} cannot be loaded: ${error.message}`, true);
      }
    };
    const remove = async () => {
      try {
        const text = await api.getText(`/api/snapshots/${encodeURIComponent(name)}`);
        await api.remove(`/api/snapshots/${encodeURIComponent(name)}`);
        removed = { name, text };
        byId("unremove").hidden = false;
        say(`Snapshot ${name} deleted`);
      } catch (error) {
        say(`Snapshot ${name} cannot be deleted: ${error.message}`, true);
      }
      listSnapshots();
    };
    const picture = make("img", { alt: "", width: 48, height: 36 });
    if (pictures.has(name)) picture.src = pictures.get(name);
    return make("li", {}, picture, make("button", { type: "button", class: "load", onclick: load, "aria-label": `Load snapshot ${name}` }, name),
      make("button", { type: "button", class: "bad", onclick: remove, title: "Delete", "aria-label": `Delete snapshot ${name}` }, "\u00d7"));
  }));
}

let removed;

async function saveSnapshot(event) {
  event.preventDefault();
  const input = byId("snapshotname");
  const name = input.value.trim() || freeSnapshot();
  try {
    await api.put(`/api/snapshots/${encodeURIComponent(name)}`, model.text);
    keepPicture(name);
    input.value = "";
    say(`Snapshot ${name} saved`);
  } catch (error) {
    say(`The snapshot was not saved: ${error.message}`, true);
  }
  listSnapshots();
}

function freeSnapshot() {
  const taken = [...document.querySelectorAll("#snapshots .load")].map((each) => each.textContent);
  for (let k = 1; ; k++) if (!taken.includes(`snapshot_${k}`)) return `snapshot_${k}`;
}

// A small picture stays in the browser: the snapshot itself is text.
function keepPicture(name) {
  try {
    const image = readShown(96, 72);
    const canvas = make("canvas", { width: 96, height: 72 });
    canvas.getContext("2d").putImageData(image, 0, 0);
    const kept = JSON.parse(localStorage.getItem("relight.thumbnails") ?? "[]").filter(([other]) => other !== name).slice(-40);
    localStorage.setItem("relight.thumbnails", JSON.stringify([...kept, [name, canvas.toDataURL("image/jpeg", 0.8)]]));
  } catch { /* a snapshot without a picture */ }
}

// ---- The run ----------------------------------------------------------------------------------------------------------------------

const seconds = (s) => (s < 10 ? `${s.toFixed(s < 1 ? 2 : 1)} s` : s < 90 ? `${Math.round(s)} s` : `${Math.round(s / 60)} min`);

function showRun() {
  const { run } = model;
  const { progress } = run;
  const bar = byId("progress");
  const busy = run.status === "running";
  bar.hidden = !busy;
  if (progress) {
    bar.max = progress.done + progress.left;
    bar.value = progress.done;
  } else bar.removeAttribute("value");
  const line = byId("runstate");
  if (!model.connected) line.textContent = "";
  else if (isPending()) line.textContent = "Saving";
  else if (busy) line.textContent = progress ? `${progress.node}${progress.seconds_left !== undefined && progress.seconds_left !== null ? `, ${seconds(progress.seconds_left)} left` : ""}` : "Running";
  else if (run.status === "failed") line.textContent = "The run failed";
  else if (model.faults.length) line.textContent = "The text has faults";
  else if (run.status === "done") line.textContent = run.seconds !== undefined && run.seconds !== null ? `Done in ${seconds(run.seconds)}` : "Done";
  else line.textContent = "";
  line.classList.toggle("bad", run.status === "failed");
  // Read out: the end of a run, not each of its nodes.
  if (run.status === "done" || run.status === "failed") byId("runsaid").textContent = line.textContent;
}

function showFinished() {
  const { finished } = model.run;
  if (!finished) return;
  const ran = finished.ran ?? [];
  const rays = ran.reduce((sum, node) => sum + (node.rays ?? 0), 0);
  const count = ran.filter((node) => node.status === "ran").length;
  byId("ransummary").textContent = `${count} ran, ${rays.toLocaleString("en")} rays, ${seconds(finished.seconds)}`;
  byId("ran").replaceChildren(...ran.map((node) => make("tr", { class: node.status },
    make("td", {}, node.name), make("td", {}, node.status), make("td", { class: "n" }, node.seconds ? node.seconds.toFixed(3) : ""),
    make("td", { class: "n" }, node.rays ? node.rays.toLocaleString("en") : ""), make("td", {}, node.why ?? ""))));
  warnings();
}

async function warnings() {
  let found = [];
  try {
    found = (await api.getJson("/api/report.json")).warnings ?? [];
  } catch { /* no run yet */ }
  byId("warnings").replaceChildren(...found.map((line) => make("li", {}, line)));
  byId("warningcount").textContent = found.length || "";
  byId("warningbox").hidden = found.length === 0;
}

function problem({ diagnostics = [], message }) {
  byId("problems").replaceChildren(...(diagnostics.length ? diagnostics : [{ message: message ?? model.run.message ?? "" }]).map((each) => make("li", {}, make("span", {}, each.message), each.help ? make("small", {}, each.help) : undefined)));
  byId("problembox").hidden = false;
  say(diagnostics[0]?.message ?? message ?? "The run failed", true);
}

async function showGraph() {
  try {
    // Its colors are those of the page's style sheet, light and dark.
    const text = (await api.getText("/api/graph.svg")).replace(/<style>.*?<\/style>/s, "");
    const svg = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
    if (svg.localName !== "svg") throw new Error("it is not a drawing");
    byId("graph").replaceChildren(document.importNode(svg, true));
    byId("graphdialog").showModal();
  } catch (error) {
    say(`The graph cannot be shown: ${error.message}`, true);
  }
}

export function beginPanels() {
  area.addEventListener("input", () => change(area.value, TYPING));
  area.addEventListener("change", settle);
  area.addEventListener("scroll", scrolled);
  on("text", showText);
  on("faults", showFaults);
  on("sent", showFaults);
  byId("snapshotform").addEventListener("submit", saveSnapshot);
  byId("unremove").addEventListener("click", async () => {
    if (!removed) return;
    await api.put(`/api/snapshots/${encodeURIComponent(removed.name)}`, removed.text);
    byId("unremove").hidden = true;
    listSnapshots();
  });
  on("state", listSnapshots);
  on("state", warnings);
  for (const name of ["run", "text", "sent", "faults", "connection"]) on(name, showRun);
  on("run", () => { if (model.run.status === "done") byId("problembox").hidden = true; if (model.run.status === "failed") problem({ diagnostics: model.run.diagnostics, message: model.run.message }); });
  on("finished", showFinished);
  on("problem", problem);
  byId("showgraph").addEventListener("click", showGraph);
}
