// The screen of backups: a dump of the controller to a folder of the server, differences, and a restore with its plan.

import { ask, make, notify, setText } from "./dom.js";
import { order } from "./net.js";

const view = { page: null, parts: null, content: null, key: "" };

export const backup = {
  id: "backup",
  title: "Backup",
  section: "backup",
  open(main, page) {
    const parts = {
      name: make("input", { id: "backup-name", placeholder: "press-monday", maxLength: 64, spellcheck: false }),
      folders: make("select", { id: "backup-folder", "aria-label": "Backup" }),
      io: make("input", { type: "checkbox", id: "backup-io" }),
      state: make("p", { role: "status", id: "backup-state" }),
      meter: make("progress", { id: "backup-progress", max: 1, value: 0, hidden: true, "aria-label": "Progress" }),
      notes: make("ul", { className: "quiet" }),
      lines: make("ol", { className: "program", tabIndex: 0, id: "backup-lines", "aria-label": "Differences, or writes that are planned" }),
    };
    const button = (id, text, onclick) => (parts[id] = make("button", { type: "button", id: `backup-${id}`, onclick }, text));
    Object.assign(view, { page, parts, content: null, key: "" });
    main.append(
      make("form", { className: "row", onsubmit: (event) => { event.preventDefault(); begin({ work: "dump", folder: parts.name.value.trim() }); } },
        make("label", { for: "backup-name" }, "New backup "), parts.name, (parts.dump = make("button", { type: "submit", id: "backup-dump" }, "Dump"))),
      make("div", { className: "row" }, parts.folders,
        button("diff", "Compare with the controller", () => begin({ work: "diff", folder: parts.folders.value })),
        button("plan", "Plan a restore", () => begin({ work: "plan", folder: parts.folders.value, io: parts.io.checked })),
        make("label", { className: "check" }, parts.io, "with the I/O, which switches outputs")),
      parts.state, parts.meter,
      make("div", { className: "row" }, button("restore", "Restore …", restore), button("stop", "End", () => send("endwork", {}, "the work ends"))),
      parts.notes, parts.lines,
      make("p", { className: "quiet" }, "A dump only reads. A restore writes what differs: each value and file is checked before, recorded in the folder, and read back. An ended dump goes on under the same name; after an ended restore, plan it again: the rest is written."),
    );
    list();
    this.tiles(page);
  },
  draw(content, page) {
    Object.assign(view, { page, content });
    const { parts } = view;
    if (content === null) return;
    const where = content.count > 0 ? `, ${content.part} ${content.done}/${content.count}` : "";
    setText(parts.state, `${content.work} ${content.folder}: ${content.running ? `under way${where}` : content.outcome}`);
    parts.state.className = content.failed ? "state bad" : "";
    parts.meter.hidden = !content.running;
    Object.assign(parts.meter, { max: Math.max(1, content.count), value: content.done });
    const key = JSON.stringify([content.lines, content.left_out, content.notes]);
    if (key !== view.key) {
      view.key = key;
      const more = content.left_out > 0 ? [make("li", {}, `${content.left_out} more lines are left out`)] : [];
      parts.lines.replaceChildren(...content.lines.map((line) => make("li", {}, line)), ...more);
      parts.notes.replaceChildren(...content.notes.map((note) => make("li", {}, note)));
    }
    if (!content.running && content.outcome !== view.last) list();
    view.last = content.running ? null : content.outcome;
    this.tiles(page);
  },
  tiles(page) {
    view.page = page;
    const { parts, content } = view;
    if (!parts) return;
    const isBusy = content?.running === true;
    const hasFolder = parts.folders.options.length > 0;
    parts.dump.disabled = isBusy;
    parts.diff.disabled = isBusy || !hasFolder;
    parts.plan.disabled = isBusy || !hasFolder;
    parts.restore.disabled = isBusy || !content?.can_restore || !page.mayWrite || !page.hasControl;
    parts.restore.title = page.mayWrite ? (page.hasControl ? "plan a restore first" : "take the control first") : "start bcap web with --allow-write";
    parts.stop.disabled = !isBusy;
  },
};

async function list() {
  try {
    const rows = await order("backups", {});
    const { folders } = view.parts;
    const chosen = folders.value;
    folders.replaceChildren(...rows.map(([name, past]) => make("option", { value: name }, past ? `${name} (${past})` : name)));
    if (rows.some(([name]) => name === chosen)) folders.value = chosen;
    backup.tiles(view.page);
  } catch (error) {
    setText(view.parts.state, error.message);
  }
}

const begin = (work) => send("work", { work }, `${work.work} ${work.folder}`);

async function send(what, fields, text) {
  const { robot, tile } = view.page;
  try {
    await order(what, { robot, ...fields });
    notify(`${tile.name}: ${text}`);
  } catch (error) {
    notify(error.message, true);
  }
}

/** Writes the plan, after a question that names the robot. */
async function restore() {
  const { content, page } = view;
  const { robot, tile } = page;
  const text = `${content.outcome}. ${content.folder} is written to the controller. Tasks and robot must stay at rest meanwhile.`;
  if (!(await ask("Restore a backup", tile, text, `Restore to ${tile.name}`))) return notify("nothing was written");
  await send("restore", { robot, name: tile.name, folder: content.folder, revoked: tile.revoked }, `restoring ${content.folder}`);
  return undefined;
}
