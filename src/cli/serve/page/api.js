// The server: requests, events, and what becomes of them when it goes away.
import { halves } from "./layers.js";

// An answer of the server that is not a success: { status, body }.
export class Refused extends Error {
  constructor(status, body) {
    super(body?.message ?? `the server answered ${status}`);
    this.status = status;
    this.body = body;
  }
}

async function request(method, path, body, type) {
  const response = await fetch(path, { method, body, headers: body === undefined ? {} : { "content-type": type }, credentials: "same-origin" });
  if (!response.ok) throw new Refused(response.status, await response.json().catch(() => undefined));
  return response;
}

export const getJson = async (path) => (await request("GET", path)).json();
export const getText = async (path) => (await request("GET", path)).text();
export const getBlob = async (path) => (await request("GET", path)).blob();
export const put = (path, body, type = "text/plain; charset=utf-8") => request("PUT", path, body, type);
export const remove = (path) => request("DELETE", path);

export async function putEdit(text, base, preview) {
  return (await put(`/api/edit?base=${base}${preview ? "&preview=1" : ""}`, text)).json();
}

// The same from a page that is about to end and hears no answer.
export const putAtEnd = (text, base) => { fetch(`/api/edit?base=${base}`, { method: "PUT", body: text, keepalive: true, credentials: "same-origin" }).catch(() => {}); };

// The layers in use, by digest: halves, channel by channel. Those that no manifest names any more are let go.
const kept = new Map();

export function layer(digest) {
  if (!kept.has(digest)) {
    const loaded = request("GET", `/api/blob/${digest}`).then((response) => response.arrayBuffer()).then(halves);
    loaded.catch(() => kept.delete(digest));
    kept.set(digest, loaded);
  }
  return kept.get(digest);
}

export function keepOnly(digests) {
  for (const digest of kept.keys()) if (!digests.has(digest)) kept.delete(digest);
}

const EVENTS = ["state", "progress", "finished", "edit", "layers", "problem"];
const AGAIN = 1000;
const REST = 20000;

// Follows the server's events for ever. `on.open` when the stream (again) stands, `on.lost` with a reason when it does
// not; an EventSource gives up on some answers, so that it is made anew. A page that is not seen lets go of its stream
// after a while: browsers open six connections to a server, for all its pages.
export function follow(on) {
  let stream, timer;
  const lost = async () => {
    stream.close();
    clearTimeout(timer);
    timer = setTimeout(connect, AGAIN);
    let reason = "The server does not answer";
    try {
      const { status } = await fetch("/api/state", { credentials: "same-origin" });
      if (status === 401 || status === 403) reason = "The server was started anew: open the address that it printed, then this page follows, too";
    } catch { /* it does not answer */ }
    on.lost(reason);
  };
  function connect() {
    stream = new EventSource("/api/events");
    stream.onopen = () => on.open();
    stream.onerror = lost;
    for (const name of EVENTS) stream.addEventListener(name, (event) => on[name]?.(JSON.parse(event.data)));
  }
  connect();
  let rest;
  document.addEventListener("visibilitychange", () => {
    clearTimeout(rest);
    if (document.hidden) rest = setTimeout(() => { stream.close(); clearTimeout(timer); }, REST);
    else if (stream.readyState === EventSource.CLOSED) { clearTimeout(timer); connect(); }
  });
}
