// The password of a server that other computers can reach.

import { drawAlerts, make } from "./dom.js";
import { logIn } from "./net.js";

let dialog = null;

/** Asks for the password, and calls `done` after the login. Its HALT says that it needs the login. */
export function login(done, halt) {
  if (dialog?.open) return;
  const password = make("input", { type: "password", id: "password", autocomplete: "current-password", required: true, autofocus: true });
  const why = make("p", { role: "alert", id: "login-why", className: "notice" });
  let isBusy = false;
  const onsubmit = async (event) => {
    event.preventDefault();
    if (isBusy) return;
    isBusy = true;
    why.textContent = (await logIn(password.value)) ?? "";
    password.value = "";
    isBusy = false;
    if (why.textContent !== "") return;
    dialog.close();
    dialog.remove();
    done();
  };
  const form = make("form", { onsubmit }, make("label", { for: "password" }, "Password"), password, make("button", { type: "submit", id: "log-in", className: "primary" }, "Log in"));
  const button = make("button", { type: "button", id: "login-halt", className: "halt", onclick: halt }, "HALT");
  dialog = make("dialog", { "aria-labelledby": "login-title" }, button, make("ul", { className: "alerts", role: "alert" }), make("h2", { id: "login-title" }, `Log in to ${location.host}`), form, why);
  // without the password the page has no content
  dialog.addEventListener("cancel", (event) => event.preventDefault());
  document.body.append(dialog);
  dialog.showModal();
  drawAlerts();
}
