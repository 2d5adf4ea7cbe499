// The raw editor: any function as a form made from the function table, the reply with its meaning, the bytes of the last
// packets, a loop, packets in hexadecimal, and the last calls to use again.

import { callView } from "./bytes.js";
import { ask, make, notify, setText } from "./dom.js";
import { order } from "./net.js";

/** The types of a VARIANT (b-CAP specification for RC9, Table 6-3). */
const TYPES = [[0, "EMPTY"], [2, "I2"], [3, "I4"], [4, "R4"], [5, "R8"], [6, "CY"], [7, "DATE"], [8, "BSTR"], [11, "BOOL"], [17, "UI1"]];
const ARRAYS = [...TYPES.slice(1).map(([vt, name]) => [8192 + vt, `array of ${name}`]), [8204, "array of VARIANT: (TYPE,DATA),…"]];

/** The functions whose second argument is the name of a command. */
const EXECUTES = /^(Controller|Extension|File|Robot|Task)_Execute$/;

/** The calls that are kept, and the shortest interval of a loop in ms: a page may give 20 orders a second. */
const KEPT = 20;
const SHORTEST = 100;

const state = { page: null, table: null, chosen: null, fields: [], last: [], loop: null, parts: null };

export const raw = {
  id: "raw",
  title: "Raw calls",
  section: "raw",
  open(main, page) {
    state.page = page;
    state.loop = null;
    const names = make("datalist", { id: "function-names" });
    const search = make("input", { id: "function", "aria-label": "Function, by its name or number", spellcheck: false, placeholder: "function, such as Variable_GetValue or 101", onchange: () => choose(search.value) });
    search.setAttribute("list", "function-names");
    const times = make("input", { id: "times", type: "number", min: 1, max: 100000, value: 1, "aria-label": "How often" });
    const interval = make("input", { id: "interval", type: "number", min: SHORTEST, value: 500, "aria-label": "Interval in ms" });
    const parts = {
      names,
      search,
      times,
      interval,
      usage: make("h2", { id: "usage" }),
      effect: make("p", { id: "effect" }),
      help: make("ul", { className: "help" }),
      form: make("form", { className: "arguments", onsubmit: (event) => { event.preventDefault(); callForm(); } }),
      call: make("button", { type: "submit", id: "call", className: "primary" }, "Call"),
      stop: make("button", { type: "button", id: "stop-loop", disabled: true, onclick: () => { state.loop = null; } }, "Stop"),
      reply: make("section", { className: "reply", "aria-live": "polite" }),
      packet: make("textarea", { id: "packet", rows: 3, spellcheck: false, "aria-label": "Packets in hexadecimal, one a line" }),
      last: make("ol", { className: "last" }),
    };
    state.parts = parts;
    const send = make("button", { type: "button", id: "send", onclick: sendPackets }, "Send packets");
    const details = make("details", {}, make("summary", {}, "Description and arguments"), parts.help);
    main.append(
      make("div", { className: "row" }, search, names),
      parts.usage,
      parts.effect,
      details,
      parts.form,
      make("div", { className: "row loop" }, make("label", {}, "times ", times), make("label", {}, "each ms ", interval), parts.stop),
      parts.reply,
      make("h2", {}, "Packets in hexadecimal"),
      parts.packet,
      make("div", { className: "row" }, send, make("span", { className: "quiet" }, "One a line, sent in order, as often as above; the reply of the last one is shown. The session sets the serial number.")),
      make("h2", {}, "Last calls, to use again"),
      parts.last,
    );
    drawLast();
    readTable();
  },
  draw() {},
  tiles() {
    if (state.chosen) drawEffect();
  },
};

async function readTable() {
  try {
    state.table ??= await order("functions", {});
    state.parts.names.replaceChildren(...state.table.map((row) => make("option", { value: row.name }, `${row.number}`)));
    choose(state.chosen?.name ?? "Variable_GetValue");
  } catch (error) {
    notify(error.message, true);
  }
}

function find(text) {
  const wanted = text.trim().toLowerCase().replaceAll("_", "");
  return state.table?.find((row) => String(row.number) === wanted || row.name.toLowerCase().replaceAll("_", "") === wanted);
}

/** Shows the form of a function, with values if there are any. */
function choose(text, values = []) {
  const row = find(text);
  if (!row) {
    notify(`there is no function ${text}; write a name, or a number from 1 to 137`, true);
    return;
  }
  notify("");
  const { parts } = state;
  state.chosen = row;
  parts.search.value = row.name;
  setText(parts.usage, `${row.number} ${row.name}(${row.arguments.map(([name]) => name).join(", ")})`);
  parts.help.replaceChildren(...row.help.filter((line) => line !== "").map((line) => make("li", {}, line.replace(/^\s*\* /, ""))));
  state.fields = row.arguments.map((argument, n) => field(row, argument, n, values[n]));
  parts.form.replaceChildren(...state.fields.map(({ element }) => element), parts.call);
  drawEffect();
}

/** Makes the field of an argument: `read` returns `TYPE,DATA` or the name of an object, `present` what `field` takes again. */
function field(row, [name, kind], n, value) {
  const id = `argument-${n}`;
  const label = make("label", { for: id }, `${name} `, make("span", { className: "quiet" }, kind));
  const input = make("input", { id, spellcheck: false, oninput: drawEffect });
  const listed = (values) => {
    const list = make("datalist", { id: `${id}-list` }, ...values.map(([text, note]) => make("option", { value: text }, note)));
    input.setAttribute("list", list.id);
    return list;
  };
  const made = (read, ...more) => ({ element: make("div", { className: "argument" }, label, ...more, input), input, read, present: () => input.value });
  if (kind === "VARIANT") {
    const type = make("select", { "aria-label": `Type of ${name}` }, ...[...TYPES, ...ARRAYS].map(([vt, text]) => make("option", { value: vt }, `${vt} ${text}`)));
    [type.value, input.value] = value ?? ["0", ""];
    type.onchange = () => { input.disabled = type.value === "0"; };
    type.onchange();
    return { ...made(() => `${type.value},${type.value === "0" ? "" : input.value}`, type), present: () => [type.value, input.value] };
  }
  const vt = { I4: 3, R4: 4, BSTR: 8 }[kind];
  if (vt) {
    input.value = value ?? (kind === "BSTR" ? "" : "0");
    const isCommand = n === 1 && EXECUTES.test(row.name);
    const list = isCommand ? [listed(row.commands)] : [];
    return { ...made(() => `${vt},${input.value}`, ...list), isCommand, isOption: n === 2 };
  }
  input.value = value ?? firstOf(kind);
  const list = listed(objects(kind).map((text) => [text, ""]));
  return made(() => (/^\d+$/.test(input.value.trim()) ? `3,${input.value.trim()}` : input.value.trim()), list);
}

/** The objects of a kind that this page knows by name. A handle of an earlier reply is a number. */
function objects(kind) {
  const tasks = (state.page.tile.tasks ?? []).map(([name]) => `task:${name}`);
  return { Controller: ["controller"], Robot: ["robot"], Task: tasks, Variable: ["variable:I1", "variable:IO128", "variable:P1", "robot/variable:@SERVO_ON", "variable:@MODE"], File: ["file:"], Extension: ["extension:Hand0"] }[kind] ?? [];
}

const firstOf = (kind) => objects(kind)[0] ?? "";

/** Returns whether a variable is one of the system's, or may be, as a handle may. */
const writesSystem = (name) => !/^\s*(robot|task|file|extension|variable|command)[/:]/i.test(name) || name.split(/[/:]/).at(-1).trim().startsWith("@");

/** Returns the effect of the call as it is filled in; the server decides by the same table. */
function effect() {
  const { chosen, fields } = state;
  const command = fields.find(({ isCommand }) => isCommand)?.input.value.trim().toLowerCase();
  if (command !== undefined) {
    const [, strength = "moves", stream = "unknown"] = chosen.commands.find(([name]) => name.toLowerCase() === command) ?? [];
    return [strength, stream];
  }
  if (chosen.name === "Variable_PutValue" && writesSystem(fields[0].input.value)) return ["moves", chosen.stream];
  const isRead = /_GetFile$/.test(chosen.name) && fields.find(({ isOption }) => isOption)?.input.value === "";
  return [isRead ? "session" : chosen.effect, chosen.stream];
}

const IN_WORDS = { session: "It opens or ends something for this page only.", reads: "It reads.", writes: "It writes.", moves: "It can move the robot, or stop it." };

function drawEffect() {
  const { page, parts } = state;
  const [strength, stream] = effect();
  const isRead = strength === "reads" || strength === "session";
  const right = strength === "writes" ? page.mayWrite : page.mayMove;
  const why = isRead ? "" : !right ? `Start bcap web with ${strength === "writes" ? "--allow-write" : "--allow-motion"}.` : page.hasControl ? "" : "Take the control first.";
  setText(parts.effect, `${IN_WORDS[strength]} ${stream === "allowed" ? "" : "It is not sent while another client streams in Slave Mode. "}${why}`);
  parts.effect.className = strength === "moves" ? "state busy" : "";
  parts.call.disabled = why !== "" || state.loop !== null;
}

/** Asks once for all calls of a loop. Resolves to whether they are made. */
function agree(strength, text, times) {
  if (strength === "reads" || strength === "session") return Promise.resolve(true);
  const often = times > 1 ? `, ${times} times` : "";
  const warning = strength === "moves" ? " The robot can move, at any speed that the controller allows. Make sure that no person is near it." : "";
  return ask("A raw call", state.page.tile, `${text}${often}.${warning}`, `Call ${text.split("(")[0]}`);
}

async function callForm() {
  const { chosen, page } = state;
  const [strength] = effect();
  const values = state.fields.map(({ read }) => read());
  const text = `${chosen.name}(${values.join("; ")})`;
  const times = wanted();
  const agreed = present();
  if (strength === "moves" && times > 1) {
    notify("a call that can move the robot is not repeated: set the times to 1", true);
    return;
  }
  if (!(await agree(strength, text, times))) {
    notify("nothing was done");
    return;
  }
  keep({ name: chosen.name, values: state.fields.map(({ present }) => present()), text });
  await repeat(times, (n) => order("call", { agreed: { ...agreed, repeats: n > 0 }, function: chosen.name, arguments: values }));
}

async function sendPackets() {
  const { page, parts } = state;
  const packets = parts.packet.value.split("\n").filter((line) => line.trim() !== "");
  if (packets.length === 0) {
    notify("write a packet in hexadecimal, such as 01 1e 00 …", true);
    return;
  }
  const times = wanted();
  const agreed = present();
  const text = packets.length === 1 ? "a packet" : `${packets.length} packets`;
  if (page.hasControl && !(await agree(page.mayMove ? "moves" : "writes", text, times))) {
    notify("nothing was done");
    return;
  }
  await repeat(times * packets.length, (n) => order("bytes", { agreed: { ...agreed, repeats: n >= packets.length }, packet: packets[n % packets.length] }));
}

/** Returns the robot of a question: after a HALT, or on another screen, the server refuses the calls of that question. */
function present() {
  const { robot, name, revoked } = state.page.tile;
  return { robot, name, revoked };
}

const wanted = () => Math.max(1, Math.min(100000, Math.trunc(Number(state.parts.times.value)) || 1));

/** Makes calls one after the other until one is refused, Stop is pressed, or the screen is left. */
async function repeat(times, make) {
  const { parts } = state;
  const { name } = state.page.tile;
  const loop = {};
  state.loop = loop;
  parts.stop.disabled = false;
  drawEffect();
  try {
    for (let n = 0; n < times; n += 1) {
      if (n > 0) await new Promise((resolve) => { setTimeout(resolve, Math.max(SHORTEST, Number(parts.interval.value) || 0)); });
      if (state.loop !== loop || !parts.reply.isConnected) break;
      const reply = await make(n);
      // the page may show another robot by now
      drawReply(parts, reply, times > 1 ? `${n + 1} of ${times}: ` : "");
      if (!reply.ok) break;
    }
    notify("");
  } catch (error) {
    notify(`${name}: ${error.message}`, true);
  } finally {
    if (state.loop === loop) state.loop = null;
    parts.stop.disabled = true;
    drawEffect();
  }
}

function drawReply(parts, reply, count) {
  const title = make("h2", { className: `state ${reply.ok ? "good" : "bad"}` }, `${count}${reply.ok ? "●" : "▲"} ${reply.code}${reply.name ? ` ${reply.name}` : ""}`);
  const lines = [["Value", reply.value], ["TYPE,DATA", reply.typed], ...(reply.ok ? [] : [["Meaning", reply.meaning], ["Cause", reply.cause], ["Remedy", reply.remedy]]), ["Took", `${reply.ms.toFixed(1)} ms`]];
  const rows = lines.filter(([, text]) => text !== null && text !== undefined).map(([name, text]) => make("div", {}, make("dt", {}, name), make("dd", {}, text)));
  parts.reply.replaceChildren(title, make("dl", { className: "answer" }, ...rows), ...callView(reply.packets));
}

function keep(call) {
  state.last = [call, ...state.last.filter(({ text }) => text !== call.text)].slice(0, KEPT);
  drawLast();
}

function drawLast() {
  const items = state.last.map((call) => make("li", {}, make("button", { type: "button", onclick: () => choose(call.name, call.values) }, call.text)));
  state.parts.last.replaceChildren(...items);
}
