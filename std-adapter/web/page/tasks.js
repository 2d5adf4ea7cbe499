// The screen of tasks and files: the states of the tasks, their lines, start and stop; and a view of a program.

import { ask, make, notify, notifyFailure, setText } from "./dom.js";
import { order } from "./net.js";

const START = { once: "Run once", step: "One step", forever: "Run again and again" };
const STOP = { stop: "Stop", cycle: "Stop after the cycle", reset: "Stop and reset" };

const state = { page: null, parts: null, rows: [], lines: new Map(), folder: "" };

export const tasks = {
  id: "tasks",
  title: "Tasks and files",
  section: "tasks",
  open(main, page) {
    const parts = {
      body: make("tbody"),
      chosen: make("select", { id: "task", "aria-label": "Task" }),
      actions: make("div", { className: "row" }),
      files: make("ul", { className: "files" }),
      title: make("h2", {}, "Files"),
      text: make("ol", { className: "program", tabIndex: 0, "aria-label": "Text of the file" }),
    };
    Object.assign(state, { page, parts, rows: [], lines: new Map(), folder: "" });
    const head = make("thead", {}, make("tr", {}, ...["Task", "State", "Line"].map((name) => make("th", { scope: "col" }, name))));
    const button = ([what, text]) => {
      const element = make("button", { type: "button", onclick: () => act(what, text) }, text);
      element.dataset.what = what;
      return element;
    };
    parts.actions.append(parts.chosen, ...[...Object.entries(START), ...Object.entries(STOP)].map(button));
    main.append(make("div", { className: "scroll" }, make("table", {}, head, parts.body)), parts.actions, parts.title, parts.files, parts.text);
    list("");
    readLines(parts);
    this.tiles(page);
  },
  draw(rows, page) {
    Object.assign(state, { page, rows });
    const { body, chosen } = state.parts;
    const names = rows.filter(([, , isPlain]) => isPlain).map(([name]) => name);
    if (names.join() !== [...chosen.options].map(({ value }) => value).join()) {
      const { value } = chosen;
      chosen.replaceChildren(...names.map((name) => make("option", { value: name }, name)));
      if (names.includes(value)) chosen.value = value;
    }
    for (const [name, status] of rows) if (!runs(status)) state.lines.delete(name);
    body.replaceChildren(...rows.map(([name, status]) => make("tr", { className: status === "running" ? "changed" : "" }, make("th", { scope: "row" }, name), make("td", {}, status), make("td", { className: "value" }, lineOf(name)))));
    this.tiles(page);
  },
  tiles(page) {
    for (const button of state.parts?.actions.querySelectorAll("button") ?? []) {
      const isAllowed = button.dataset.what in START ? page.mayMove : page.mayMove || page.mayWrite;
      button.disabled = !isAllowed || !page.hasControl || state.parts.chosen.options.length === 0;
      button.title = isAllowed ? (page.hasControl ? "" : "take the control first") : "start bcap web with --allow-motion";
    }
  },
};

const lineOf = (name) => String(state.lines.get(name) ?? "");
const pause = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });
const runs = (status) => status === "running" || status === "stopped at a step";

/**
 * Reads the lines of the running tasks about each second while the screen is open, one after the other: each is a call of the
 * controller. A line that is not read is not shown.
 */
async function readLines(parts) {
  const { robot } = state.page;
  while (parts.body.isConnected) {
    for (const [name, status, isPlain] of state.rows) {
      if (!isPlain || !runs(status)) continue;
      const line = await order("line", { robot, name }).catch(() => null);
      if (!parts.body.isConnected) return;
      // it may have ended by now
      const n = state.rows.findIndex(([of, now]) => of === name && runs(now));
      if (n < 0) continue;
      state.lines.set(name, line);
      setText(parts.body.children[n].lastChild, lineOf(name));
      // a page may give 20 orders a second
      await pause(100);
    }
    await pause(700);
  }
}

async function act(what, text) {
  const { robot, tile } = state.page;
  const name = state.parts.chosen.value;
  const warning = what in START ? " The program can move the robot." : "";
  if (!(await ask(text, tile, `${name}: ${text.toLowerCase()}.${warning}`, `${text}: ${name}`))) return;
  try {
    await order("task", { robot, of: tile.name, name, what, revoked: what in START ? tile.revoked : undefined });
    notify(`${tile.name}: ${name}: ${text.toLowerCase()} is done`);
  } catch (error) {
    notifyFailure("not done", error);
  }
}

async function list(folder) {
  const { robot } = state.page;
  const { files, title } = state.parts;
  try {
    const { rows, left_out: leftOut } = await order("files", { robot, folder });
    if (robot !== state.page.robot) return;
    state.folder = folder;
    setText(title, `Files of /${folder}`);
    const open = (name, isFolder) => () => (isFolder ? list(join(folder, name)) : view(join(folder, name)));
    const up = folder === "" ? [] : [make("li", {}, make("button", { type: "button", onclick: () => list(folder.split("/").slice(0, -1).join("/")) }, "up"))];
    const entries = rows.map(([name, isFolder, isPlain]) => make("li", {}, make("button", { type: "button", disabled: !isPlain, onclick: open(name, isFolder) }, isFolder ? `${name}/` : name)));
    files.replaceChildren(...up, ...entries, ...(leftOut > 0 ? [make("li", {}, `${leftOut} more are left out`)] : []));
  } catch (error) {
    setText(title, `Files: not read: ${error.message}`);
  }
}

const join = (folder, name) => (folder === "" ? name : `${folder}/${name}`);

async function view(path) {
  const { robot } = state.page;
  const { text, title } = state.parts;
  try {
    const { lines, left_out: leftOut } = await order("view", { robot, path });
    setText(title, `/${path}`);
    text.replaceChildren(...lines.map((line) => make("li", {}, line)), ...(leftOut > 0 ? [make("li", {}, `${leftOut} more lines are left out`)] : []));
  } catch (error) {
    notify(`/${path} is not read: ${error.message}`, true);
  }
}
