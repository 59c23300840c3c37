// Small helpers for elements.
export const byId = (id) => document.getElementById(id);

// make("button", { class: "tool", "aria-label": "Undo", onclick: undo }, "text", child, ..)
export function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== undefined && child !== null));
  return element;
}

export function drawing(name, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// A label around a control.
export const labelled = (text, control, unit) => make("label", { class: "field" }, make("span", {}, text), control, unit ? make("i", {}, unit) : undefined);

// Sets a control's value unless a person is typing in it.
export function showValue(control, value) {
  if (document.activeElement === control && control.type !== "range") return;
  if (control.value !== String(value)) control.value = value;
}
