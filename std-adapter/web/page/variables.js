// The screen of variables and I/O: live values, a search, writes with the old and the new value, and their undo.

import { ask, make, notify, notifyFailure, setText } from "./dom.js";
import { order } from "./net.js";

/** The values of a sparkline. */
const HISTORY = 60;

/** The units of the numbers of a kind; a label such as `pressure [bar]` has its unit at its end. */
const UNITS = [[/^P\d+$/i, "mm, °"], [/^T\d+$/i, "mm"], [/_POSITION$/i, "mm, °"], [/SPEED$/i, "%"]];

/** The numbers of these are joints, whose units the arm has. */
const JOINTS = /^J\d+$|_ANGLE$/i;

/** The labels of the file that `bcap web --labels` has read, by names in upper case. */
const labels = new Map();

export const setLabels = (known) => Object.entries(known).forEach(([name, label]) => labels.set(name, label));

/** Returns the label of a variable: that of this browser, or of the file. */
const labelOf = (key, name) => localStorage.getItem(key) ?? labels.get(name.toUpperCase()) ?? "";

function unitOf(name, label) {
  const joints = () => [...new Set((state.page.tile.units ?? []).filter((unit) => unit !== ""))].join(", ");
  return /\[([^\]]+)\]\s*$/.exec(label)?.[1] ?? (JOINTS.test(name) ? joints() : UNITS.find(([kind]) => kind.test(name))?.[1]) ?? "";
}

const state = { page: null, parts: null, rows: new Map(), histories: new Map(), filter: "", writes: [], missing: null };

/** The key under which the browser keeps the selection of a robot. */
const key = (page) => `names ${page.tile.address}`;

export const variables = {
  id: "variables",
  title: "Variables and I/O",
  section: "variables",
  open(main, page) {
    const names = make("input", { id: "names", value: localStorage.getItem(key(page)) ?? "I1-I8 IO128-IO143 P1", spellcheck: false, "aria-label": "Variables, such as I1-I8 IO128 P1" });
    const form = make("form", { className: "row", onsubmit: (event) => { event.preventDefault(); select(names.value); } }, names, make("button", { type: "submit" }, "Show"));
    const search = make("input", { id: "search", type: "search", value: state.filter, placeholder: "search", "aria-label": "Search names and values", oninput: () => { state.filter = search.value; filterRows(); } });
    const grid = make("div", { className: "io", role: "group", "aria-label": "I/O" });
    const body = make("tbody");
    const head = make("thead", {}, make("tr", {}, ...["Name", "Label", "Value", "Unit", "Last values", ""].map((text) => make("th", { scope: "col" }, text))));
    const writes = make("section", { className: "writes" });
    main.append(form, search, grid, make("div", { className: "scroll" }, make("table", {}, head, body)), writes);
    Object.assign(state, { page, parts: { grid, body, writes }, rows: new Map() });
    drawWrites();
    if (page.tiles.length > 0) select(names.value);
  },
  draw(rows, page) {
    state.page = page;
    const seen = new Set();
    for (const row of rows) {
      seen.add(row[0]);
      drawRow(row);
    }
    for (const [name, row] of state.rows) {
      if (!seen.has(name)) {
        row.element.remove();
        state.rows.delete(name);
      }
    }
    // the rows are in the order of the selection
    const bodies = [state.parts.grid, state.parts.body];
    for (const body of bodies) {
      const wanted = rows.map(([name]) => state.rows.get(name).element).filter((element) => element.parentElement === body);
      if (wanted.some((element, n) => body.children[n] !== element)) body.append(...wanted);
    }
    filterRows();
  },
  tiles(page) {
    // the controller was not connected
    if (state.missing && page.tile.level !== "unknown") select(state.missing);
    for (const row of state.rows.values()) row.update();
  },
  forget() {
    state.histories.clear();
    state.writes = [];
  },
};

async function select(text) {
  const { page } = state;
  const of = key(page);
  const names = text.split(/[\s,]+/).filter((name) => name !== "");
  state.missing = page.tile.level === "unknown" ? text : null;
  try {
    await order("select", { robot: page.robot, names });
    localStorage.setItem(of, text);
    notify("");
  } catch (error) {
    notify(error.message, true);
  }
}

function isIo(name) {
  return /^IO\d+$/i.test(name);
}

function drawRow([name, text, hasChanged, isRead, number, isExact]) {
  const row = state.rows.get(name) ?? (isIo(name) ? newLamp(name) : newRow(name));
  Object.assign(row, { text, isRead, isExact });
  setText(row.value, isIo(name) && isRead ? (text === "true" ? "on" : "off") : text);
  row.element.classList.toggle("changed", hasChanged);
  row.element.classList.toggle("on", isIo(name) && text === "true");
  row.element.classList.toggle("unread", !isRead);
  if (number !== null && row.line) drawLine(row.line, remember(name, number));
  row.update();
}

/** A lamp of the I/O grid; the control makes it a button. */
function newLamp(name) {
  const value = make("span", { className: "value" });
  const label = make("span", { className: "about" }, labelOf(`label ${state.page.tile.address} ${name}`, name));
  const element = make("button", { type: "button", className: "lamp" }, make("span", { className: "name" }, name), value, label);
  const row = { name, element, value, label };
  element.onclick = () => write(row, row.text === "true" ? "false" : "true");
  row.update = () => {
    element.disabled = !state.page.hasControl || !row.isRead;
  };
  state.parts.grid.append(element);
  state.rows.set(name, row);
  return row;
}

function newRow(name) {
  const key = `label ${state.page.tile.address} ${name}`;
  const unit = make("td", { className: "unit" });
  const drawUnit = () => setText(unit, unitOf(name, label.value));
  const label = make("input", { className: "label", value: labelOf(key, name), placeholder: "—", "aria-label": `Label of ${name}`, onchange: () => { localStorage.setItem(key, label.value); drawUnit(); } });
  drawUnit();
  const value = make("td", { className: "value" });
  const line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  line.setAttribute("class", "spark");
  line.setAttribute("viewBox", "0 0 60 16");
  line.setAttribute("aria-hidden", "true");
  const button = make("button", { type: "button" }, "Write");
  const element = make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, label), value, unit, make("td", {}, line), make("td", {}, button));
  const row = { name, element, value, line, label };
  button.onclick = () => edit(row);
  row.update = () => {
    button.hidden = !state.page.mayWrite;
    button.disabled = !state.page.hasControl || !row.isRead || !row.isExact;
    button.title = !state.page.hasControl ? "take the control first" : row.isExact === false ? "the text is longer than shown, or has control characters; write it with bcap put" : "";
  };
  state.parts.body.append(element);
  state.rows.set(name, row);
  return row;
}

function remember(name, number) {
  const id = `${state.page.robot} ${name}`;
  const history = state.histories.get(id) ?? [];
  history.push(number);
  if (history.length > HISTORY) history.shift();
  state.histories.set(id, history);
  return history;
}

function drawLine(svg, history) {
  const [low, high] = [Math.min(...history), Math.max(...history)];
  const height = (number) => (high === low ? 8 : 15 - (14 * (number - low)) / (high - low));
  const points = history.map((number, n) => `${n},${height(number).toFixed(1)}`).join(" ");
  let line = svg.firstChild;
  if (!line) {
    line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
    svg.append(line);
  }
  line.setAttribute("points", points);
}

function filterRows() {
  const wanted = state.filter.toLowerCase();
  for (const row of state.rows.values()) {
    const text = `${row.name} ${row.label.value ?? row.label.textContent} ${row.text}`.toLowerCase();
    row.element.hidden = !text.includes(wanted);
  }
}

/** Puts an input in the place of the value. */
function edit(row) {
  const input = make("input", { className: "edit", value: row.text, "aria-label": `New value of ${row.name}` });
  const form = make("form", {}, input, make("button", { type: "submit", className: "primary" }, "Check"));
  const cell = make("td", {}, form);
  const close = () => cell.replaceWith(row.value);
  form.onsubmit = (event) => {
    event.preventDefault();
    close();
    write(row, input.value);
  };
  input.onkeydown = (event) => {
    if (event.key === "Escape") close();
  };
  row.value.replaceWith(cell);
  input.select();
}

/** Checks a value, shows the old and the new one, and writes it. */
async function write({ name }, text) {
  const { page } = state;
  const { robot, tile } = page;
  try {
    const checked = await order("check", { robot, name, text });
    const isAgreed = await ask("Write a variable", tile, `${checked.name}: ${checked.old} → ${checked.new}`, `Write ${checked.name}`);
    if (!isAgreed) {
      notify("nothing was written");
      return;
    }
    await order("write", { robot, check: checked.check, revoked: tile.revoked });
    state.writes.unshift({ robot, robotName: tile.name, name: checked.name, old: checked.old, next: checked.new, isExact: checked.exact });
    state.writes.length = Math.min(state.writes.length, 20);
    notify(`${tile.name}: ${checked.name} = ${checked.new} is written`);
    drawWrites();
  } catch (error) {
    notifyFailure("not written", error);
  }
}

function drawWrites() {
  const rows = state.writes.map((done) => {
    const undo = make("button", { type: "button", onclick: () => write({ name: done.name }, done.old) }, "Undo");
    undo.disabled = done.robot !== state.page.robot || !done.isExact;
    undo.title = done.isExact ? "" : "the old text is longer than shown, or has control characters";
    return make("li", {}, `${done.robotName}: ${done.name} ${done.old} → ${done.next} `, undo);
  });
  const title = rows.length > 0 ? [make("h2", {}, "Written by this page, latest first")] : [];
  state.parts.writes.replaceChildren(...title, make("ul", {}, ...rows));
}
