// The screen of packets: the calls of this server with their replies, their fields and bytes, a filter, a stop at the first
// error, the calls by object, and a file for Wireshark.

import { callView } from "./bytes.js";
import { make, notify, setText } from "./dom.js";
import { order, save } from "./net.js";

/** The rows that are kept. */
const KEPT = 500;

const state = { page: null, rows: [], leftOut: 0, filter: "", isPaused: false, stopsAtError: false, byObject: false, parts: null };

export const packets = {
  id: "packets",
  title: "Packets",
  section: "packets",
  open(main, page) {
    const search = make("input", { type: "search", value: state.filter, placeholder: "filter, such as Variable_GetValue", "aria-label": "Show calls with", oninput: () => { state.filter = search.value.toLowerCase(); filterRows(); } });
    const pause = make("button", { type: "button", id: "pause", onclick: () => { state.isPaused = !state.isPaused; count(); } });
    const stop = make("input", { type: "checkbox", id: "stop", checked: state.stopsAtError, onchange: () => { state.stopsAtError = stop.checked; } });
    const objects = make("button", { type: "button", id: "objects", onclick: toggleObjects });
    const clear = make("button", { type: "button", onclick: clearRows }, "Clear");
    const file = make("button", { type: "button", id: "pcapng", onclick: savePackets }, "Save as pcapng");
    const parts = {
      pause,
      objects,
      count: make("p", { className: "quiet" }),
      body: make("tbody"),
      list: make("div", { className: "scroll list" }),
      detail: make("div", { className: "detail" }),
    };
    Object.assign(state, { page, parts, rows: [], leftOut: 0, isPaused: false, byObject: false });
    main.append(
      make("div", { className: "row" }, search, pause, objects, clear, file, make("label", { className: "check", for: "stop" }, stop, "stop at an error")),
      parts.count,
      parts.list,
      parts.detail,
    );
    showList();
  },
  draw(content) {
    if (state.isPaused) {
      state.leftOut += content.left_out + content.rows.length;
    } else {
      state.leftOut += content.left_out;
      for (const cells of content.rows) {
        addRow(cells);
        if (state.stopsAtError && isError(cells)) {
          state.isPaused = true;
          showCall(state.rows.at(-1));
          break;
        }
      }
    }
    count();
  },
};

/** A reply that begins with a code is a refusal. */
function isError([, , , reply]) {
  return /^0x[89a-f]|^no reply/i.test(reply);
}

function addRow(cells) {
  const [at, number, call, reply] = cells;
  const row = { cells, text: `${call} ${reply}`.toLowerCase(), serial: Number(number.replace("#", "")) };
  const open = make("button", { type: "button", className: "serial", "aria-label": `Bytes of call ${number}`, onclick: () => showCall(row) }, number);
  const texts = [isError(cells) ? `▲ ${reply}` : reply, call].map((text) => make("td", {}, text));
  row.element = make("tr", { className: isError(cells) ? "refused" : "", onclick: (event) => { if (event.target !== open) showCall(row); } }, make("td", {}, at.toFixed(2)), make("td", {}, open), ...texts);
  row.element.hidden = !row.text.includes(state.filter);
  state.rows.push(row);
  state.parts.body.prepend(row.element);
  if (state.rows.length > KEPT) {
    state.rows.shift().element.remove();
    state.leftOut += 1;
  }
}

function clearRows() {
  Object.assign(state, { rows: [], leftOut: 0 });
  state.parts.body.replaceChildren();
  state.parts.detail.replaceChildren();
  count();
}

function filterRows() {
  for (const row of state.rows) row.element.hidden = !row.text.includes(state.filter);
  count();
}

function count() {
  const { pause, objects, count: line } = state.parts;
  setText(pause, state.isPaused ? "Go on" : "Pause");
  setText(objects, state.byObject ? "By time" : "By object");
  const shown = state.rows.filter((row) => !row.element.hidden).length;
  const dropped = state.leftOut > 0 ? `; ${state.leftOut} are not kept` : "";
  setText(line, `${shown} of ${state.rows.length} calls, the latest first; one whose reply is the same as before is not listed${dropped}`);
}

const head = (names) => make("thead", {}, make("tr", {}, ...names.map((text) => make("th", { scope: "col" }, text))));

function showList() {
  const { list, body } = state.parts;
  list.replaceChildren(make("table", { className: "packets" }, head(["Time (s)", "Serial", "Reply", "Call"]), body));
  count();
}

/** Shows each function and object once, and reads them again each second. */
async function toggleObjects() {
  state.byObject = !state.byObject;
  if (!state.byObject) {
    showList();
    return;
  }
  const { parts } = state;
  const body = make("tbody", { className: "by-object" });
  parts.list.replaceChildren(make("table", { className: "packets" }, head(["Function and object", "Calls", "Per second", "Last (s ago)", "Last reply"]), body));
  count();
  while (state.byObject && body.isConnected) {
    const calls = await order("calls", { robot: state.page.robot }).catch(() => []);
    const rows = calls.filter(([name, , , , reply]) => `${name} ${reply}`.toLowerCase().includes(state.filter));
    body.replaceChildren(...rows.map(([name, times, rate, age, reply]) => make("tr", {}, ...[name, String(times), rate.toFixed(1), age.toFixed(1), reply].map((text) => make("td", {}, text)))));
    await new Promise((resolve) => { setTimeout(resolve, 1000); });
  }
}

/** Shows the fields and bytes of a call. */
async function showCall(row) {
  const { detail } = state.parts;
  try {
    const found = await order("packet", { robot: state.page.robot, serial: row.serial, at: row.cells[0] });
    for (const { element } of state.rows) element.classList.toggle("shown", element === row.element);
    const none = make("p", { className: "quiet" }, "The bytes of this call are not kept any more.");
    detail.replaceChildren(...(found.length > 0 ? callView(found) : [none]));
  } catch (error) {
    notify(error.message, true);
  }
}

async function savePackets() {
  await save(`/packets/${state.page.robot}`, "bcap.pcapng").catch((error) => notify(`not saved: ${error.message}`, true));
}
