// The arm in three dimensions on a canvas: a perspective that is turned by a pointer or by keys.

import { make } from "./dom.js";

const START = { yaw: -40, pitch: 22, zoom: 1 };

/** The distance of the eye, in reaches of the arm. */
const DISTANCE = 3.5;

/** Whether the page is dark. */
const scheme = matchMedia("(prefers-color-scheme: dark)");

const limit = (value, low, high) => Math.max(low, Math.min(high, value));

/** Makes a view. `draw` gets the points of the arm, those of the commanded arm, the path, and the reported position, in mm. */
export function newSpace() {
  const canvas = make("canvas", { className: "space", tabIndex: 0, role: "img", "aria-label": "3D view of the arm. Arrow keys turn it, + and - change its size, Home resets it." });
  const view = { canvas, ...START, reach: 100, scene: null };
  let drag = null;
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    drag = [event.clientX, event.clientY];
  };
  canvas.onpointermove = (event) => {
    if (!drag) return;
    turn(view, (event.clientX - drag[0]) * 0.5, (event.clientY - drag[1]) * 0.5);
    drag = [event.clientX, event.clientY];
  };
  canvas.onpointerup = canvas.onpointercancel = () => { drag = null; };
  canvas.onwheel = (event) => {
    event.preventDefault();
    resize(view, event.deltaY < 0 ? 1.1 : 1 / 1.1);
  };
  canvas.onkeydown = (event) => {
    const act = { ArrowLeft: () => turn(view, -5, 0), ArrowRight: () => turn(view, 5, 0), ArrowUp: () => turn(view, 0, -5), ArrowDown: () => turn(view, 0, 5), "+": () => resize(view, 1.1), "-": () => resize(view, 1 / 1.1), Home: () => turn(Object.assign(view, START), 0, 0) }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  };
  new ResizeObserver(() => render(view)).observe(canvas);
  // otherwise a robot at rest is not drawn again
  scheme.onchange = () => render(view);
  const figure = make("figure", {}, make("figcaption", {}, "3D: drag or arrow keys turn it, the wheel, + and − change its size, Home resets it"), canvas);
  const draw = (chain, commanded, path, position) => {
    view.scene = { chain, commanded, path, position };
    render(view);
  };
  return { figure, draw };
}

function turn(view, yaw, pitch) {
  view.yaw = (view.yaw + yaw) % 360;
  view.pitch = limit(view.pitch + pitch, -90, 90);
  render(view);
}

function resize(view, factor) {
  view.zoom = limit(view.zoom * factor, 0.3, 6);
  render(view);
}

/** Returns a function that projects a point in mm to a place on the canvas, with its depth and its scale in pixels per mm. */
function camera({ yaw, pitch, zoom, reach }, width, height) {
  const [y, p] = [yaw, pitch].map((degrees) => (degrees * Math.PI) / 180);
  const distance = DISTANCE * reach;
  const size = (Math.min(width, height) / (1.9 * reach)) * zoom;
  return ([px, py, pz]) => {
    const right = px * Math.cos(y) - py * Math.sin(y);
    const away = px * Math.sin(y) + py * Math.cos(y);
    const up = pz - 0.45 * reach;
    const depth = away * Math.cos(p) - up * Math.sin(p);
    const scale = (size * distance) / Math.max(distance + depth, 0.1 * distance);
    return { x: width / 2 + right * scale, y: height / 2 - (up * Math.cos(p) + away * Math.sin(p)) * scale, depth, scale };
  };
}

function render(view) {
  const { canvas, scene } = view;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!scene || width === 0) return;
  [canvas.width, canvas.height] = [width * devicePixelRatio, height * devicePixelRatio];
  const pen = canvas.getContext("2d");
  pen.scale(devicePixelRatio, devicePixelRatio);
  pen.lineCap = pen.lineJoin = "round";
  // the browser resolves the colours of the theme
  const { color, borderTopColor, caretColor, textDecorationColor, backgroundColor, fontFamily } = getComputedStyle(canvas);
  const colours = { text: color, line: borderTopColor, accent: caretColor, mark: textDecorationColor, back: backgroundColor, fontFamily };
  // the scale grows with the reach, and never shrinks, so that the picture stays
  const known = [...scene.chain, ...scene.path, scene.position.slice(0, 3)].filter((point) => point.length === 3);
  view.reach = known.reduce((most, point) => Math.max(most, Math.hypot(...point)), view.reach);
  const place = camera(view, width, height);
  drawFloor(pen, place, view.reach, colours);
  polyline(pen, scene.path.map(place), colours.accent, 2, []);
  drawArm(pen, scene.chain.map(place), view.reach, colours);
  polyline(pen, scene.commanded.map(place), colours.accent, 2, [6, 5]);
  drawCross(pen, scene.position, place, colours);
  // where the ends are drawn
  const at = (point) => (point ? `${place(point).x.toFixed(1)} ${place(point).y.toFixed(1)}` : "");
  Object.assign(canvas.dataset, { flange: at(scene.chain.at(-1)), commanded: at(scene.commanded.at(-1)), position: at(scene.position.length >= 3 ? scene.position.slice(0, 3) : null), path: scene.path.length });
}

function polyline(pen, points, colour, width, dash) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.beginPath();
  points.forEach(({ x, y }, n) => (n === 0 ? pen.moveTo(x, y) : pen.lineTo(x, y)));
  pen.stroke();
  pen.setLineDash([]);
}

/** The floor as a grid, and the axes of the base with their names. */
function drawFloor(pen, place, reach, { text, line, fontFamily }) {
  const edge = 0.8 * reach;
  for (let n = -4; n <= 4; n += 1) {
    const at = (n * edge) / 4;
    polyline(pen, [[at, -edge, 0], [at, edge, 0]].map(place), line, 1, []);
    polyline(pen, [[-edge, at, 0], [edge, at, 0]].map(place), line, 1, []);
  }
  pen.fillStyle = text;
  pen.font = `12px ${fontFamily}`;
  const length = 0.35 * reach;
  for (const [name, end] of [["X", [length, 0, 0]], ["Y", [0, length, 0]], ["Z", [0, 0, length]]]) {
    const { x, y } = place(end);
    polyline(pen, [place([0, 0, 0]), { x, y }], text, 1.5, []);
    pen.fillText(name, x + 4, y - 4);
  }
}

/** The links and joints, the farthest first. */
function drawArm(pen, points, reach, { text, accent, back }) {
  const links = points.slice(1).map((end, n) => ({ depth: (points[n].depth + end.depth) / 2, draw: () => polyline(pen, [points[n], end], text, limit(0.06 * reach * end.scale, 4, 40), []) }));
  const joints = points.map(({ x, y, depth, scale }) => ({
    // a joint is in front of its links
    depth: depth - 0.04 * reach,
    draw: () => {
      pen.beginPath();
      pen.arc(x, y, limit(0.026 * reach * scale, 3, 20), 0, 2 * Math.PI);
      pen.fillStyle = back;
      pen.strokeStyle = accent;
      pen.lineWidth = 2.5;
      pen.fill();
      pen.stroke();
    },
  }));
  for (const { draw } of [...links, ...joints].sort((a, b) => b.depth - a.depth)) draw();
}

function drawCross(pen, position, place, { mark }) {
  if (position.length < 3) return;
  const { x, y } = place(position.slice(0, 3));
  polyline(pen, [{ x: x - 8, y }, { x: x + 8, y }], mark, 2, []);
  polyline(pen, [{ x, y: y - 8 }, { x, y: y + 8 }], mark, 2, []);
}
