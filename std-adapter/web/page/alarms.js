// The screen of alarms: the first cause first, with meaning and remedy; the steps of a recovery; the messages.

import { ask, make, notify } from "./dom.js";
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

export const alarms = {
  id: "alarms",
  title: "Alarms",
  section: "alarms",
  open(main, page) {
    current = page;
    drawn = "";
    place = make("div", { className: "alarms" }, make("p", { className: "quiet" }, "reading …"));
    main.append(place);
  },
  draw(content, page) {
    current = page;
    drawn = content;
    place.replaceChildren(errors(content), recovery(content), messages(content));
    this.tiles();
  },
  tiles() {
    const button = place?.querySelector("#clear");
    if (!button || drawn === "") return;
    button.hidden = !current.mayWrite;
    button.disabled = !current.hasControl || drawn.errors.length === 0;
    button.title = current.hasControl ? "" : "take the control first";
  },
};

function errors(content) {
  const count = content.errors.length;
  const titles = ["No errors", "1 error", `${count} errors, the first cause first`];
  const section = make("section", {}, make("h2", {}, titles[Math.min(count, 2)]));
  if (content.skipped) section.append(make("p", { className: "quiet" }, `not read: ${content.skipped}`));
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
  if (content.obstacles.length > 0) {
    section.append(make("p", {}, "First, a person or another program must do this:"), make("ul", {}, ...content.obstacles.map((text) => make("li", {}, text))));
  }
  if (content.steps.length > 0) {
    section.append(
      make("p", {}, `${content.obstacles.length > 0 ? "Then the" : "The"} steps of this model and this state, in this order:`),
      make("ol", {}, ...content.steps.map((step) => make("li", {}, STEPS[step] ?? step))),
      make("p", { className: "quiet" }, "This page clears errors. `bcap recover` makes the other steps, which can switch the motor on."),
      make("button", { type: "button", id: "clear", onclick: clear }, "Clear the errors"),
    );
  } else if (content.obstacles.length === 0) {
    section.append(make("p", {}, "Nothing to recover."));
  }
  return section;
}

async function clear() {
  const { robot, tile } = current;
  const text = "The errors are cleared. Nothing is started: the motor stays off, and programs do not run on.";
  if (!(await ask("Clear the errors", tile, text, "Clear the errors"))) return;
  try {
    await order("clear", { robot });
    notify(`${tile.name}: the errors are cleared`);
  } catch (failure) {
    notify(`not cleared: ${failure.message}`, true);
  }
}

function messages(content) {
  const rows = content.messages.map((text) => make("li", {}, text));
  const none = rows.length === 0 ? [make("p", { className: "quiet" }, "No messages since the page was started.")] : [];
  return make("section", {}, make("h2", {}, "Messages, latest first"), ...none, make("ul", { className: "messages" }, ...rows));
}
