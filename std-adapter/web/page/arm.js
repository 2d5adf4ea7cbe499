// The screen of the arm: in three dimensions, from the side and from the top, drawn from the joints with the dimensions of the
// model file; where the controller has commanded it to; and the path of the last minute, which is what the controller reports.

import { make, setText } from "./dom.js";
import { newSpace } from "./space.js";

const SVG = "http://www.w3.org/2000/svg";

/** The path of the last minute. */
const PATH_MS = 60_000;

/** From this distance in mm the dimensions are not those of the arm. */
const WRONG_MM = 5;

const state = { parts: null, arm: null, paths: new Map() };

export const arm = {
  id: "arm",
  title: "Arm",
  section: "arm",
  open(main, page) {
    state.arm = null;
    const views = ["side", "top"].map(newView);
    const note = make("p", { className: "quiet" }, "reading …");
    const space = newSpace();
    state.parts = { views, note, space };
    main.append(make("div", { className: "views" }, space.figure, ...views.map(({ figure }) => figure)), note);
    this.tiles(page);
  },
  draw(content, page) {
    state.arm = content;
    this.tiles(page);
  },
  forget() {
    state.paths.clear();
  },
  /** Remembers the path on every screen. */
  remember(page) {
    const now = Date.now();
    for (const { robot, position } of page.tiles) {
      if (!position || position.length < 3 || position.includes(null)) continue;
      const path = state.paths.get(robot) ?? [];
      path.push([now, ...position.slice(0, 3)]);
      while (path[0][0] < now - PATH_MS) path.shift();
      state.paths.set(robot, path);
    }
  },
  tiles(page) {
    const { parts, arm: known } = state;
    if (!known || !parts) return;
    const { joints = [], position = [], tool } = page.tile;
    const isDrawn = known.links !== null && joints.length >= 4 && !joints.includes(null);
    const chain = isDrawn ? chainOf(known.links, joints) : [];
    const path = (state.paths.get(page.robot) ?? []).map(([, ...point]) => point);
    const commanded = isDrawn && known.commanded?.length >= 4 ? chainOf(known.links, known.commanded) : [];
    for (const view of parts.views) drawView(view, chain, commanded, path, position);
    parts.space.draw(chain, commanded, path, position);
    const target = commanded.length > 0 ? " The dashed line is where the controller has commanded it to." : "";
    setText(parts.note, noteOf(known, isDrawn, chain, position, tool) + target);
  },
};

function noteOf(known, isDrawn, chain, position, tool) {
  const path = "The line is the path of the last minute, the cross the position that the controller reports.";
  if (!isDrawn) return `The dimensions of ${known.type || "this arm"} are unknown, so only its path is drawn. ${path}`;
  const flange = chain.at(-1);
  const distance = position.length >= 3 ? Math.hypot(...flange.map((value, n) => value - position[n])) : 0;
  if (tool === "0" && distance > WRONG_MM) {
    return `▲ The drawing is wrong by ${distance.toFixed(0)} mm: the controller's arm has other dimensions than the model file of ${known.type}. ${path}`;
  }
  return `Drawn with the dimensions of the model file of ${known.type}. ${path}`;
}

const rad = (degrees) => (degrees * Math.PI) / 180;
const aboutZ = (degrees) => [[Math.cos(rad(degrees)), -Math.sin(rad(degrees)), 0], [Math.sin(rad(degrees)), Math.cos(rad(degrees)), 0], [0, 0, 1]];
const aboutY = (degrees) => [[Math.cos(rad(degrees)), 0, Math.sin(rad(degrees))], [0, 1, 0], [-Math.sin(rad(degrees)), 0, Math.cos(rad(degrees))]];
const times = (a, b) => a.map((row) => [0, 1, 2].map((n) => row.reduce((sum, value, k) => sum + value * b[k][n], 0)));

/** Returns the points of an arm in mm, from the base to the flange. */
function chainOf(links, joints) {
  const points = [[0, 0, 0]];
  const add = (frame, axis, length) => points.push(points.at(-1).map((value, n) => value + length * frame[n][axis]));
  const world = aboutZ(0);
  if (links.kind === "horizontal") {
    const [j1, j2, j3] = joints;
    add(world, 2, links.d1);
    add(aboutZ(j1), 0, links.a1);
    add(aboutZ(j1 + j2), 0, links.a2);
    add(world, 2, j3);
    return points;
  }
  const [j1, j2, j3, j4, j5] = joints;
  const base = aboutZ(j1);
  const upper = times(base, aboutY(j2));
  const fore = times(base, aboutY(j2 + j3));
  const wrist = times(times(fore, aboutZ(j4)), aboutY(j5));
  add(world, 2, links.d1);
  add(base, 0, links.a1);
  add(upper, 2, links.a2);
  add(fore, 0, links.a3);
  add(fore, 1, links.b4);
  add(fore, 2, links.d4);
  add(wrist, 1, links.b6);
  add(wrist, 2, links.d6);
  return points;
}

function svg(tag, attributes = {}) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

function newView(name) {
  const picture = svg("svg", { class: "view", role: "img", "aria-label": `${name} view of the arm` });
  const parts = {
    floor: svg("line", { class: "floor" }),
    path: svg("polyline", { class: "path" }),
    chain: svg("polyline", { class: "chain" }),
    target: svg("polyline", { class: "target" }),
    joints: svg("g", { class: "joints" }),
    cross: svg("path", { class: "cross" }),
  };
  picture.append(...Object.values(parts));
  const title = name === "side" ? "Side view: X to the right, Z up" : "Top view: X to the right, Y up";
  return { name, picture, parts, reach: 100, figure: make("figure", {}, make("figcaption", {}, title), picture) };
}

/** Projects a point; the vertical axis of a picture points down. */
const project = (name, [x, y, z]) => (name === "side" ? [x, -z] : [x, -y]);

function drawView(view, chain, commanded, path, position) {
  const { name, picture, parts } = view;
  const points = chain.map((point) => project(name, point));
  const line = path.map((point) => project(name, point));
  // the scale grows with the reach, and never shrinks, so that the picture stays
  const largest = [...points, ...line].flat().reduce((most, value) => Math.max(most, Math.abs(value)), view.reach);
  view.reach = largest;
  const size = largest * 1.1;
  picture.setAttribute("viewBox", `${-size} ${-size} ${2 * size} ${2 * size}`);
  const text = (list) => list.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");
  parts.path.setAttribute("points", text(line));
  parts.chain.setAttribute("points", text(points));
  parts.target.setAttribute("points", text(commanded.map((point) => project(name, point))));
  parts.floor.setAttribute("x1", -size);
  parts.floor.setAttribute("x2", size);
  const radius = size / 50;
  while (parts.joints.children.length < points.length) parts.joints.append(svg("circle"));
  while (parts.joints.children.length > points.length) parts.joints.lastChild.remove();
  points.forEach(([x, y], n) => {
    const circle = parts.joints.children[n];
    circle.setAttribute("cx", x);
    circle.setAttribute("cy", y);
    circle.setAttribute("r", radius);
  });
  if (position.length >= 3) {
    const [x, y] = project(name, position);
    const arm = 2 * radius;
    parts.cross.setAttribute("d", `M${x - arm} ${y}h${2 * arm}M${x} ${y - arm}v${2 * arm}`);
  }
}
