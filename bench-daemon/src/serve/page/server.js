// Speaking with the server: requests with the token, and the stream of events, which comes back by itself where it was cut off.
"use strict";

export const server = { token: sessionStorage.getItem("token") || "", lastId: "" };

export class Refused extends Error {
  constructor(status, problem) {
    super(problem.message || `status ${status}`);
    this.status = status;
    this.code = problem.code;
  }
}

export function useToken(token) {
  server.token = token;
  if (token) sessionStorage.setItem("token", token);
  else sessionStorage.removeItem("token");
}

function headers(more) {
  return server.token ? { Authorization: `Bearer ${server.token}`, ...more } : { ...more };
}

// A request that is not answered within this time is given up: a browser gives each host few connections, and one that hangs keeps the others out.
const PATIENCE_MS = 15000;
// A stop is tried again so soon: whoever asks again joins the stop under way.
const STOP_MS = 4000;

async function asked(method, path, body, patience = PATIENCE_MS) {
  const init = { method, headers: headers(body === undefined ? {} : { "Content-Type": "application/json" }), signal: AbortSignal.timeout(patience) };
  if (body !== undefined) init.body = JSON.stringify(body);
  const response = await fetch(`/api/v1${path}`, init);
  if (!response.ok) throw new Refused(response.status, await response.json().catch(() => ({})));
  return response;
}

export const get = async (path) => (await asked("GET", path)).json();
export const post = async (path, body) => (await asked("POST", path, body)).json();
export const stopNow = async (path) => (await asked("POST", path, undefined, STOP_MS)).json();
export const remove = async (path) => (await asked("DELETE", path)).json();
export const file = async (path) => (await asked("GET", path)).blob();

// Whoever hears nothing for so long is no longer connected, whatever the system says: the server speaks every 15 s.
const SILENCE_MS = 40000;

// Calls `on(kind, data)` for each event, and `link(state)` as the connection comes and goes. All tabs of a browser with the same token share one stream: the
// tab that holds the lock listens and passes on what it hears; when it is closed, the next one takes over. A tab that hears nothing of it any more, for a browser
// may freeze a tab that nobody looks at, listens for itself.
export async function listen(on, link) {
  if (!navigator.locks || !window.BroadcastChannel) return stream(on, link);
  const name = `events ${await digest(server.token)}`;
  const channel = new BroadcastChannel(name);
  let leads = false;
  let state = "down";
  let heard = Date.now();
  const linked = (now) => { state = now; link(now); };
  const alone = new AbortController();
  const watch = setInterval(() => {
    if (leads || Date.now() - heard < SILENCE_MS) return;
    linked("down");
    clearInterval(watch);
    channel.close();
    alone.abort();
  }, 5000);
  channel.onmessage = ({ data }) => {
    if (leads) {
      if (data.ask) channel.postMessage({ link: state });
      return;
    }
    heard = Date.now();
    if (data.link && data.link !== state) linked(data.link);
    if (data.kind) {
      if (data.id) server.lastId = data.id;
      on(data.kind, data.data);
    }
  };
  // Who comes later asks for what it has missed.
  channel.postMessage({ ask: true });
  on("hello", {});
  const lead = async () => {
    leads = true;
    clearInterval(watch);
    const pass = (kind, data) => {
      channel.postMessage({ kind, data, id: server.lastId });
      on(kind, data);
    };
    await stream(pass, (now) => { linked(now); channel.postMessage({ link: now }); }, () => channel.postMessage({ link: state }));
    channel.close();
  };
  try {
    return await navigator.locks.request(name, { signal: alone.signal }, lead);
  } catch (error) {
    if (!alone.signal.aborted) throw error;
    return stream(on, link);
  }
}

async function digest(secret) {
  const bytes = await crypto.subtle.digest("SHA-256", new TextEncoder().encode(secret));
  return Array.from(new Uint8Array(bytes).slice(0, 8), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

// Ends only when the token is refused; `beat()` comes with whatever the server says, its comments too.
async function stream(on, link, beat = () => {}) {
  for (let pause = 500; ; pause = Math.min(pause * 2, 8000)) {
    try {
      const more = { Accept: "text/event-stream" };
      if (server.lastId) more["Last-Event-ID"] = server.lastId;
      const response = await fetch("/api/v1/events", { headers: headers(more) });
      if (response.status === 401 || response.status === 403) return link("refused");
      if (!response.ok) throw new Error(`status ${response.status}`);
      link("up");
      pause = 250;
      await read(response.body.getReader(), on, beat);
    } catch {
      // Told below, and tried again.
    }
    link("down");
    await new Promise((done) => setTimeout(done, pause));
  }
}

async function read(reader, on, beat) {
  const decoder = new TextDecoder();
  let text = "";
  for (;;) {
    let timer;
    const silence = new Promise((_, fail) => { timer = setTimeout(() => fail(new Error("silence")), SILENCE_MS); });
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
  if (data) on(kind, JSON.parse(data));
}
