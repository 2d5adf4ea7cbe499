// The screen of packets: the calls of this server with their replies, a filter, and a stop at the first error.

import { make, setText } from "./dom.js";

/** The rows that are kept. */
const KEPT = 500;

const state = { rows: [], leftOut: 0, filter: "", isPaused: false, stopsAtError: false, parts: null };

export const packets = {
  id: "packets",
  title: "Packets",
  section: "packets",
  open(main) {
    const search = make("input", { type: "search", value: state.filter, placeholder: "filter, such as Variable_GetValue", "aria-label": "Show calls with", oninput: () => { state.filter = search.value.toLowerCase(); draw(); } });
    const pause = make("button", { type: "button", id: "pause", onclick: () => { state.isPaused = !state.isPaused; draw(); } });
    const stop = make("input", { type: "checkbox", id: "stop", checked: state.stopsAtError, onchange: () => { state.stopsAtError = stop.checked; } });
    const clear = make("button", { type: "button", onclick: () => { Object.assign(state, { rows: [], leftOut: 0 }); draw(); } }, "Clear");
    const head = make("thead", {}, make("tr", {}, ...["Time (s)", "Serial", "Reply", "Call"].map((text) => make("th", { scope: "col" }, text))));
    const count = make("p", { className: "quiet" });
    const body = make("tbody");
    state.parts = { pause, count, body };
    Object.assign(state, { rows: [], leftOut: 0, isPaused: false });
    main.append(
      make("div", { className: "row" }, search, pause, clear, make("label", { className: "check", for: "stop" }, stop, "stop at an error")),
      count,
      make("div", { className: "scroll" }, make("table", { className: "packets" }, head, body)),
    );
    draw();
  },
  draw(content) {
    if (state.isPaused) {
      state.leftOut += content.left_out + content.rows.length;
    } else {
      state.leftOut += content.left_out;
      for (const row of content.rows) {
        state.rows.push(row);
        if (state.stopsAtError && isError(row)) {
          state.isPaused = true;
          break;
        }
      }
      state.leftOut += Math.max(0, state.rows.length - KEPT);
      state.rows = state.rows.slice(-KEPT);
    }
    draw();
  },
};

/** A reply that begins with a code is a refusal. */
function isError([, , , reply]) {
  return /^0x[89a-f]|^no reply/i.test(reply);
}

function draw() {
  const { pause, count, body } = state.parts;
  setText(pause, state.isPaused ? "Go on" : "Pause");
  const shown = state.rows.filter(([, , call, reply]) => `${call} ${reply}`.toLowerCase().includes(state.filter));
  const dropped = state.leftOut > 0 ? `; ${state.leftOut} are not kept` : "";
  setText(count, `${shown.length} of ${state.rows.length} calls, the latest first; one whose reply is the same as before is not listed${dropped}`);
  body.replaceChildren(
    ...shown.reverse().map((row) => {
      const [at, number, call, reply] = row;
      return make("tr", { className: isError(row) ? "refused" : "" }, ...[at.toFixed(2), number, isError(row) ? `▲ ${reply}` : reply, call].map((text) => make("td", {}, text)));
    }),
  );
}
