// The sun of an inserted window on a dial: the middle is the zenith, the rim the horizon, up is the direction of view.
import { field } from "./ron.js";
import { settle } from "./model.js";
import { make, drawing, labelled, showValue } from "./dom.js";

const RADIUS = 56;
const radians = (degrees) => (degrees * Math.PI) / 180;

// `get` returns the node of the sun or undefined; `set` takes { azimuth, elevation }, or null for none, and whether the
// change is finished.
export function sunDial(id, get, set) {
  const of = (key) => {
    const node = field(get(), key);
    return node?.kind === "number" ? node.value : undefined;
  };
  const has = make("input", { type: "checkbox", "aria-label": `${id}: sun`, onchange: () => set(has.checked ? { azimuth: 20, elevation: 35 } : null, true) });
  const spot = drawing("circle", { r: 6, class: "sun" });
  const dial = drawing("svg", { viewBox: `${-RADIUS - 14} ${-RADIUS - 14} ${2 * RADIUS + 28} ${2 * RADIUS + 28}`, class: "dial", "aria-hidden": "true" },
    drawing("circle", { r: RADIUS }), drawing("circle", { r: (RADIUS * 2) / 3 }), drawing("circle", { r: RADIUS / 3 }),
    drawing("path", { d: `M0 ${-RADIUS}V${RADIUS}M${-RADIUS} 0H${RADIUS}` }),
    drawing("text", { y: -RADIUS - 4 }, "view"), spot);
  const azimuth = make("input", { type: "number", min: -180, max: 180, step: 1, "aria-label": `${id}: azimuth of the sun, degrees to the right`, onchange: typed });
  const elevation = make("input", { type: "number", min: -90, max: 90, step: 1, "aria-label": `${id}: elevation of the sun, degrees`, onchange: typed });
  const body = make("div", { class: "sunbody" }, dial, make("div", {}, labelled("azimuth", azimuth, "\u00b0"), labelled("elevation", elevation, "\u00b0")));
  const element = make("div", { class: "sunbox" }, make("label", { class: "check" }, has, "sun"), body);

  function typed() {
    if (Number.isFinite(azimuth.valueAsNumber) && Number.isFinite(elevation.valueAsNumber)) set({ azimuth: azimuth.valueAsNumber, elevation: elevation.valueAsNumber }, true);
  }
  const drag = (event) => {
    const box = dial.getBoundingClientRect();
    const scale = (2 * RADIUS + 28) / box.width;
    const x = (event.clientX - box.left) * scale - RADIUS - 14, y = (event.clientY - box.top) * scale - RADIUS - 14;
    const far = Math.min(1, Math.hypot(x, y) / RADIUS);
    set({ azimuth: Math.round((Math.atan2(x, -y) * 180) / Math.PI), elevation: Math.round(90 * (1 - far)) }, false);
  };
  dial.addEventListener("pointerdown", (event) => {
    dial.setPointerCapture(event.pointerId);
    drag(event);
    dial.addEventListener("pointermove", drag);
    dial.addEventListener("pointerup", () => { dial.removeEventListener("pointermove", drag); settle(); }, { once: true });
  });

  function refresh() {
    const there = Boolean(get());
    has.checked = there;
    body.hidden = !there;
    if (!there) return;
    const [a, b] = [of("azimuth") ?? 0, of("elevation") ?? 0];
    showValue(azimuth, a);
    showValue(elevation, b);
    const far = RADIUS * Math.min(1, (90 - b) / 90);
    spot.setAttribute("cx", far * Math.sin(radians(a)));
    spot.setAttribute("cy", -far * Math.cos(radians(a)));
  }
  return { element, refresh };
}
