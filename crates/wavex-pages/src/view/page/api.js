// Requests to the server. All addresses are relative to the page, whose address holds the token.

/** An answer of the server that is an error; its message is for the user. */
export class ServerError extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

/** Dispatches `lost` when a request gets no answer, and `found` when the next one does. */
export const connection = new EventTarget();
let isLost = false;

function setLost(lost) {
  if (lost === isLost) return;
  isLost = lost;
  connection.dispatchEvent(new Event(lost ? "lost" : "found"));
}

/** Query of a request; a list gives its key once per element, null and undefined are left out. */
function query(params) {
  const pairs = new URLSearchParams();
  for (const [key, value] of Object.entries(params)) {
    for (const one of Array.isArray(value) ? value : [value]) {
      if (one !== null && one !== undefined && one !== "") pairs.append(key, one);
    }
  }
  const text = pairs.toString();
  return text ? `?${text}` : "";
}

/** Answer of a request; errors are `ServerError`. */
async function answer(name, params, signal) {
  let response;
  try {
    response = await fetch(name + query(params), { signal, cache: "no-store" });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    setLost(true);
    throw new ServerError("The server does not answer. Is `wavex view` still running?", 0);
  }
  setLost(false);
  if (response.ok) return response;
  let text = `${response.status} ${response.statusText}`;
  try {
    text = (await response.json()).error || text;
  } catch (error) {
    if (error.name === "AbortError") throw error;
    // The status says enough.
  }
  throw new ServerError(text, response.status);
}

/** Answer as an object. */
export async function getJson(name, params = {}, signal) {
  return (await answer(name, params, signal)).json();
}

/** Answer as text. */
export async function getText(name, params = {}, signal) {
  return (await answer(name, params, signal)).text();
}

/** Answer as bytes. */
export async function getBytes(name, params = {}, signal) {
  return (await answer(name, params, signal)).arrayBuffer();
}

/** Address of a picture. */
export function address(name, params) {
  return name + query(params);
}
