// Communication with the server: requests with the browser's session, whose cookie scripts cannot read, and the stream
// of events, which reconnects automatically.
"use strict";

const WORDS = {
  // Of a refusal without a message.
  status: (status) => `status ${status}`,
};

const server = { lastId: "" };

export class Refused extends Error {
  constructor(status, problem) {
    super(problem.message || WORDS.status(status));
    this.status = status;
    this.code = problem.code;
  }
}

// A page of elsewhere cannot send this header, so that it cannot act with the session.
const PROOF = { "X-Eis-Bench": "page" };

// A request that is not answered within this time is given up: a browser gives each host few
// connections, and one that hangs keeps the others out.
const PATIENCE_MS = 15000;
// Retry interval of a stop, ms: a repeated request joins the stop in progress.
const STOP_MS = 4000;

async function asked(method, path, body, patience = PATIENCE_MS) {
  const init = {
    method,
    headers: body === undefined ? PROOF : { "Content-Type": "application/json", ...PROOF },
    signal: AbortSignal.timeout(patience),
  };
  if (body !== undefined) init.body = JSON.stringify(body);
  const response = await fetch(`/api/v1${path}`, init);
  if (!response.ok) throw new Refused(response.status, await response.json().catch(() => ({})));
  return response;
}

// A successful request may have an empty reply.
const NO_CONTENT = 204;
const valueOf = (response) => (response.status === NO_CONTENT ? {} : response.json());

export const get = async (path) => valueOf(await asked("GET", path));
export const post = async (path, body) => valueOf(await asked("POST", path, body));
export const stopNow = async (path, body, patience = STOP_MS) => valueOf(await asked("POST", path, body, patience));
export const put = async (path, body) => valueOf(await asked("PUT", path, body));
export const remove = async (path) => valueOf(await asked("DELETE", path));
export const file = async (path) => (await asked("GET", path)).blob();

// A channel to the other tabs; null if the browser has none or denies it. STOP works without it.
function channelOf(name) {
  try {
    return new BroadcastChannel(name);
  } catch {
    return null;
  }
}

// All tabs of a browser share one session: the tab that begins or ends it notifies the others.
const session = channelOf("session");

// The token is sent once, to start a session.
export async function signIn(token) {
  await post("/session", { token });
  session?.postMessage({});
}

export async function signOut() {
  await asked("DELETE", "/session");
  session?.postMessage({});
}

// Calls `changed()` when another tab has started or ended the session.
export const onSession = (changed) => session?.addEventListener("message", changed);

// Silence after which the connection counts as lost, whatever the system reports: the server sends something every 15
// s.
const SILENCE_MS = 40000;
// Silence of the listening tab after which another tab takes its place: the listening tab reports its presence more
// often, connected or not.
const ABSENCE_MS = SILENCE_MS + 15000;
const BEAT_MS = 5000;

// Calls `on(kind, data)` for each event, and `link(state)` when the connection opens or closes. Events before
// `link("up")` are not delivered: request the state then. All tabs of a browser with the same session, which is that of
// `who`, share one stream. The tab that holds the lock listens and forwards what it receives, and reports its attempts
// while it receives nothing; when it is closed, the next tab takes over. If that tab falls silent, because a browser
// may freeze a background tab, another tab steals the lock. So there is never a second stream: a browser allows each
// host few connections, and the stop needs one.
export async function listen(who, on, link) {
  // Event numbers of an earlier session do not apply to this one.
  server.lastId = "";
  const name = `events of ${who}`;
  const channel = navigator.locks ? channelOf(name) : null;
  if (!channel) return stream(on, link);
  const tab = {
    on,
    link,
    channel,
    leads: false,
    state: "down",
    heard: Date.now(),
    over: new AbortController(),
  };
  tab.channel.onmessage = ({ data }) => hear(tab, data);
  let steal = false;
  while (!tab.over.signal.aborted) steal = await turn(tab, name, steal);
  tab.channel.close();
}

function linked(tab, state) {
  tab.state = state;
  tab.link(state);
  // Without a valid token no events arrive; a new login listens again.
  if (state === "refused") tab.over.abort();
}

// Handles a message of another tab.
function hear(tab, data) {
  if (tab.leads) {
    if (data.ask) tab.channel.postMessage({ link: tab.state });
    return;
  }
  if (data.ask) return;
  tab.heard = Date.now();
  if (data.link && data.link !== tab.state) linked(tab, data.link);
  if (data.kind) {
    if (data.id) server.lastId = data.id;
    tab.on(data.kind, data.data);
  }
}

// Waits for the lock, or steals it, and listens for all tabs until it is stolen from this tab. Returns whether to steal
// it in the next turn.
async function turn(tab, name, steal) {
  // The listening tab reports whether it is connected.
  tab.channel.postMessage({ ask: true });
  const waits = new AbortController();
  const robbed = new AbortController();
  const over = () => waits.abort();
  tab.over.signal.addEventListener("abort", over);
  // Tabs check at different times: the first to steal the lock notifies the others.
  const watch = setInterval(
    () => {
      if (tab.leads || Date.now() - tab.heard < ABSENCE_MS) return;
      linked(tab, "down");
      waits.abort();
    },
    BEAT_MS * (0.5 + Math.random()),
  );
  try {
    await navigator.locks.request(name, steal ? { steal } : { signal: waits.signal }, () => lead(tab, robbed.signal));
    return false;
  } catch (error) {
    if (error.name !== "AbortError") throw error;
    // Events that the new lock holder received did not reach this tab.
    if (!waits.signal.aborted) linked(tab, "down");
    return waits.signal.aborted;
  } finally {
    clearInterval(watch);
    tab.over.signal.removeEventListener("abort", over);
    robbed.abort();
    tab.leads = false;
    tab.heard = Date.now();
  }
}

// Listens for all tabs.
async function lead(tab, robbed) {
  tab.leads = true;
  const pass = (kind, data) => {
    tab.channel.postMessage({ kind, data, id: server.lastId });
    tab.on(kind, data);
  };
  const beat = () => tab.channel.postMessage({ link: tab.state });
  const link = (state) => {
    linked(tab, state);
    beat();
  };
  // While connected, received data shows that the connection is alive: a timer would continue without it.
  const tries = setInterval(() => {
    if (tab.state === "down") beat();
  }, BEAT_MS);
  try {
    beat();
    await stream(pass, link, beat, robbed);
  } finally {
    clearInterval(tries);
  }
}

// Ends when the token is refused, or with the signal `ends`; `beat()` is called for all received data, including
// comments. A server that does not reply at all is abandoned and requested again, like any other request.
async function stream(on, link, beat = () => {}, ends = new AbortController().signal) {
  for (let pause = 500; !ends.aborted; pause = Math.min(pause * 2, 8000)) {
    const request = new AbortController();
    ends.addEventListener("abort", () => request.abort(), { signal: request.signal });
    const patience = setTimeout(() => request.abort(), PATIENCE_MS);
    try {
      const more = { Accept: "text/event-stream" };
      if (server.lastId) more["Last-Event-ID"] = server.lastId;
      const response = await fetch("/api/v1/events", { headers: more, signal: request.signal });
      clearTimeout(patience);
      if (response.status === 401 || response.status === 403) return link("refused");
      if (!response.ok) throw new Error(`status ${response.status}`);
      link("up");
      pause = 250;
      await read(response.body.getReader(), on, beat);
    } catch {
      // Reported below, and tried again.
    } finally {
      clearTimeout(patience);
      request.abort();
    }
    if (ends.aborted) return undefined;
    link("down");
    await new Promise((done) => setTimeout(done, pause));
  }
  return undefined;
}

async function read(reader, on, beat) {
  const decoder = new TextDecoder();
  let text = "";
  for (;;) {
    let timer;
    const silence = new Promise((_, fail) => {
      timer = setTimeout(() => fail(new Error("silence")), SILENCE_MS);
    });
    let part;
    try {
      part = await Promise.race([reader.read(), silence]);
    } catch (error) {
      reader.cancel().catch(() => {});
      throw error;
    } finally {
      clearTimeout(timer);
    }
    if (part.done) return;
    beat();
    text += decoder.decode(part.value, { stream: true });
    const blocks = text.split("\n\n");
    text = blocks.pop();
    blocks.forEach((block) => dispatch(block, on));
  }
}

function dispatch(block, on) {
  let kind = "message";
  let data = "";
  for (const line of block.split("\n")) {
    if (line.startsWith("id: ")) server.lastId = line.slice(4);
    else if (line.startsWith("event: ")) kind = line.slice(7);
    else if (line.startsWith("data: ")) data += line.slice(6);
  }
  // The server's greeting says no more than the connection itself.
  if (data && kind !== "hello") on(kind, JSON.parse(data));
}
