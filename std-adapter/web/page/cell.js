// The screen of the cell: a tile for each robot, with its state, why it is not ready, and what to do.

import { kindOf, make, setText, stateText, withUnit } from "./dom.js";

const JOINTS = (n) => `J${n + 1}`;
const AXES = ["X", "Y", "Z", "RX", "RY", "RZ"];

let list = null;

export const cell = {
  id: "cell",
  title: "Cell",
  section: "cell",
  open(main, page) {
    list = make("div", { className: "tiles" });
    main.append(list);
    this.tiles(page);
  },
  tiles(page) {
    while (list.children.length > page.tiles.length) list.lastChild.remove();
    page.tiles.forEach((tile, n) => {
      const parts = list.children[n]?.parts ?? newTile(page, n);
      drawTile(parts, tile, page);
    });
  },
  draw() {},
};

function newTile(page, n) {
  const parts = {
    title: make("h2"),
    kind: make("span"),
    address: make("span", { className: "quiet" }),
    state: make("p"),
    words: make("p", { className: "quiet" }),
    reasons: make("ul", { className: "reasons" }),
    holder: make("p"),
    numbers: make("dl", { className: "numbers" }),
    tasks: make("p", { className: "quiet" }),
  };
  const halt = make("button", { type: "button", className: "halt", onclick: () => page.haltRobot(n) }, "HALT");
  const open = make("button", { type: "button", onclick: () => page.select(n) }, "Select");
  const head = make("div", { className: "head" }, make("div", {}, parts.title, parts.kind, " ", parts.address), halt);
  const element = make("section", { className: "tile" }, head, parts.state, parts.words, parts.reasons, parts.holder, parts.numbers, parts.tasks, open);
  element.parts = parts;
  parts.element = element;
  parts.open = open;
  parts.halt = halt;
  list.append(element);
  return parts;
}

function drawTile(parts, tile, page) {
  const kind = kindOf(tile);
  const isOnly = page.tiles.length === 1;
  parts.element.className = `tile ${kind.name}${tile.robot === page.robot && !isOnly ? " selected" : ""}`;
  setText(parts.title, tile.name);
  setText(parts.kind, kind.text);
  parts.kind.className = "kind";
  setText(parts.address, tile.address);
  setText(parts.state, stateText(tile));
  parts.state.className = `state big ${tile.level}`;
  setText(parts.words, tile.words.join(" · "));
  setText(parts.holder, tile.holder ? `control: ${tile.holder}` : "");
  parts.open.hidden = isOnly;
  // the large one of the header halts it
  parts.halt.hidden = isOnly;
  parts.halt.setAttribute("aria-label", `HALT ${tile.name}`);
  drawReasons(parts.reasons, tile.reasons);
  const used = usedJoints(tile.joints ?? []);
  const joints = used.map((value, n) => [JOINTS(n), withUnit(value, tile.units[n])]);
  const position = AXES.map((name, n) => [name, tile.position?.[n]]).filter(([, value]) => value !== undefined);
  const place = position.map(([name, value], n) => [name, withUnit(value, n < 3 ? "mm" : "°")]);
  const known = [["speed", tile.speed && `${tile.speed} %`], ["tool", tile.tool], ["work", tile.work]];
  drawNumbers(parts.numbers, [...joints, ...place, ...known.filter(([, value]) => value)]);
  const running = (tile.tasks ?? []).filter(([, state]) => state === "running").map(([name]) => name);
  setText(parts.tasks, running.length > 0 ? `running tasks: ${running.join(", ")}` : "no task runs");
}

/** The extended axes of an arm without them are 0. */
function usedJoints(joints) {
  return joints.slice(6).every((joint) => joint === 0) ? joints.slice(0, 6) : joints;
}

function drawReasons(list, reasons) {
  const key = JSON.stringify(reasons);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...reasons.map(([what, remedy]) => make("li", {}, make("strong", {}, what), make("span", {}, remedy))));
}

function drawNumbers(list, numbers) {
  const names = numbers.map(([name]) => name).join();
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...numbers.map(([name]) => make("div", {}, make("dt", {}, name), make("dd"))));
  }
  numbers.forEach(([, value], n) => setText(list.children[n].lastChild, value));
}
