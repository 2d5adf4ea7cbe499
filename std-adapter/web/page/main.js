// The frame of the page: the robot, its state, HALT, the control, and the screens.

import { alarms } from "./alarms.js";
import { arm } from "./arm.js";
import { backup } from "./backup.js";
import { cell } from "./cell.js";
import { alertOf, askedOf, byId, kindOf, make, notify, setText, stateText } from "./dom.js";
import { jog } from "./jog.js";
import { login } from "./login.js";
import { beat, connect, halt, on, order } from "./net.js";
import { tasks } from "./tasks.js";
import { packets } from "./packets.js";
import { panel } from "./panel.js";
import { plots } from "./plots.js";
import { raw } from "./raw.js";
import { session } from "./session.js";
import { setLabels, variables } from "./variables.js";

const SCREENS = [cell, variables, alarms, arm, tasks, jog, plots, packets, raw, backup, session, panel];

/** What the screens share. */
const page = {
  tiles: [],
  robot: 0,
  mayWrite: false,
  mayMove: false,
  /** The tile of the robot, or one without content. */
  get tile() {
    return this.tiles[this.robot] ?? { name: "", address: "", level: "unknown", state: "connecting", words: [], reasons: [] };
  },
  /** Whether this page has the control. */
  get hasControl() {
    return this.tile.mine === true;
  },
  select(robot) {
    this.robot = robot;
    show(screen);
  },
  haltRobot,
};

let screen = SCREENS[0];

/** Whether the tiles of this connection are still to come: those of the last one may be of other robots. */
let isNew = true;

/** The number of the last press of HALT, and the last one that has failed of each robot. */
let presses = 0;
const failures = new Map();

async function haltRobot(robot) {
  const tile = page.tiles[robot];
  const name = tile?.name ?? "the robot";
  const subject = tile ? `HALT ${name} (${tile.address})` : "HALT";
  presses += 1;
  const press = presses;
  notify(`${name}: halting …`);
  const outcome = await halt(robot, tile?.name ?? "");
  if (outcome === null) return;
  const text = `${name}: ${outcome.text}`;
  notify(text, !outcome.ok);
  if (!outcome.ok) {
    failures.set(subject, Math.max(press, failures.get(subject) ?? 0));
    alertOf(subject, text);
  } else if (press > (failures.get(subject) ?? 0)) {
    // only a later halt of this robot
    alertOf(subject, null);
  }
}

function show(next) {
  if (screen === jog) jog.leave("the screen was left");
  screen = next;
  for (const button of byId("screens").children) {
    if (button.dataset.id === screen.id) button.setAttribute("aria-current", "page");
    else button.removeAttribute("aria-current");
  }
  document.title = `${page.tile.name} ${screen.title}`.trim();
  byId("main").replaceChildren();
  screen.open(byId("main"), page);
  order("show", { robot: page.robot, screen: screen.id }).catch(() => {});
  drawFrame();
}

function drawFrame() {
  const tile = page.tile;
  const kind = kindOf(tile);
  document.body.className = kind.name;
  const known = tile.virtual !== undefined && tile.virtual !== null;
  setText(byId("kind"), known ? kind.text : "controller unknown, treated as real");
  setText(byId("state"), stateText(tile));
  byId("state").className = `state ${tile.level}`;
  setText(byId("halt-robot"), tile.name);
  drawRobots();
  drawControl(tile);
}

function drawRobots() {
  const robots = byId("robots");
  if ([...robots.options].map((option) => option.text).join("\n") !== page.tiles.map((tile) => tile.name).join("\n")) {
    robots.replaceChildren(...page.tiles.map((tile) => make("option", { value: tile.robot }, tile.name)));
  }
  robots.value = String(page.robot);
}

function drawControl(tile) {
  const place = byId("control");
  const mayControl = page.mayWrite || page.mayMove;
  const key = `${mayControl} ${page.robot} ${page.hasControl} ${tile.holder}`;
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  if (!mayControl) {
    place.replaceChildren(make("span", { className: "quiet" }, "read-only"));
  } else if (page.hasControl) {
    place.replaceChildren(
      make("span", {}, `control: ${tile.holder ?? ""} (this page)`),
      make("button", { type: "button", id: "release", onclick: release }, "Release"),
    );
  } else if (tile.holder) {
    place.replaceChildren(make("span", {}, `control: ${tile.holder}`));
  } else {
    const name = make("input", { id: "name", value: localStorage.getItem("name") ?? "", maxLength: 40, "aria-label": "Your name", placeholder: "your name" });
    const take = make("button", { type: "submit", id: "take" }, "Take control");
    const form = make("form", { onsubmit: (event) => { event.preventDefault(); takeControl(name.value); } }, name, take);
    place.replaceChildren(form);
  }
}

async function takeControl(name) {
  try {
    await order("take", { robot: page.robot, name });
    localStorage.setItem("name", name);
    notify(`${page.tile.name}: this page has the control`);
  } catch (error) {
    notify(error.message, true);
  }
}

async function release() {
  await order("release", { robot: page.robot }).catch((error) => notify(error.message, true));
}

/** Finds the robot of the page among those of a new connection: the server may have started again with others. */
function follow(last) {
  const idOf = (tile) => `${tile.name} ${tile.address}`;
  if (last.length === 0 || last.map(idOf).join("\n") === page.tiles.map(idOf).join("\n")) return;
  const was = last[page.robot];
  const ways = [(tile) => idOf(tile) === idOf(was), (tile) => tile.name === was.name];
  const found = ways.map((is) => page.tiles.findIndex(is)).find((robot) => robot >= 0);
  page.robot = found ?? 0;
  // the question, and the state that screens keep by number, belong to the old robots
  byId("question").close("no");
  for (const known of SCREENS) known.forget?.();
  if (found === undefined) alertOf("Robot", `${was.name} is no longer a robot of bcap web: this page shows ${page.tile.name}`);
}

function stale(why) {
  const line = byId("stale");
  line.hidden = why === null;
  if (why !== null) setText(line, why);
  document.documentElement.classList.toggle("stale", why !== null);
}

function isTyping(event) {
  return event.target.closest?.("input, select, textarea") !== null;
}

/** Halts the robot of an open question, whose name its HALT has, or the robot of the page. */
const haltShown = () => haltRobot(askedOf() ?? page.robot);

// a dialog has its own HALT, because it makes the header inert
for (const id of ["halt", "question-halt"]) byId(id).onclick = haltShown;
byId("robots").onchange = (event) => page.select(Number(event.target.value));
document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "h" && !event.repeat && !event.ctrlKey && !event.altKey && !event.metaKey && !isTyping(event)) haltShown();
});
byId("screens").replaceChildren(
  ...SCREENS.map((known) => {
    const button = make("button", { type: "button", onclick: () => show(known) }, known.title);
    button.dataset.id = known.id;
    return button;
  }),
);

on("hello", (message) => {
  page.mayWrite = message.write;
  page.mayMove = message.motion;
  for (const button of byId("screens").children) button.hidden = SCREENS.find(({ id }) => id === button.dataset.id).isOffered?.(message) === false;
  setLabels(message.labels);
  isNew = true;
});
on("login", () => {
  stale("Log in to see values. HALT does not work before.");
  login(connect, () => haltRobot(page.robot));
});
on("closed", (why) => stale(`NOT CONNECTED to bcap web: ${why || "the values are old"}. HALT may not work. The page connects again every second.`));
on("stale", () => stale("bcap web does not answer: the values are old. HALT may not work."));
on("tick", () => isNew || stale(null));
on("pulse", (message) => (screen === raw ? beat(message.n, 0) : jog.pulse(message.n)));
on("replay", ({ v: [count, last] }) => {
  const lacks = count === 0 ? "" : ` The recording lacks ${count} requests, which are refused with E_FAIL; the last one is ${last}.`;
  byId("replay").hidden = false;
  setText(byId("replay"), `REPLAY of a recording: the values are recorded ones, and no robot is connected.${lacks}`);
});
on("refused", (message) => notify(message.error, true));
on("tiles", (message) => {
  const last = page.tiles;
  page.tiles = message.v;
  if (isNew) follow(last);
  arm.remember(page);
  drawFrame();
  if (isNew) {
    isNew = false;
    stale(null);
    show(screen);
  } else screen.tiles?.(page);
});
for (const known of SCREENS) on(known.section, (message) => known === screen && message.robot === page.robot && known.draw(message.v, page));

show(screen);
connect();
