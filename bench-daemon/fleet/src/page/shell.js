// The frame of the page of the fleet: sign-in, messages, and the stop that is sent until it is answered.
"use strict";

import { $, el, text } from "./bench.js";
import { close, open, stopAll } from "./fleet.js";
import { Refused, get, onSession, post, remove, signIn, signOut, stopNow } from "./server.js";

const WORDS = {
  title: (what) => `${what} – eis-fleet`,
  refused: (why) => `Refused: ${why}`,
  notReached: (why) => `Not reached: ${why}`,
  close: "Close this message",
  link: {
    up: "● signed in",
    trying: "○ not reached, trying again",
    stopOnly: "● this token shows nothing; STOP FLEET works",
    nobody: "○ not signed in",
  },
  unknownToken: (why) => `This token is not known here: typed wrong, ended, or taken back (${why}).`,
  who: (name, scopes) => `${name}: ${scopes || "STOP only"}`,
  stopping: (tries) => (tries === 1 ? "■ STOPPING …" : `■ STOPPING, TRY ${tries} …`),
  stopSignIn: (why) =>
    `The stop was refused: sign in first (${why}). ` +
    "Without a token: the emergency switch, or on the machine of the bench: eis-bench safe",
  stopRefused: (why) =>
    `The stop was refused: ${why}. NOTHING WAS STOPPED, and it is not sent again. ` +
    "Use the emergency switch, or on the machine of the bench: eis-bench safe",
  stopUnheard: (waited, why) =>
    `No word after ${waited} s that the benches are off (${why}). The stop is sent again. ` +
    "Use the emergency switch, or on the machine of the bench: eis-bench safe",
  noAnswer: "no answer yet",
};

// Time between two attempts to reach the agent, ms.
const RETRY_MS = 1000;
// Interval at which a long wait for a stop is shown, ms.
const UNHEARD_MS = 4000;
// Pause before a stop that failed at once is sent again, ms.
const AGAIN_MS = 500;
// Time that a message stays, ms.
const SAID_MS = 10000;

const known = { who: "", scopes: [], benches: [] };

let silence = 0;

function say(words, bad) {
  clearTimeout(silence);
  if (words && !bad) silence = setTimeout(() => say(""), SAID_MS);
  $("said").hidden = !words;
  $("said").className = `banner ${bad ? "bad" : "note"}`;
  text($("said"), words || "");
}

const isUnknown = (error) => error instanceof Refused && (error.status === 401 || error.status === 403);

// Does something that may be refused, and shows the outcome.
async function attempt(work, done) {
  try {
    const result = await work();
    say(done ? done(result) : "");
    return result;
  } catch (error) {
    say(error instanceof Refused ? WORDS.refused(error.message) : WORDS.notReached(error.message), true);
    return null;
  }
}

// The message of a stop stays until the user closes it, or a stop has succeeded.
function stopSays(words, bad = true) {
  const banner = $("stopsaid");
  banner.hidden = !words;
  if (!words) return;
  banner.className = `banner ${bad ? "bad" : "fine"}`;
  const done = el("button", { type: "button", onclick: () => stopSays("") }, WORDS.close);
  banner.replaceChildren(el("strong", {}, words), " ", done);
}

// Sends a stop until it is answered, and returns the answer, or null if the stop was refused. A request that hangs is
// abandoned after `patience`, and sent again: repeated requests join the stop in progress. `waits(seconds)` returns the
// message during a long wait.
async function insistOnStop(button, path, { body, patience, waits }) {
  button.classList.add("pressed");
  const began = Date.now();
  const waited = () => Math.round((Date.now() - began) / 1000);
  const tick = setInterval(() => stopSays(waits(waited())), UNHEARD_MS);
  let answer;
  for (let tries = 1; answer === undefined; tries += 1) {
    text(button, WORDS.stopping(tries));
    try {
      answer = await stopNow(path, body, patience);
    } catch (error) {
      answer = stopIsRefused(error) ? null : undefined;
      const isLate = error.name === "TimeoutError";
      if (answer === undefined) stopSays(WORDS.stopUnheard(waited(), isLate ? WORDS.noAnswer : error.message));
      if (answer === undefined && !isLate) await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }
  clearInterval(tick);
  button.classList.remove("pressed");
  return answer;
}

// Returns whether a stop is refused permanently, and shows the reason.
function stopIsRefused(error) {
  const isRefused = error instanceof Refused && error.status < 500 && error.status !== 429;
  if (isUnknown(error)) stopSays(WORDS.stopSignIn(error.message));
  else if (isRefused) stopSays(WORDS.stopRefused(error.message));
  return isRefused;
}

const context = {
  get,
  post,
  remove,
  attempt,
  Refused,
  stop: insistOnStop,
  stopSays,
  may: (scope) => known.scopes.includes(scope),
  benches: () => known.benches,
};

function link(state) {
  text($("link"), WORDS.link[state]);
  $("link").className = `chip ${state === "trying" ? "down" : "up"}`;
}

function login(words) {
  close();
  Object.assign(known, { who: "", scopes: [] });
  link("nobody");
  $("login").hidden = false;
  $("leave").hidden = $("who").hidden = $("view").hidden = true;
  text($("loginsaid"), words || "");
  $("token").focus();
}

async function begin() {
  let who;
  try {
    who = await get("/whoami");
  } catch (error) {
    if (isUnknown(error)) return login("");
    link("trying");
    setTimeout(begin, RETRY_MS);
    return;
  }
  Object.assign(known, { who: who.name, scopes: who.scopes, benches: who.benches });
  $("login").hidden = true;
  $("leave").hidden = $("who").hidden = who.name === "local";
  text($("who"), WORDS.who(who.name, who.scopes.join(", ")));
  if (!context.may("read")) {
    link("stopOnly");
    $("stopfleet").hidden = false;
    $("stopfleet").onclick = () => stopAll(context);
    return;
  }
  link("up");
  $("view").hidden = false;
  const parent = el("div", { class: "view" });
  $("view").replaceChildren(parent);
  await open(parent, context);
  document.title = WORDS.title(parent.querySelector("h2").textContent);
}

// If another user has signed in, or the session has ended, the page starts again.
async function recognise() {
  const nobody = { name: "", scopes: [] };
  const who = await get("/whoami").catch((error) => (isUnknown(error) ? nobody : null));
  if (who && (who.name !== known.who || who.scopes.join() !== known.scopes.join())) location.reload();
}

$("skip").addEventListener("click", () => $("view").focus());
$("leave").addEventListener("click", async () => {
  await attempt(signOut);
  location.reload();
});
onSession(recognise);
$("login").addEventListener("submit", async (event) => {
  event.preventDefault();
  const token = $("token").value.trim();
  $("token").value = "";
  try {
    await signIn(token);
  } catch (error) {
    return login(error.status === 401 ? WORDS.unknownToken(error.message) : error.message);
  }
  return begin();
});

begin();
