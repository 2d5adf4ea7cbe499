// The screen of plots: any numbers over time, with a pause, a cursor, a zoom, and an export to CSV and MCAP.

import { make, notify, setText } from "./dom.js";
import { save, saveBlob } from "./net.js";

/** The time from one sample to the next, and the samples that are kept: ten minutes. */
const STEP_MS = 200;
const KEPT = 3000;

/** The windows of the zoom, in seconds. */
const WINDOWS = [10, 30, 60, 120, 300, 600];

const AXES = ["X", "Y", "Z", "RX", "RY", "RZ"];

/** Colours with a contrast of 3 : 1 to a light and a dark surface; a dash tells them apart too. */
const LOOKS = [["#2f7bd6", []], ["#c2571a", [8, 4]], ["#2e8b57", [2, 3]], ["#a05bc8", [10, 3, 2, 3]], ["#c23b6b", [4, 4]], ["#8a7a1f", [12, 5]]];

const state = { parts: null, page: null, series: new Map(), chosen: new Set(["J1", "J2", "J3"]), window: 60, isPaused: false, cursor: null, variables: [] };

export const plots = {
  id: "plots",
  title: "Plots",
  section: "plots",
  open(main, page) {
    state.page = page;
    state.cursor = null;
    // of another robot, or of an earlier time
    state.variables = [];
    const canvas = make("canvas", { className: "plot", tabIndex: 0, role: "img", "aria-label": "Plot of the chosen numbers over time" });
    const choices = make("fieldset", { className: "choices" }, make("legend", {}, "Numbers; variables are chosen on their screen"));
    const pause = make("button", { type: "button", id: "hold", onclick: () => { state.isPaused = !state.isPaused; draw(); } }, pauseText());
    const zoom = make("select", { id: "window", "aria-label": "Window", onchange: () => { state.window = Number(zoom.value); draw(); } }, ...WINDOWS.map((seconds) => make("option", { value: seconds }, `${seconds} s`)));
    const csv = make("button", { type: "button", id: "csv", onclick: exportCsv }, "Save as CSV");
    const mcap = make("button", { type: "button", id: "mcap", onclick: exportMcap }, "Save as MCAP");
    const legend = make("ul", { className: "legend" });
    zoom.value = String(state.window);
    state.parts = { canvas, choices, pause, legend, zoom };
    canvas.onpointermove = (event) => { state.cursor = event.offsetX; draw(); };
    canvas.onpointerleave = () => { state.cursor = null; draw(); };
    canvas.onkeydown = moveCursor;
    canvas.onwheel = (event) => { event.preventDefault(); step(Math.sign(event.deltaY)); };
    main.append(make("div", { className: "row" }, pause, zoom, csv, mcap), canvas, legend, choices);
    drawChoices();
    // draws again when the window changes its size
    new ResizeObserver(draw).observe(canvas);
  },
  draw(rows) {
    state.variables = rows.filter(([, , , , number]) => number !== null).map(([name, , , , number]) => [name, number]);
    drawChoices();
  },
  forget() {
    state.series.clear();
  },
};

function step(direction) {
  const at = WINDOWS.indexOf(state.window) + direction;
  state.window = WINDOWS[Math.max(0, Math.min(WINDOWS.length - 1, at))];
  state.parts.zoom.value = String(state.window);
  draw();
}

function moveCursor(event) {
  const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (!direction) return;
  event.preventDefault();
  const width = state.parts.canvas.clientWidth;
  state.cursor = Math.max(0, Math.min(width, (state.cursor ?? width / 2) + direction * 5));
  draw();
}

/** Returns the present numbers with their names. */
function numbers() {
  const { joints = [], position = [] } = state.page?.tile ?? {};
  const axes = [...joints.slice(0, 8).map((value, n) => [`J${n + 1}`, value]), ...AXES.map((name, n) => [name, position[n]])];
  return [
    // NaN arrives as `null`
    ...axes.filter(([, value]) => typeof value === "number"),
    // the server sends variables to this screen only
    ...(state.parts?.canvas.isConnected ? state.variables : []),
  ];
}

setInterval(() => {
  // values that are old are not sampled
  if (!state.page || state.page.tile.level === "unknown" || document.documentElement.classList.contains("stale")) return;
  const now = Date.now();
  for (const [name, value] of numbers()) {
    const id = `${state.page.robot} ${name}`;
    const samples = state.series.get(id) ?? [];
    samples.push([now, value]);
    if (samples.length > KEPT) samples.shift();
    state.series.set(id, samples);
  }
  if (state.parts?.canvas.isConnected && !state.isPaused) draw();
}, STEP_MS);

function drawChoices() {
  const { choices } = state.parts;
  const names = numbers().map(([name]) => name);
  if (choices.dataset.names === names.join()) return;
  choices.dataset.names = names.join();
  const boxes = names.map((name) => {
    const box = make("input", { type: "checkbox", checked: state.chosen.has(name), onchange: () => { state.chosen[box.checked ? "add" : "delete"](name); draw(); } });
    return make("label", { className: "check" }, box, name);
  });
  choices.replaceChildren(choices.firstChild, ...boxes);
}

/** Returns the chosen series. */
function chosen() {
  const ids = [...state.chosen].map((name) => [name, state.series.get(`${state.page.robot} ${name}`) ?? []]);
  return ids.filter(([, samples]) => samples.length > 0);
}

const pauseText = () => (state.isPaused ? "Go on" : "Pause");

/** The end of the window, which stands still during a pause. */
let heldEnd = 0;

function draw() {
  const { canvas, pause, legend } = state.parts;
  setText(pause, pauseText());
  const [width, height, scale] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio];
  [canvas.width, canvas.height] = [width * scale, height * scale];
  const pen = canvas.getContext("2d");
  pen.scale(scale, scale);
  const colours = getComputedStyle(canvas);
  const series = chosen();
  if (!state.isPaused) heldEnd = Date.now();
  const [end, begin] = [heldEnd, heldEnd - state.window * 1000];
  const shown = series.map(([name, samples]) => [name, samples.filter(([time]) => time >= begin && time <= end)]);
  const values = shown.flatMap(([, samples]) => samples.map(([, value]) => value));
  const [low, high] = range(values);
  const x = (time) => ((time - begin) / (end - begin)) * width;
  const y = (value) => height - 22 - ((value - low) / (high - low)) * (height - 34);
  drawGrid(pen, colours, { width, height, low, high, y });
  shown.forEach(([, samples], n) => {
    const [colour, dash] = LOOKS[n % LOOKS.length];
    pen.strokeStyle = colour;
    pen.lineWidth = 1.8;
    pen.setLineDash(dash);
    pen.beginPath();
    samples.forEach(([time, value], k) => (k === 0 ? pen.moveTo(x(time), y(value)) : pen.lineTo(x(time), y(value))));
    pen.stroke();
  });
  pen.setLineDash([]);
  drawLegend(legend, shown, state.cursor === null ? end : begin + (state.cursor / width) * (end - begin), end);
  if (state.cursor !== null) {
    pen.strokeStyle = colours.color;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(state.cursor, 0);
    pen.lineTo(state.cursor, height - 22);
    pen.stroke();
  }
}

function range(values) {
  const low = values.reduce((a, b) => Math.min(a, b), Infinity);
  const high = values.reduce((a, b) => Math.max(a, b), -Infinity);
  if (low > high) return [0, 1];
  const room = (high - low) * 0.05 || Math.max(Math.abs(low) * 0.05, 0.5);
  return [low - room, high + room];
}

function drawGrid(pen, colours, { width, height, low, high, y }) {
  pen.fillStyle = colours.color;
  pen.font = `12px ${colours.fontFamily}`;
  pen.strokeStyle = colours.borderTopColor;
  pen.lineWidth = 1;
  for (let n = 0; n <= 4; n += 1) {
    const value = low + ((high - low) * n) / 4;
    pen.beginPath();
    pen.moveTo(0, y(value));
    pen.lineTo(width, y(value));
    pen.stroke();
    pen.fillText(value.toPrecision(5), 4, y(value) - 3);
  }
  pen.fillText(`−${state.window} s`, 4, height - 6);
  const now = state.isPaused ? "paused" : "now";
  pen.fillText(now, width - pen.measureText(now).width - 4, height - 6);
}

/** Writes the value of each series at a time. */
function drawLegend(legend, shown, time, end) {
  while (legend.children.length > shown.length) legend.lastChild.remove();
  shown.forEach(([name, samples], n) => {
    const item = legend.children[n] ?? legend.appendChild(make("li", {}, make("span", { className: "mark" }), make("span")));
    item.firstChild.style.background = LOOKS[n % LOOKS.length][0];
    const before = samples.filter(([at]) => at <= time).at(-1);
    const age = ((time - end) / 1000).toFixed(1);
    setText(item.lastChild, `${name} ${before ? before[1].toFixed(3) : "–"}${state.cursor === null ? "" : ` at ${age} s`}`);
  });
}

/** Saves the chosen numbers: a line for each sample. */
function exportCsv() {
  const series = chosen();
  const times = [...new Set(series.flatMap(([, samples]) => samples.map(([time]) => time)))].sort((a, b) => a - b);
  const columns = series.map(([, samples]) => new Map(samples));
  const quoted = (text) => `"${text.replaceAll('"', '""')}"`;
  const head = ["time", ...series.map(([name]) => quoted(name))].join();
  const lines = times.map((time) => [new Date(time).toISOString(), ...columns.map((column) => column.get(time) ?? "")].join());
  saveBlob(new Blob([[head, ...lines, ""].join("\n")], { type: "text/csv" }), "bcap.csv");
}

/** Saves the chosen numbers for Foxglove and PlotJuggler: a topic for each. */
async function exportMcap() {
  const series = chosen().map(([name, samples]) => ({ name, samples }));
  await save("/mcap", "bcap.mcap", JSON.stringify(series)).catch((error) => notify(`not saved: ${error.message}`, true));
}
