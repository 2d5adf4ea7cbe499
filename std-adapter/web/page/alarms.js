// The screen of alarms: the first cause first, with meaning and remedy; the steps of a recovery; the messages.

import { ask, make, notify, notifyFailure } from "./dom.js";
import { order } from "./net.js";

/** The steps of a recovery, in words. */
const STEPS = {
  ManualResetPreparation: "ManualResetPreparation: a COBOTTA prepares a reset",
  ClearError: "ClearError: the errors are cleared",
  TakeArm: "TakeArm: this client takes the arm",
  ManualReset: "ManualReset: the safe torque off is reset",
  MotionPreparation: "MotionPreparation: a COBOTTA prepares its motion, and CAN MOVE",
  Motor: "Motor: the motor goes on",
};

let place = null;
let current = null;
let drawn = "";
let log = {};

export const alarms = {
  id: "alarms",
  title: "Alarms",
  section: "alarms",
  open(main, page) {
    current = page;
    drawn = "";
    if (log.robot !== page.robot) log = {};
    place = make("div", { className: "alarms" }, ...Object.keys(SECTIONS).map((id) => make("div", { className: id })));
    place.firstChild.append(make("p", { className: "quiet" }, "reading …"));
    main.append(place);
    drawLog();
  },
  draw(content, page) {
    current = page;
    drawn = content;
    // a button that has not changed stays, so that a press of it is not lost
    for (const part of place.children) {
      const [draw, of] = SECTIONS[part.className];
      const key = JSON.stringify(of.map((name) => content[name]));
      if (!draw || part.dataset.key === key) continue;
      part.dataset.key = key;
      part.replaceChildren(draw(content));
    }
    this.tiles();
  },
  forget() {
    log = {};
  },
  tiles() {
    if (!place || drawn === "") return;
    const title = current.hasControl ? "" : "take the control first";
    for (const button of place.querySelectorAll("#clear, .recover")) {
      const isClear = button.id === "clear";
      button.hidden = isClear ? !current.mayWrite : !current.mayMove;
      button.disabled = !current.hasControl || (isClear && drawn.errors.length === 0 && !drawn.skipped);
      button.title = title;
    }
  },
};

function errors(content) {
  const count = content.errors.length;
  const titles = ["No errors", "1 error", `${count} errors, the first cause first`];
  const title = content.skipped ? "The errors are not known" : titles[Math.min(count, 2)];
  const section = make("section", {}, make("h2", {}, title));
  if (content.skipped) section.append(make("p", { className: "quiet" }, content.skipped));
  section.append(make("ol", { className: "errors" }, ...content.errors.map(error)));
  return section;
}

function error(content, n) {
  const name = content.name ? ` ${content.name}` : "";
  const title = make("h3", {}, `▲ ${content.code}${name}`);
  if (n === 0) title.append(" ", make("span", { className: "first" }, "first cause"));
  const parts = [["", content.text === content.meaning ? "" : content.text], ["Meaning", content.meaning], ["Cause", content.cause], ["Remedy", content.remedy]];
  const lines = parts.filter(([, text]) => text).map(([label, text]) => make("p", {}, ...(label ? [make("strong", {}, `${label}: `)] : []), text));
  return make("li", {}, title, ...lines);
}

function recovery(content) {
  const section = make("section", {}, make("h2", {}, "Recovery"));
  const run = content.recovery;
  if (run?.outcome) section.append(make("p", { className: run.failed ? "state bad" : "state good" }, `The last recovery: ${run.outcome}`));
  if (run && !run.outcome) {
    section.append(...stepByStep(run));
    return section;
  }
  if (content.obstacles.length > 0) {
    section.append(make("p", {}, "First, a person or another program must do this:"), make("ul", {}, ...content.obstacles.map((text) => make("li", {}, text))));
  }
  if (content.steps.length > 0) {
    section.append(
      make("p", {}, `${content.obstacles.length > 0 ? "Then the" : "The"} steps of this model and this state, in this order:`),
      make("ol", {}, ...content.steps.map((step) => make("li", {}, STEPS[step] ?? step))),
    );
  }
  if (!content.known) section.append(make("p", {}, "The state of the robot is not known, so the steps are not known."));
  if (content.steps.length > 0 || !content.known) {
    section.append(
      make("p", { className: "quiet" }, "Clearing starts nothing. A recovery makes one step for each press of a button; in the end the motor is as before, and the arm is free."),
      make("div", { className: "row" },
        make("button", { type: "button", id: "clear", onclick: clear }, "Clear the errors"),
        make("button", { type: "button", id: "recover", className: "recover", onclick: begin }, "Recover step by step")),
    );
  } else if (content.obstacles.length === 0) {
    section.append(make("p", {}, "Nothing to recover."));
  }
  return section;
}

/** The steps of a recovery under way: what was made, and a button for the next one alone. */
function stepByStep(run) {
  const made = new Map(run.done);
  const item = (step) => {
    const text = STEPS[step] ?? step;
    if (made.has(step)) return make("li", {}, `✔ ${text}${made.get(step) ? `: ${made.get(step)}` : ""}`);
    if (step !== run.next) return make("li", { className: "quiet" }, text);
    const button = make("button", { type: "button", className: "recover", onclick: () => makeStep(step, text) }, step);
    return make("li", {}, ...(run.busy ? ["… "] : [button, " "]), text);
  };
  const stop = make("button", { type: "button", id: "stop-recovery", className: "recover", onclick: () => order("endrecovery", { robot: current.robot }).catch((error) => notify(error.message, true)) }, "End the recovery");
  return [make("ol", { className: "steps" }, ...run.plan.map(item)), stop];
}

async function begin() {
  const { robot, tile } = current;
  const text = "Make sure that no person is near the robot, and that no other program uses it. The steps are planned now; each has its own button.";
  if (!(await ask("Recover step by step", tile, text, `Recover ${tile.name}`))) return;
  await order("recover", { robot, name: tile.name, revoked: tile.revoked }).catch((error) => notifyFailure("no recovery", error));
}

async function makeStep(step, text) {
  const { robot, tile } = current;
  if (!(await ask("A step of the recovery", tile, text, step))) return;
  await order("step", { robot, step, revoked: tile.revoked }).catch((error) => notifyFailure("not made", error));
}

/** The logs of the controller, which are read on request: each entry is a call. */
function history() {
  const rows = (log.rows ?? []).map((cells) => make("tr", {}, ...cells.map((cell) => make("td", {}, cell))));
  const head = make("thead", {}, make("tr", {}, ...["Time of the controller", "Log", "Client", "Entry", "Place"].map((name) => make("th", { scope: "col" }, name))));
  const table = log.rows ? [make("div", { className: "scroll" }, make("table", { className: "log" }, head, make("tbody", {}, ...rows)))] : [];
  return make("section", {}, make("h2", {}, "History"), make("button", { type: "button", id: "log", onclick: readLog }, "Read the controller's log"), ...table);
}

/** The sections in their order, and what they show; the last one is drawn on request. */
const SECTIONS = { present: [errors, ["errors", "skipped"]], plan: [recovery, ["recovery", "known", "obstacles", "steps"]], notices: [messages, ["messages"]], past: [null, []] };

function drawLog() {
  place.lastChild.replaceChildren(history());
}

async function readLog() {
  try {
    const { robot } = current;
    const rows = await order("log", { robot });
    // the page may show another robot by now
    if (robot !== current.robot) return;
    log = { robot, rows };
    drawLog();
  } catch (error) {
    notify(`the log is not read: ${error.message}`, true);
  }
}

async function clear() {
  const { robot, tile } = current;
  const text = "The errors are cleared. Nothing is started: the motor stays off, and programs do not run on.";
  if (!(await ask("Clear the errors", tile, text, "Clear the errors"))) return;
  try {
    await order("clear", { robot, revoked: tile.revoked });
    notify(`${tile.name}: the errors are cleared`);
  } catch (failure) {
    notifyFailure("not cleared", failure);
  }
}

function messages(content) {
  const rows = content.messages.map((text) => make("li", {}, text));
  const none = rows.length === 0 ? [make("p", { className: "quiet" }, "No messages since bcap web was started.")] : [];
  return make("section", {}, make("h2", {}, "Messages, latest first"), ...none, make("ul", { className: "messages" }, ...rows));
}
