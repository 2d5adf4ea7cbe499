// A packet: its fields and its bytes. A marked field has its bytes marked, and the reverse.

import { make } from "./dom.js";

/** Returns the elements of a packet with its title. */
export function packetView(packet, title) {
  const bytes = packet.bytes.split(" ").filter((byte) => byte !== "");
  const cells = bytes.map((byte) => make("span", { className: "byte" }, byte));
  const fields = packet.fields.map(([at, length, text]) => make("button", { type: "button", className: "field", "aria-pressed": "false" }, make("span", { className: "quiet" }, `${at}`), make("span", {}, text), make("span", { className: "quiet" }, length === 1 ? "1 byte" : `${length} bytes`)));
  const dump = make("div", { className: "dump", tabIndex: 0, role: "group", "aria-label": `Bytes of the ${title}; arrow keys mark the next field` }, ...cells);
  let marked = -1;
  const mark = (n) => {
    marked = n;
    const [at, length] = packet.fields[n] ?? [0, 0];
    cells.forEach((cell, k) => cell.classList.toggle("marked", k >= at && k < at + length));
    fields.forEach((field, k) => field.setAttribute("aria-pressed", String(k === n)));
    fields[n]?.scrollIntoView({ block: "nearest" });
    cells[at]?.scrollIntoView({ block: "nearest" });
  };
  fields.forEach((field, n) => { field.onclick = () => mark(n); });
  dump.onclick = (event) => {
    const at = cells.indexOf(event.target);
    if (at >= 0) mark(packet.fields.findIndex(([from, length]) => at >= from && at < from + length));
  };
  dump.onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    mark(Math.max(0, Math.min(packet.fields.length - 1, marked + step)));
  };
  const left = packet.size - bytes.length;
  const note = left > 0 ? [make("p", { className: "quiet" }, `${left} more bytes are not shown`)] : [];
  return make("section", { className: "packet" }, make("h3", {}, `${title}, ${packet.size} bytes`), make("div", { className: "halves" }, make("div", { className: "fields" }, ...fields), dump), ...note);
}

/** Returns the elements of the packets of a call. */
export function callView(packets) {
  return packets.map((packet) => packetView(packet, packet.request ? "Request" : "Reply"));
}
