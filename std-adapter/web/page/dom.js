// Elements of the page. Text is set as text: what a controller sends is never markup.

/** Makes an element; `properties` are set on it, `children` are elements or text. */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.includes("-") || name === "for" || name === "role" || name === "colspan") element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children);
  return element;
}

/** Sets the text of an element, only if it differs, so that a selection of the user stays. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Returns the element with an id. */
export const byId = (id) => document.getElementById(id);

/** Shows the outcome of an action, also in an open dialog: the rest of the page is inert. */
export function notify(text, isBad = false) {
  for (const notice of document.querySelectorAll("#notice, dialog[open] .notice")) {
    notice.textContent = text;
    notice.classList.toggle("bad", isBad);
  }
}

/** Shows why an action failed. `what` says that it was not done, which an error with an unknown outcome must not say. */
export function notifyFailure(what, { message }) {
  notify(/unknown whether/i.test(message) ? message : `${what}: ${message}`, true);
}

/** The alerts by their subjects: no other outcome replaces them. */
const alerts = new Map();

/** Shows an alert on all screens and in dialogs until it is cleared, or the user dismisses it. `null` clears it. */
export function alertOf(subject, text) {
  if (text === null) alerts.delete(subject);
  else alerts.set(subject, text);
  drawAlerts();
}

/** Shows the alerts in each place for them. */
export function drawAlerts() {
  for (const list of document.querySelectorAll(".alerts")) {
    const dismiss = (subject) => make("button", { type: "button", "aria-label": `Dismiss: ${subject}`, onclick: () => alertOf(subject, null) }, "Dismiss");
    list.replaceChildren(...[...alerts].map(([subject, text]) => make("li", {}, make("span", {}, text), dismiss(subject))));
  }
}

/** Asks the user; the question names the robot. Resolves to whether the user agreed. */
export function ask(title, tile, text, yes) {
  const dialog = byId("question");
  if (dialog.open) return Promise.resolve(false);
  const kind = kindOf(tile);
  dialog.dataset.robot = tile.robot;
  dialog.className = kind.name;
  byId("question-title").textContent = title;
  byId("question-robot").textContent = `${tile.name} (${tile.address}), ${kind.text}`;
  byId("question-text").textContent = text;
  byId("question-yes").textContent = yes;
  byId("question-halt-robot").textContent = tile.name;
  Object.assign(byId("question-notice"), { textContent: "", className: "notice" });
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}

/** Returns the robot of the open question; `null` without one. */
export function askedOf() {
  const { open, dataset } = byId("question");
  return open ? Number(dataset.robot) : null;
}

/** Returns whether a controller is real, as a class name and as text. An unknown one counts as real. */
export function kindOf(tile) {
  return tile.virtual ? { name: "virtual", text: "virtual controller" } : { name: "real", text: "real controller" };
}

/** Writes a number with its unit, if that is known; NaN arrives as `null`. */
export const withUnit = (value, unit) => (typeof value === "number" ? `${value.toFixed(2)}${unit === "mm" ? " " : ""}${unit ?? ""}` : "?");

/** The symbols of the levels: the state is not told by the colour alone. */
const SYMBOLS = { good: "●", busy: "▶", bad: "▲", unknown: "?" };

/** Returns the state of a robot with its symbol. */
export const stateText = (tile) => `${SYMBOLS[tile.level]} ${tile.state}`;
