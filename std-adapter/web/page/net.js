// The connection to `bcap web`: live sections and orders with answers. HALT uses a separate connection.

const token = takeToken();
const handlers = new Map();
const pending = new Map();
/** The pending HALT requests of each robot, in the order of the presses. */
const halts = new Map();
let socket = null;
let lastId = 0;
let lastMessage = 0;
/** How often in a row the open connection was stale. */
let staleTicks = 0;
/** Why the server refuses this page. */
let refusal = "";
let isSaving = false;

/** Takes the token from the address of the page, and hides it there. A reload in this tab finds it again. */
function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token") ?? "";
}

/** Calls `handler` with each message of a kind. `open`, `closed` and `stale` are the states of the connection. */
export function on(kind, handler) {
  handlers.set(kind, handler);
}

function emit(kind, message) {
  handlers.get(kind)?.(message);
}

/** Opens the connection, and again whenever it is lost. */
export function connect() {
  let wasOpen = false;
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`, ["bcap.live", `token.${token}`]);
  socket.onopen = () => {
    wasOpen = true;
    refusal = "";
    lastMessage = Date.now();
    emit("open");
  };
  socket.onmessage = (event) => {
    lastMessage = Date.now();
    const message = JSON.parse(event.data);
    if (message.t === "answer") answered(message);
    else emit(message.t, message);
  };
  socket.onclose = () => {
    for (const { reject } of pending.values()) reject(new Error("the connection to bcap web is lost; it is unknown whether it was done"));
    pending.clear();
    emit("closed", refusal);
    if (wasOpen) setTimeout(connect, 1000);
    else openLater();
  };
}

/** Tries again, or asks for the password if the server needs one. The response to a refused WebSocket is hidden from scripts. */
async function openLater() {
  const response = await fetch("/session", { headers: { "x-bcap-token": token }, cache: "no-store" }).catch(() => null);
  if (response?.status === 401) {
    emit("login");
    return;
  }
  refusal = response?.ok === false ? await response.text().catch(() => "") : "";
  emit("closed", refusal);
  setTimeout(connect, 1000);
}

/** Logs in. Returns why not, or `null`. */
export async function logIn(password) {
  try {
    const response = await fetch("/login", { method: "POST", body: password, cache: "no-store" });
    return response.ok ? null : await response.text();
  } catch (error) {
    return `bcap web does not answer: ${error.message}`;
  }
}

/** Logs out: the server closes the pages of this session. */
export async function logOut() {
  const response = await fetch("/logout", { method: "POST", cache: "no-store" });
  if (!response.ok) throw new Error(await response.text());
  location.reload();
}

// the server sends something every second
const isStale = () => Date.now() - lastMessage > 3000;

setInterval(() => {
  staleTicks = socket?.readyState === WebSocket.OPEN && isStale() ? staleTicks + 1 : 0;
  if (staleTicks > 0) emit("stale");
  // after 10 s: the other end may be lost, which the browser may report late or never
  if (staleTicks > 20) abandon();
}, 500);

/** Closes a connection that hangs, and opens the next one. */
function abandon() {
  const { onclose } = socket;
  socket.onmessage = socket.onclose = null;
  socket.close();
  onclose();
}

function answered(message) {
  const waiting = pending.get(message.id);
  pending.delete(message.id);
  if (message.error !== undefined) {
    if (waiting) waiting.reject(new Error(message.error));
    else emit("refused", message);
  } else waiting?.resolve(message.ok);
}

/**
 * Sends an order, and returns its answer. An order that a HALT revokes has `revoked`, as the tile said before the question. It is
 * not sent over a connection that may hang: it would come late.
 */
export function order(what, fields) {
  return new Promise((resolve, reject) => {
    if (socket?.readyState !== WebSocket.OPEN) {
      reject(new Error("there is no connection to bcap web; nothing was done"));
      return;
    }
    if (isStale() && (fields.revoked ?? fields.agreed) !== undefined) {
      reject(new Error("bcap web has not answered for 3 s; nothing was done"));
      return;
    }
    lastId += 1;
    pending.set(lastId, { resolve, reject });
    socket.send(JSON.stringify({ id: lastId, do: what, ...fields }));
  });
}

/** Sends a heartbeat for a pulse, with the number of the press whose button is held. It has no answer. */
export function beat(number, held) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ beat: number, held }));
}

/** Gets a file from the server, and saves it. One at a time: others would take the connections that HALT needs. */
export async function save(path, name, body) {
  if (isSaving) throw new Error("another file is being saved; wait for its end");
  isSaving = true;
  try {
    const response = await fetch(path, { method: "POST", headers: { "x-bcap-token": token }, body, cache: "no-store" });
    if (!response.ok) throw new Error(await response.text());
    saveBlob(await response.blob(), name);
  } finally {
    isSaving = false;
  }
}

/** Saves a file. */
export function saveBlob(blob, name) {
  const href = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href, download: name }).click();
  URL.revokeObjectURL(href);
}

/**
 * Halts a robot, whose name decides if the server has other numbers now. It does not use the connection above, which may hang. Returns `null` if a later press has replaced the request.
 *
 * A browser opens six connections to a host, so a robot has two pending requests at most: the first and the last; and only the
 * first while four requests of all robots are pending. The server carries on with an aborted one. The first is never aborted: on a
 * slow network, quick presses would abort each before it arrives.
 */
export async function halt(robot, name) {
  const requests = halts.get(robot) ?? new Set();
  halts.set(robot, requests);
  const all = [...halts.values()];
  const isFull = all.reduce((sum, { size }) => sum + size, 0) >= 4;
  for (const replaced of (isFull ? all : [requests]).flatMap((of) => [...of].slice(1))) replaced.abort();
  const request = new AbortController();
  requests.add(request);
  try {
    const response = await fetch(`/halt/${robot}`, { method: "POST", headers: { "x-bcap-token": token }, body: name, cache: "no-store", signal: request.signal });
    if (!response.ok) return { ok: false, text: `NOT HALTED, use the emergency stop: ${await response.text()}` };
    return await response.json();
  } catch (error) {
    return request.signal.aborted ? null : { ok: false, text: `NOT HALTED, use the emergency stop: ${error.message}` };
  } finally {
    requests.delete(request);
  }
}
