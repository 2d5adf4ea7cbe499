// The screen of the session: what this server allows, its controllers, recordings, and the last actions of all users.

import { make, notify, setText } from "./dom.js";
import { logOut, order, save } from "./net.js";

const view = { parts: null, audit: "", runs: null };

export const session = {
  id: "session",
  title: "Session",
  section: "session",
  open(main) {
    const parts = {
      settings: make("dl", { className: "answer" }),
      logOut: make("button", { type: "button", id: "log-out", hidden: true, onclick: () => attempt(logOut) }, "Log out"),
      robots: make("ul"),
      record: make("button", { type: "button", id: "record", disabled: true, onclick: record }, "Start recording"),
      recording: make("ul", { id: "recording", role: "status" }),
      list: make("tbody", { id: "recordings" }),
      audit: make("ol", { className: "program", id: "audit", tabIndex: 0, "aria-label": "The last actions" }),
    };
    Object.assign(view, { parts, audit: "", runs: null });
    const heads = ["recording", "size", "length", ""].map((text) => make("th", { scope: "col" }, text));
    main.append(
      make("h2", {}, "What this server allows"), parts.settings, make("p", {}, parts.logOut),
      make("h2", {}, "Controllers"), parts.robots,
      make("h2", {}, "Recordings"), make("p", {}, parts.record), parts.recording,
      make("table", {}, make("thead", {}, make("tr", {}, ...heads)), parts.list),
      make("p", { className: "quiet" }, "A file has all packets of the server with one controller. bcap sim --replay FILE.pcapng --web shows it again; Wireshark and bcap decode read it."),
      make("h2", {}, "The last actions, latest first"), parts.audit,
    );
  },
  draw(content) {
    const { settings, robots, audit } = view.parts;
    const values = {
      "Variables, errors": content.write ? "may be changed, also by restores and calls that write" : "read-only, without --allow-write",
      Motions: content.motion ? "jog, tasks, recoveries, and any call that can move a robot" : "none, without --allow-motion",
      Users: content.login ? "log in over TLS" : "of this computer, with the token",
      Backups: content.backups ? "dump and restore" : "none, without --backups",
      Recordings: content.recordings ? "of all packets" : "none, without --recordings",
      Labels: `${content.labels} of the file of --labels`,
    };
    const texts = Object.entries(values);
    if (settings.children.length !== texts.length) settings.replaceChildren(...texts.map(([name]) => make("div", {}, make("dt", {}, name), make("dd"))));
    texts.forEach(([, text], n) => setText(settings.children[n].lastChild, text));
    view.parts.logOut.hidden = !content.login;
    if (robots.children.length !== content.robots.length) robots.replaceChildren(...content.robots.map(([name, address]) => make("li", {}, `${name}: ${address}`)));
    drawRecordings(content.recordings);
    const key = content.audit.join("\n");
    if (key === view.audit && audit.children.length > 0) return;
    view.audit = key;
    audit.replaceChildren(...content.audit.map((line) => make("li", {}, line)));
  },
};

const size = (bytes) => `${(bytes / 1e6).toFixed(1)} MB`;
const length = (seconds) => (seconds === null ? "" : `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`);

/** Shows the running recordings, and the list whenever they have changed. */
function drawRecordings(recordings) {
  const { record, recording } = view.parts;
  record.disabled = recordings === null;
  record.title = record.disabled ? "start bcap web with --recordings DIR" : "";
  const lines = (recordings ?? []).map(([robot, file, [runs, bytes, seconds, why]]) => {
    if (runs) return `● ${robot}: records ${file}, ${size(bytes)}, ${length(seconds)}`;
    return why === null ? `${robot}: ${file} is recorded` : `▲ ${robot}: the recording ${file} has ended: ${why}`;
  });
  const runs = (recordings ?? []).map(([, , [runs]]) => runs).join();
  setText(record, runs.includes("true") ? "End recording" : "Start recording");
  if (recording.children.length !== lines.length) recording.replaceChildren(...lines.map(() => make("li")));
  lines.forEach((line, n) => setText(recording.children[n], line));
  if (runs === view.runs) return;
  view.runs = runs;
  if (recordings !== null) list();
}

async function list() {
  await attempt(async () => {
    const rows = await order("recordings", {});
    view.parts.list.replaceChildren(...rows.map(([name, bytes, seconds]) => {
      const button = make("button", { type: "button", onclick: () => attempt(() => save(`/recordings/${name}`, name)) }, "Save");
      return make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, size(bytes)), make("td", {}, length(seconds)), make("td", {}, button));
    }));
  });
}

function record() {
  const starts = view.parts.record.textContent === "Start recording";
  attempt(async () => {
    await order("record", { starts });
    notify(starts ? "the recording has started" : "the recording has ended");
  });
}

async function attempt(work) {
  try {
    await work();
  } catch (error) {
    notify(error.message, true);
  }
}
