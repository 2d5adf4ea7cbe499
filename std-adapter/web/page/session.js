// The screen of the session: what this server allows, its controllers, and the last actions of all users.

import { make, setText } from "./dom.js";

const view = { parts: null, audit: "" };

export const session = {
  id: "session",
  title: "Session",
  section: "session",
  open(main) {
    const parts = { settings: make("dl", { className: "numbers" }), robots: make("ul"), audit: make("ol", { className: "program", id: "audit", tabIndex: 0, "aria-label": "The last actions" }) };
    Object.assign(view, { parts, audit: "" });
    main.append(
      make("h2", {}, "What this server allows"), parts.settings,
      make("h2", {}, "Controllers"), parts.robots,
      make("h2", {}, "The last actions, latest first"), parts.audit,
      make("p", { className: "quiet" }, "To record the session, save the packets on the screen Packets. bcap sim --replay FILE.pcapng answers as the controller did."),
    );
  },
  draw(content) {
    const { settings, robots, audit } = view.parts;
    const values = {
      "Variables, errors": content.write ? "may be changed" : "read-only, without --allow-write",
      Motions: content.motion ? "by steps while a button is held" : "none, without --allow-motion",
      Users: content.login ? "log in over TLS" : "of this computer, with the token",
      Backups: content.backups ? "dump and restore" : "none, without --backups",
      Labels: `${content.labels} of the file of --labels`,
    };
    const texts = Object.entries(values);
    if (settings.children.length !== texts.length) settings.replaceChildren(...texts.map(([name]) => make("div", {}, make("dt", {}, name), make("dd"))));
    texts.forEach(([, text], n) => setText(settings.children[n].lastChild, text));
    if (robots.children.length !== content.robots.length) robots.replaceChildren(...content.robots.map(([name, address]) => make("li", {}, `${name}: ${address}`)));
    const key = content.audit.join("\n");
    if (key === view.audit && audit.children.length > 0) return;
    view.audit = key;
    audit.replaceChildren(...content.audit.map((line) => make("li", {}, line)));
  },
};
