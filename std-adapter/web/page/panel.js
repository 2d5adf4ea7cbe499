// The panel of the virtual controller of `bcap sim --web`: the emergency stop, the mode switch, errors, faults of the link, any
// scenario, and the time factor. A button plays a scenario; a scenario without faults keeps the faults of the previous one.

import { make, notify, setText } from "./dom.js";
import { order } from "./net.js";

const state = (line) => `[controller]\n${line}`;
const fault = (when, then) => `[[fault]]\nwhen = ${when}\nthen = ${then}`;

/** The buttons, by their headings. */
const BUTTONS = {
  "Emergency stop": [
    ["Press", state("emergency_stop = true")],
    ["Release", state("emergency_stop = false")],
  ],
  "Mode switch": [
    ["Auto", state('mode = "auto"')],
    ["Manual", state('mode = "manual"')],
    ["Teach check", state('mode = "teach_check"')],
  ],
  "Executable token": [
    ["Any client", state('token = "any"')],
    ["Teach pendant", state('token = "pendant"')],
  ],
  Errors: [
    ["Servo error 0x84204043", state('errors = ["0x84204043"]')],
    ["Battery low", state("battery_low = true")],
    ["Battery charged", state("battery_low = false")],
    ["Motor off", state("motor = false")],
  ],
  "Faults of calls": [
    ["Lose 1 answer in 20", fault("{ chance = 0.05 }", '"drop"')],
    ["Corrupt 1 answer in 20", fault("{ chance = 0.05 }", '"corrupt"')],
    ["Answer 300 ms late", fault("{ every = 1 }", "{ delay_ms = 300 }")],
    ["Lose the link for 5 s", fault("{ call = 1 }", "{ link_loss_ms = 5000 }")],
    ["Refuse motions", fault('{ every = 1, of = "Robot_Move" }', '{ refuse = "E_BUF_FULL" }')],
    ["No faults", ""],
  ],
};

const FACTORS = [0.1, 0.2, 0.5, 1, 2, 5, 10];
const view = { page: null, parts: null, content: null };

export const panel = {
  id: "panel",
  title: "Simulator",
  section: "panel",
  isOffered: (hello) => hello.panel,
  open(main, page) {
    const parts = {
      state: make("p", { role: "status", id: "panel-state" }),
      factor: make("select", { id: "factor" }, ...FACTORS.map((factor) => make("option", { value: factor }, `${factor}×`))),
      text: make("textarea", { id: "scenario", rows: 8, spellcheck: false, placeholder: '[[fault]]\nwhen = { call = 3, of = "slvMove" }\nthen = { refuse = "E_BUF_FULL" }' }),
      controls: [],
    };
    Object.assign(view, { page, parts, content: null });
    parts.factor.onchange = () => send("pace", { factor: Number(parts.factor.value) }, `time factor ${parts.factor.value}`);
    const button = (text, scenario) => {
      const element = make("button", { type: "button", onclick: () => send("play", { text: scenario() }, text) }, text);
      parts.controls.push(element);
      return element;
    };
    const group = ([title, buttons]) => make("fieldset", { className: "choices" }, make("legend", {}, title), ...buttons.map(([text, scenario]) => button(text, () => scenario)));
    const play = button("Play the scenario", () => parts.text.value);
    play.id = "play";
    parts.controls.push(parts.factor);
    main.append(
      parts.state,
      make("p", {}, make("label", { for: "factor" }, "Time factor of the virtual controller "), parts.factor),
      make("div", { className: "panel" }, ...Object.entries(BUTTONS).map(group)),
      make("p", {}, make("label", { for: "scenario" }, "A scenario, as a file of bcap sim --scenario has it; it replaces the faults of the last one")),
      parts.text,
      make("p", {}, play),
    );
    this.tiles(page);
  },
  draw(content, page) {
    Object.assign(view, { page, content });
    const { mode, motor, errors, factor, model } = content;
    const words = [`virtual ${model}`, `mode ${mode}`, `motor ${motor ? "on" : "off"}`, `${errors} errors`, `time ${factor}×`];
    if (content.emergency_stop) words.splice(1, 0, "EMERGENCY STOP PRESSED");
    setText(view.parts.state, words.join(" · "));
    if (document.activeElement !== view.parts.factor) view.parts.factor.value = String(factor);
  },
  tiles(page) {
    view.page = page;
    for (const control of view.parts?.controls ?? []) {
      control.disabled = !page.hasControl;
      control.title = page.hasControl ? "" : "take the control first";
    }
  },
};

async function send(what, fields, text) {
  try {
    await order(what, { robot: view.page.robot, ...fields });
    notify(`simulator: ${text}`);
  } catch (error) {
    notify(error.message, true);
  }
}
