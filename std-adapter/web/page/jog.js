// The screen of a jog: a robot moves by short steps while a button is held. The page answers each pulse of the server with a
// heartbeat; the server halts the robot without one. The jog ends immediately when the page is hidden, loses the focus or is left.

import { ask, byId, make, notify, notifyFailure, setText, withUnit } from "./dom.js";
import { beat, order } from "./net.js";

const STEPS = [0.1, 0.5, 1, 2, 5];

/** The number of the last press. */
let presses = 0;

const state = {
  page: null,
  content: null,
  parts: null,
  /** Whether this page has begun a jog that has not ended. */
  isOn: false,
  /** Whether the window has lost the focus since the user agreed to a jog. */
  isLeft: false,
  /** The robot of that jog, and its number. */
  robot: 0,
  jog: 0,
  /** The button that is held: its element, the pointer or key that holds it, and the number of the press. */
  held: null,
  step: 1,
  percent: 10,
};

export const jog = {
  id: "jog",
  title: "Jog",
  section: "jog",
  open(main, page) {
    Object.assign(state, { page, content: null, held: null, isOn: false });
    const begin = make("button", { type: "button", id: "jog-begin", className: "primary", onclick: start }, "Begin to jog");
    const end = make("button", { type: "button", id: "jog-end", onclick: () => drop("the user ended it") }, "End the jog");
    const step = select("jog-step", STEPS, state.step, (value) => { state.step = value; });
    const speed = select("jog-speed", [1, 2, 5, 10], state.percent, (value) => { state.percent = value; });
    const parts = { begin, end, phase: make("p", { role: "status", id: "jog-phase" }), axes: make("div", { className: "axes" }), teach: teachForm(), note: make("p", { className: "quiet" }) };
    state.parts = parts;
    main.append(
      make("div", { className: "row" }, begin, end, label("Step in mm or °", step), label("Speed, at most, in %", speed)),
      parts.phase,
      parts.axes,
      parts.note,
      parts.teach,
    );
    setText(parts.note, "Hold a button: the robot moves by steps until it is lifted, and the step under way ends. A lost connection, another window or tab, a second finger and HALT stop the robot; a stop during a step leaves the error 0x83500076, which is cleared on the screen Alarms. X to RZ are axes of the work coordinates.");
    this.tiles(page);
  },
  draw(content, page) {
    Object.assign(state, { page, content });
    endIfOver();
    this.tiles(page);
  },
  tiles(page) {
    state.page = page;
    const { parts, content } = state;
    if (!parts || !content) return;
    parts.begin.disabled = !page.mayMove || !page.hasControl || content.phase !== "off";
    parts.begin.title = page.mayMove ? (page.hasControl ? "" : "take the control first") : "start bcap web with --allow-motion";
    parts.end.disabled = !state.isOn;
    drawPhase(parts.phase, content, page);
    drawAxes(parts.axes, content, page.tile);
  },
  /** Answers a pulse. A hidden page does not. */
  pulse(number) {
    if (state.isOn && document.visibilityState === "visible") beat(number, state.held?.press ?? 0);
  },
  /** Ends the jog, because the page is left. */
  leave: drop,
};

function select(id, values, chosen, change) {
  const options = values.map((value) => make("option", { value, selected: value === chosen }, String(value)));
  return make("select", { id, onchange: (event) => change(Number(event.target.value)) }, ...options);
}

const label = (text, control) => make("label", { for: control.id, className: "check" }, text, control);

const PHASES = { off: "○ no jog", starting: "◐ the arm is taken, the motor goes on …", ready: "● ready: hold a button", moving: "▶ the robot moves", ending: "◐ the robot rests, the arm is given back …" };

function drawPhase(place, content, page) {
  const other = content.phase !== "off" && !state.isOn ? `, by ${page.tile.holder ?? "another page"}` : "";
  const last = content.phase === "off" && content.ends ? `. The last one ended: ${content.ends}; ${content.outcome ?? ""}` : "";
  const why = page.mayMove ? "" : ". This server moves nothing; start it with --allow-motion";
  setText(place, `${PHASES[content.phase]}${other}${last}${why}`);
  place.className = `state ${content.failed ? "bad" : { ready: "good", moving: "busy" }[content.phase] ?? ""}`;
}

function drawAxes(place, content, tile) {
  const names = content.axes.map(([name]) => name).join();
  if (place.dataset.names !== names) {
    place.dataset.names = names;
    if (state.held) drop("its button is gone");
    place.replaceChildren(...content.axes.map(([name]) => axisRow(name)));
  }
  const count = content.axes.length - 6;
  const valueOf = (n) => (n < count ? [tile.joints?.[n], tile.units?.[n]] : [tile.position?.[n - count], n < count + 3 ? "mm" : "°"]);
  content.axes.forEach(([name, percent], n) => {
    const row = place.children[n];
    const [value, unit] = valueOf(n);
    setText(row.children[2], withUnit(value, unit));
    setText(row.children[4], `${Math.min(percent, state.percent).toFixed(1)} %`);
    row.querySelectorAll("button").forEach((button) => {
      // an element that is disabled loses the pointer that holds it
      if (state.held?.button !== button) button.disabled = !state.isOn || !["ready", "moving"].includes(content.phase);
    });
  });
}

function axisRow(name) {
  const button = (sign) => {
    const element = make("button", { type: "button", className: "jog", "aria-label": `${name} ${sign < 0 ? "minus" : "plus"}` }, sign < 0 ? "−" : "+");
    element.onpointerdown = (event) => down(event, element, name, sign);
    element.onpointerup = (event) => up(event.pointerId);
    // a button that is lifted while another is down has no pointerup
    element.onpointermove = (event) => !(event.buttons & 1) && up(event.pointerId);
    element.onpointercancel = () => state.held && drop("the pointer was lost");
    element.onlostpointercapture = (event) => state.held?.by === event.pointerId && drop("the pointer was lost");
    element.oncontextmenu = (event) => event.preventDefault();
    element.onkeydown = (event) => keyDown(event, element, name, sign);
    element.onkeyup = (event) => up(event.code);
    element.onblur = () => state.held?.button === element && drop("the button has lost the focus");
    return element;
  };
  return make("div", { className: "axis" }, make("span", { className: "name" }, name), button(-1), make("span", { className: "value" }), button(1), make("span", { className: "quiet" }));
}

function down(event, button, axis, sign) {
  event.preventDefault();
  if (state.held || !event.isPrimary || event.button !== 0) {
    drop("a second pointer was used");
    return;
  }
  button.focus();
  button.setPointerCapture(event.pointerId);
  press(button, event.pointerId, axis, sign);
}

function keyDown(event, button, axis, sign) {
  if (event.code !== "Space" && event.code !== "Enter") return;
  event.preventDefault();
  if (event.repeat || state.held?.by === event.code) return;
  if (state.held) drop("a second key was used");
  else press(button, event.code, axis, sign);
}

function press(button, by, axis, sign) {
  presses += 1;
  const held = { button, by, press: presses };
  state.held = held;
  button.classList.add("held");
  order("press", { robot: state.page.robot, axis, by: sign * state.step, percent: state.percent, press: presses }).catch((error) => {
    // a later press may be held
    if (state.held === held) release();
    notifyFailure("not moved", error);
  });
}

function release() {
  state.held?.button.classList.remove("held");
  state.held = null;
}

function up(by) {
  if (state.held?.by !== by) return;
  release();
  if (!state.isOn) return;
  // a lost connection ends the jog by itself
  order("lift", { robot: state.page.robot }).then((steps) => notify(`${steps} whole steps`)).catch(() => {});
}

/** Ends the jog: the server halts the robot, and gives the arm back. */
function drop(why) {
  release();
  if (!state.isOn) return;
  state.isOn = false;
  // the page may show another robot by now
  order("endjog", { robot: state.robot, why }).catch(() => {});
}

function endIfOver() {
  const { content, isOn } = state;
  const isOver = content?.jog > state.jog || (content?.jog === state.jog && content.phase === "off");
  if (!isOn || !isOver) return;
  state.isOn = false;
  release();
  notify(`the jog has ended: ${content.ends ?? ""}; ${content.outcome ?? ""}`, content.failed);
}

async function start() {
  const { robot, tile } = state.page;
  const text = "The arm is taken, the motor goes on, and the robot moves while you hold a button. Keep the emergency stop within reach, and everyone out of the reach of the robot.";
  if (!(await ask("Begin to jog", tile, text, `Jog ${tile.name}`))) return;
  state.isLeft = false;
  try {
    const number = await order("grip", { robot, name: tile.name, revoked: tile.revoked });
    // the first pulse follows the answer; a short jog may end before it
    Object.assign(state, { isOn: true, robot, jog: number });
    endIfOver();
    if (document.hidden || state.isLeft || state.page.robot !== robot) drop("the page was left");
  } catch (error) {
    notifyFailure("no jog", error);
  }
}

function teachForm() {
  const name = make("input", { id: "teach-name", placeholder: "P5", size: 6 });
  const button = make("button", { type: "submit", id: "teach" }, "Teach");
  const onsubmit = (event) => {
    event.preventDefault();
    teach(name.value.trim());
  };
  return make("form", { className: "row", onsubmit }, label("Write the position to the variable", name), button);
}

/** Writes the position to a variable of type P, after the question. */
async function teach(name) {
  const { robot, tile } = state.page;
  try {
    if (!/^p\d+$/i.test(name)) throw new Error("write a variable of type P, such as P5");
    const checked = await order("teach", { robot, name });
    const text = `${checked.name}: ${checked.old} → ${checked.new} (tool ${tile.tool ?? "?"}, work ${tile.work ?? "?"})`;
    if (!(await ask("Teach a position", tile, text, `Write ${checked.name}`))) return;
    await order("write", { robot, check: checked.check, revoked: tile.revoked });
    notify(`${tile.name}: ${checked.name} is written`);
  } catch (error) {
    notifyFailure("not written", error);
  }
}

document.addEventListener("visibilitychange", () => document.hidden && drop("the tab was hidden"));
addEventListener("blur", () => {
  state.isLeft = true;
  drop("the window has lost the focus");
});
addEventListener("pagehide", () => drop("the page was left"));
// a second finger or button
addEventListener("pointerdown", (event) => {
  if (state.held && event.pointerId !== state.held.by && event.target !== byId("halt")) drop("a second pointer was used");
}, true);
