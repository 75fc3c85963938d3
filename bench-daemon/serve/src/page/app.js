// The page: its state, its requests, and its keys.
"use strict";

import { Refused, file, get, listen, onSession, post, put, remove, signIn, signOut, stopNow } from "./server.js";
import {
  $,
  drawInstruments,
  drawMissed,
  drawNow,
  drawOthers,
  drawOutputs,
  drawOverview,
  drawRun,
  drawStop,
  drawTrip,
  duration,
  el,
  fill,
  outcome,
  person,
  saveBlob,
  text,
  when,
} from "./bench.js";
import { ask as askFirst, close, together } from "./energise.js";
import { tellHere } from "./notices.js";
import { drawQuestion } from "./question.js";
import { drawTime, fitTime } from "./time.js";
import { drawTour, noteTour } from "./tour.js";

const WORDS = {
  title: (what) => `${what} – eis-bench`,
  titleSigns: { latched: "▲ ", asking: "◆ ", running: "▶ " },
  refused: (why) => `Refused: ${why}`,
  notReached: (why) => `Not reached: ${why}`,
  close: "Close this message",
  link: {
    up: "● connected",
    down: "○ connection lost: the values are out of date",
    refused: "✕ the token is refused",
    trying: "○ not reached, trying again",
    stopOnly: "● this token cannot read; STOP works",
    connecting: "connecting …",
    nobody: "○ not signed in",
  },
  ended: "The session has ended.",
  unknownToken: (why) => `This token is not valid: mistyped, expired or revoked (${why}).`,
  who: (name, scopes) => `${name}: ${scopes || "STOP only"}`,
  lacks: (scope, scopes) => `needs the scope ${scope}; yours has: ${scopes || "none"}`,
  maySubmit: (lacks) => `To submit, the token ${lacks}.`,
  stop: "■ STOP",
  stopBench: (bench) => `■ STOP ${bench}`,
  stopAll: "■ STOP ALL",
  stopping: (tries) => (tries === 1 ? "■ STOPPING …" : `■ STOPPING, TRY ${tries} …`),
  escape: (stop) => `Esc once more within 1.5 s: ${stop}`,
  stops: (reports) => `Stopped. ${reports.join("; ")}.`,
  stoppedOff: (bench, words) => `${bench}: ${words}`,
  stoppedSimulated: (bench) => `${bench}: simulated within the run's process, which has ended`,
  stoppedUnverified: (bench) => `▲ ${bench}: STOPPED, BUT NOT VERIFIED: LOOK AT THE BENCH`,
  stopSignIn: (why, safe) =>
    `The stop was refused: sign in first (${why}). ` +
    `Without a token: the emergency switch, or on the machine: ${safe}`,
  stopRefused: (why, safe) =>
    `The stop was refused: ${why}. NOTHING WAS STOPPED, and it is not sent again. ` +
    `Use the emergency switch, or on the machine: ${safe}`,
  stopUnheard: (waited, why, safe) =>
    `No confirmation after ${waited} s that the bench is off (${why}). The stop is sent again. ` +
    `Use the emergency switch, or on the machine: ${safe}`,
  // Without a bench file it switches off every bench that runs or ran on the machine.
  safeEvery: "eis-bench safe",
  outputsRead: ({ words }) => `Read: ${words}.`,
  noAnswer: "no answer yet",
  curveOf: (run, name) => `${run}: ${name}`,
  noAddress: (hash, bench) => `The address ${hash} does not exist: ${bench} is shown.`,
  empty: "Empty.",
  inQueue: (item, time, who) =>
    `${item.run} on ${item.bench}, ${item.kind === "resume" ? "to go on, " : ""}` +
    `about ${time} of bench time, by ${who}`,
  atWork: "▶ in work: ",
  takeOut: "Take out",
  takenOut: (run) => `${run} was taken out.`,
  first: "First",
  held: (bench, why) => `❚❚ No run starts on ${bench}: ${why}. `,
  heldWhy: "What was found, and why it may go on ",
  release: "Let the queue go on",
  released: "The queue goes on.",
  releases: (runs) => `${runs.length === 1 ? "It starts" : "They start one after the other"}: ${runs.join(", ")}.`,
  yesRelease: "Yes, let the queue go on",
  inWork: "▶ in work",
  compare: "Compare",
  compareRun: (run) => `Compare ${run}`,
  bench: "Bench",
  submitted: "Submitted",
  by: "By",
  report: "Report",
  goOn: "Go on",
  waitsToGoOn: (run) => `${run} waits to go on.`,
  resumes: (run) => `${run} goes on at the first unfinished point. The whole plan:`,
  unpauses: (run) => `${run} goes on where it paused. The whole plan:`,
  yesGoOn: (run) => `Yes, go on with ${run}`,
  choose: "choose …",
  submits: (experiment) => `Experiment: ${experiment}.`,
  yesSubmit: (bench) => `Yes, submit to ${bench}`,
  pause: "Pause after this step",
  takeBack: "Pauses after this step: take it back",
  keepsOn: (run) => `${run} does not pause after this step. The whole plan:`,
  cleared: (bench) => `${bench} is cleared.`,
  identify: "Read identities",
  asking: "Asking …",
  answered: ({ answers, silent, trouble }) =>
    `${answers.length} of ${answers.length + silent.length} instruments answered${trouble ? `; ${trouble}` : ""}.`,
  queued: (run) => `${run} is in the queue.`,
  answerTaken: "Answer taken.",
  runEnded: (run, how) => `${run}: ${how}`,
  plan: ({ experiment, bench }, expected, longest) =>
    `${experiment} on ${bench}: about ${expected} of bench time, at most ${longest}.`,
  planStage: (purpose, time) => `${purpose}, about ${time}`,
};

// Time that the stream has at the start before the page requests the state without it, ms.
const FIRST_MS = 2000;

const known = {
  asked: false,
  benches: new Map(),
  bench: "",
  who: "",
  scopes: [],
  link: "",
  queue: { items: [], held: {} },
  runs: [],
  spectra: new Map(),
  models: new Map(),
  chosen: [],
  missed: [],
  // The run whose question was answered here.
  answered: "",
  isAsking: false,
};

const may = (scope) => known.scopes.includes(scope);
const live = () => known.benches.get(known.bench);

let silence = 0;
// Messages about an answer, the end of a run or an address are removed when they become obsolete.
let saidOf = "";

function say(words, bad, of = "") {
  clearTimeout(silence);
  saidOf = of;
  if (words && !bad) silence = setTimeout(() => say(""), 10000);
  $("said").hidden = !words;
  $("said").className = `banner ${bad ? "bad" : "note"}`;
  text($("said"), words || "");
}

// The server does not know the user, or no longer does.
const isUnknown = (error) => error instanceof Refused && (error.status === 401 || error.status === 403);

const failure = (error) => (error instanceof Refused ? WORDS.refused(error.message) : WORDS.notReached(error.message));

function sayError(error, of) {
  say(failure(error), true, of);
}

// Does something that the server may refuse, and says so.
async function attempt(work, done) {
  try {
    const result = await work();
    say(done ? done(result) : "");
    return result;
  } catch (error) {
    sayError(error);
    return null;
  }
}

// The message of a stop stays until the user closes it, or a stop has succeeded.
function stopSays(words, bad = true) {
  const banner = $("stopsaid");
  banner.hidden = !words;
  if (!words) return;
  banner.className = `banner ${bad ? "bad" : "fine"}`;
  const close = el("button", { type: "button", onclick: () => stopSays("") }, WORDS.close);
  banner.replaceChildren(el("strong", {}, words), " ", close);
}

// Of several benches each by its name, the worst first; the banner of the shown one has the rest.
function tellStops(reports) {
  if (reports.length < 2 && known.bench) return stopSays("");
  const fine = (report) => report.verified || report.simulated;
  const words = (report) =>
    report.verified
      ? WORDS.stoppedOff(report.bench, report.read)
      : report.simulated
        ? WORDS.stoppedSimulated(report.bench)
        : WORDS.stoppedUnverified(report.bench);
  const sorted = [...reports].sort((a, b) => Number(fine(a)) - Number(fine(b)));
  return stopSays(WORDS.stops(sorted.map(words)), !reports.every(fine));
}

// ---- the stop -----------------------------------------------------------------------------------

// Stops the bench that is shown, or all of them.
async function stop(all) {
  const button = $(all ? "stopall" : "stop");
  // A stop before a bench is selected stops all benches.
  const one = all ? "" : known.bench;
  const found = await insistOnStop(button, one ? `/benches/${one}/stop` : "/stop");
  if (found) {
    const reports = one ? [found] : found;
    reports.forEach(stopped);
    tellStops(reports);
    miss(reports);
  }
  text(button, stopLabel(all));
}

// Sends a stop until the server replies, and returns the reply, or null if the stop was refused. A request that hangs
// is abandoned after a few seconds, and sent again: the server performs a stop once, and repeated requests get its
// outcome.
async function insistOnStop(button, path) {
  button.classList.add("pressed");
  const began = Date.now();
  const waited = () => Math.round((Date.now() - began) / 1000);
  let answer;
  for (let tries = 1; answer === undefined; tries += 1) {
    text(button, WORDS.stopping(tries));
    try {
      answer = await stopNow(path);
    } catch (error) {
      answer = stopIsRefused(error, path) ? null : undefined;
      const isLate = error.name === "TimeoutError";
      const why = isLate ? WORDS.noAnswer : error.message;
      if (answer === undefined) stopSays(WORDS.stopUnheard(waited(), why, safeCommand(path)));
      if (answer === undefined && !isLate) await new Promise((done) => setTimeout(done, 500));
    }
  }
  button.classList.remove("pressed");
  return answer;
}

// Returns the command that performs the stop on the machine.
function safeCommand(path) {
  const bench = path.startsWith("/benches/") ? live() : null;
  return (bench && bench.safe_command) || WORDS.safeEvery;
}

// Returns whether the server refuses a stop permanently, and shows the reason.
function stopIsRefused(error, path) {
  const isRefused = error instanceof Refused && error.status < 500 && error.status !== 429;
  if (isUnknown(error)) stopSays(WORDS.stopSignIn(error.message, safeCommand(path)));
  else if (isRefused) stopSays(WORDS.stopRefused(error.message, safeCommand(path)));
  return isRefused;
}

// With several benches, the button names the bench that it stops.
function stopLabel(all) {
  if (all || !known.bench) return WORDS.stopAll;
  return known.benches.size > 1 ? WORDS.stopBench(known.bench) : WORDS.stop;
}

// On such a bench a current may flow.
const loud = (bench) => bench.state === "running" || bench.needs_look || (bench.state === "latched" && !bench.verified);

// Benches that are as they were after a stop of another one.
function miss(reports) {
  const off = new Set(reports.map((report) => report.bench));
  known.missed = [...known.benches.values()]
    .filter((bench) => !off.has(bench.bench) && loud(bench))
    .map((bench) => bench.bench);
  drawMiss();
}

function drawMiss() {
  known.missed = known.missed.filter((name) => known.benches.has(name) && loud(known.benches.get(name)));
  drawMissed(
    known.missed.map((name) => known.benches.get(name)),
    () => {
      known.missed = [];
      drawMiss();
    },
  );
}

function stopped(report) {
  if (report.bench !== known.bench || $("stopped").dataset.gone === String(report.unix_s)) return;
  drawStop(report);
}

let escaped = 0;
document.addEventListener("keydown", (event) => {
  if (event.repeat) return;
  const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
  if (event.key === "Escape") {
    const again = event.timeStamp - escaped < 1500;
    escaped = again ? 0 : event.timeStamp;
    if (again) stop(false);
    else say(WORDS.escape(stopLabel(false)));
  } else if (event.key === "S" && event.shiftKey && !event.ctrlKey && !event.altKey && !event.metaKey && !typing) {
    stop(false);
  }
});

// ---- spectra ------------------------------------------------------------------------------------

async function load(run) {
  const found = await get(`/runs/${run}/spectra`);
  known.spectra.set(run, new Map(found.map((one) => [one.name, one])));
}

// Display name of a sweep: `raw_fake_cell` is the fake cell.
const named = (name) => name.replace(/^raw_/, "").replaceAll("_", " ");

// Of a run its corrected spectra, or, while it has none, the sweep that grows.
function shown(run) {
  const all = [...(known.spectra.get(run) || new Map()).values()];
  const corrected = all.filter((one) => one.corrected);
  return corrected.length ? corrected : all;
}

// Of the curves of one run, by the place of their marks and colours.
const LOOKS = ["spectrum", "shunt", "fake cell", "short"];

function curves() {
  const runs = known.chosen.length ? known.chosen : [live() && live().run && live().run.run].filter(Boolean);
  const found = [];
  for (const run of runs)
    for (const one of shown(run))
      found.push({
        id: `${run} ${one.name}`,
        run,
        file: one.name,
        name: runs.length > 1 ? WORDS.curveOf(run, named(one.name)) : named(one.name),
        points: one.points,
        corrected: one.corrected,
      });
  // A control has one colour while it is measured and afterwards: the colour follows its name, not its position.
  const looks = (one, place) => (runs.length > 1 ? place : Math.max(0, LOOKS.indexOf(one.name)));
  return found.slice(0, 25).map((one, place) => ({ ...one, index: looks(one, place) }));
}

// Requests fitted models by curve, once for each number of points.
async function askModels(found) {
  const wanted = found.filter((one) => one.corrected && named(one.file).startsWith("spectrum"));
  for (const one of wanted.slice(0, 4)) {
    const key = `${one.id} ${one.points.length}`;
    if (known.models.has(key)) continue;
    known.models.set(key, []);
    const models = await get(`/runs/${one.run}/models?spectrum=${encodeURIComponent(one.file)}`).catch(() => []);
    known.models.set(
      key,
      models.map((model) => ({ ...model, curve: one.id })),
    );
    if (models.length) drawSpectra();
  }
}

let panel = null;

function drawSpectra() {
  const found = curves();
  $("plots").hidden = !found.length;
  if (!found.length || $("main").hidden) return;
  const onPoint = (curve, point) => {
    const query = new URLSearchParams({ spectrum: curve.file, freq_hz: point.freq_hz });
    go(`#/run/${encodeURIComponent(curve.run)}?${query}`);
  };
  panel ||= window.eisCurves.panel($("curves"), { onPoint });
  const models = found.flatMap((one) => known.models.get(`${one.id} ${one.points.length}`) || []);
  panel.show({ curves: found, models, controls: [] });
  askModels(found);
}

// ---- time ---------------------------------------------------------------------------------------

// No more often than this while readings come in, ms.
const TIME_MS = 2000;
let timed = 0;

function drawStrips(now) {
  if ($("main").hidden) return;
  const at = Date.now();
  if (!now && at - timed < TIME_MS) return;
  timed = at;
  const bench = live();
  const run = known.chosen.length === 1 ? known.chosen[0] : bench && bench.run && bench.run.run;
  drawTime(get, run || "", bench ? bench.limits : []);
}

// ---- queue and history --------------------------------------------------------------------------

function drawQueue() {
  const items = known.queue.items;
  const waiting = items.filter((item) => !item.process);
  const move = (item) => post("/queue/order", { ids: [item.id] });
  fill(
    $("items"),
    ...(items.length ? items : [null]).map((item) => {
      if (!item) return el("li", { class: "quiet" }, WORDS.empty);
      const words = WORDS.inQueue(item, duration(item.expected_s), person(item.by));
      const button = (words, onclick) => el("button", { type: "button", onclick }, words);
      const takenOut = () => WORDS.takenOut(item.run);
      const takeOut = () => attempt(() => remove(`/queue/${item.id}`), takenOut);
      const isMovable = !item.process && may("operate");
      const cancel = isMovable ? button(WORDS.takeOut, takeOut) : null;
      const isBehind = isMovable && waiting[0] !== item;
      const first = isBehind ? button(WORDS.first, () => attempt(() => move(item))) : null;
      return el("li", {}, item.process ? el("b", {}, WORDS.atWork) : "", words, " ", first, cancel);
    }),
  );
  const why = known.queue.held[known.bench];
  $("held").hidden = !why;
  if (why) {
    const reason = el("input", { id: "why", maxlength: 200, required: true, autocomplete: "off" });
    const release = el(
      "form",
      {
        class: "acts",
        onsubmit: (event) => {
          event.preventDefault();
          releaseQueue(known.bench, $("why").value.trim());
        },
      },
      el("label", {}, WORDS.heldWhy, reason),
      el("button", { type: "submit", disabled: !may("energise") }, WORDS.release),
      may("energise") ? "" : el("span", { class: "quiet" }, lacks("energise")),
    );
    // Redrawn only if the text changes, so that typed text survives.
    const words = WORDS.held(known.bench, why);
    if ($("held").dataset.words !== words) $("held").replaceChildren(words, release);
    $("held").dataset.words = words;
  }
}

// ---- what starts a current ----------------------------------------------------------------------

// Number of questions so far: the plan of an earlier one that arrives late opens nothing.
let questions = 0;

// Closes the question, and the one whose plan is on its way.
function dropQuestion() {
  questions += 1;
  close($("ask"));
}

// Asks beside a part of the page before a current flows. `paths` have the texts of the experiments. A run that goes on
// has its own frozen files, so its plan is only shown.
async function energise(beside, paths, question) {
  const back = document.activeElement;
  const number = ++questions;
  const plan = async (path) => {
    const { text } = await get(path);
    return post("/drafts", { text, bench: question.bench });
  };
  const all = () => Promise.all(paths.map(plan)).then(together);
  const draft = question.goesOn ? await all().catch(() => null) : await attempt(all);
  if (number !== questions || (!draft && !question.goesOn)) return;
  beside.after($("ask"));
  askFirst($("ask"), { ...question, draft, back });
}

const experimentOf = (run) => `/runs/${run}/experiment`;

function resume({ item: { run, bench } }) {
  const send = () => post(`/runs/${run}/resume`);
  const done = () => say(WORDS.waitsToGoOn(run));
  const [title, go] = [WORDS.resumes(run), WORDS.yesGoOn(run)];
  energise($("runs").closest(".scroll"), [experimentOf(run)], { bench, title, go, send, done, goesOn: true });
}

function unpause(bench, run, title = WORDS.unpauses(run)) {
  const send = () => post(`/runs/${run}/go-on`);
  const done = ({ said }) => say(said);
  const go = WORDS.yesGoOn(run);
  energise($("runacts"), [experimentOf(run)], { bench, title, go, send, done, goesOn: true });
}

// Releases the queue of a bench. It asks if a run waits, because that run starts.
function releaseQueue(bench, why) {
  const send = () => post(`/benches/${bench}/release`, { why });
  const waiting = known.queue.items.filter((item) => item.bench === bench && !item.process);
  if (!waiting.length) return attempt(send, () => WORDS.released);
  const runs = waiting.map((item) => item.run);
  const [title, go, done] = [WORDS.releases(runs), WORDS.yesRelease, () => say(WORDS.released)];
  // Only a run that has begun has frozen files of its own.
  const goesOn = waiting.every((item) => item.kind === "resume");
  return energise($("held"), runs.map(experimentOf), { bench, title, go, send, done, goesOn });
}

function submit() {
  const body = { experiment: $("experiment").value, bench: known.bench };
  if ($("seed").value !== "") body.seed = Number($("seed").value);
  const send = () => post("/queue", body);
  const done = (item) => say(WORDS.queued(item.run));
  const path = `/files/experiments/${encodeURIComponent(body.experiment)}`;
  const [title, go] = [WORDS.submits(body.experiment), WORDS.yesSubmit(body.bench)];
  return energise($("plan"), [path], { bench: body.bench, title, go, send, done });
}

function drawHistory() {
  const row = (job) => {
    const run = job.item.run;
    const how = !job.ended ? WORDS.inWork : outcome(job.ended);
    const box = el("input", {
      type: "checkbox",
      "aria-label": WORDS.compareRun(run),
      checked: known.chosen.includes(run),
      onchange: (event) => compare(run, event.target.checked),
    });
    const acts = [];
    if (job.ended && job.ended.finished)
      acts.push(el("button", { type: "button", onclick: () => keep(run, "report.html") }, WORDS.report));
    if (job.ended && !job.ended.finished && may("energise"))
      acts.push(el("button", { type: "button", onclick: () => resume(job) }, WORDS.goOn));
    return el(
      "tr",
      {},
      el("td", { "data-name": WORDS.compare }, box),
      el("th", { scope: "row" }, el("a", { href: `#/run/${encodeURIComponent(run)}` }, run)),
      el("td", { "data-name": WORDS.bench }, job.item.bench),
      el("td", { "data-name": WORDS.submitted }, when(job.item.submitted_unix_s)),
      el("td", { "data-name": WORDS.by }, person(job.item.by)),
      el("td", {}, how),
      el("td", {}, ...acts),
    );
  };
  fill($("runs"), ...known.runs.slice(0, 20).map(row));
  drawTour(known.runs);
}

async function compare(run, on) {
  known.chosen = known.chosen.filter((one) => one !== run);
  if (on) known.chosen.push(run);
  if (on && !known.spectra.has(run)) await attempt(() => load(run));
  drawSpectra();
  drawStrips(true);
}

// A file of a run.
async function keep(run, path) {
  const blob = await attempt(() => file(`/runs/${run}/files/${path}`));
  if (blob) saveBlob(blob, `${run}-${path}`);
}

function drawActs() {
  const run = live() && live().run;
  const acts = [];
  if (run && run.going && run.run && run.time !== "virtual") {
    if (live().state === "paused" && may("energise"))
      acts.push(el("button", { type: "button", onclick: () => unpause(live().bench, run.run) }, WORDS.goOn));
    else if (live().state === "running" && may(run.pausing ? "energise" : "operate")) {
      const pause = () => attempt(() => post(`/runs/${run.run}/pause`), ({ said }) => said);
      const onclick = () => (run.pausing ? unpause(live().bench, run.run, WORDS.keepsOn(run.run)) : pause());
      const label = run.pausing ? WORDS.takeBack : WORDS.pause;
      acts.push(el("button", { type: "button", "aria-pressed": String(run.pausing), onclick }, label));
    }
  }
  const key = acts.map((act) => act.textContent).join();
  if ($("runacts").dataset.key !== key) $("runacts").replaceChildren(...acts);
  $("runacts").dataset.key = key;
}

// ---- the whole ----------------------------------------------------------------------------------

function draw() {
  const now = live();
  if (!now) return;
  if (!$("main").hidden) document.title = WORDS.title(`${WORDS.titleSigns[now.state] || ""}${now.bench}`);
  drawNow(now);
  drawRun(
    now,
    known.runs.find((job) => now.run && job.item.run === now.run.run),
    $("runbody"),
  );
  drawActs();
  drawInstruments(now);
  drawOutputs(now);
  drawOverview([...known.benches.values()], known.bench);
  if (!$("stop").classList.contains("pressed")) text($("stop"), stopLabel(false));
  drawOthers(
    [...known.benches.values()].filter((one) => one.bench !== known.bench),
    choose,
  );
  drawMiss();
  const clear = (one, found) =>
    attempt(
      () => post(`/benches/${one.bench}/trips/clear`, { cause: one.trip.cause, found }),
      () => WORDS.cleared(one.bench),
    );
  drawTrip(now, clear, may("clear-trip") ? "" : lacks("clear-trip"));
  const send = (question, serial) => answer(now, question, serial);
  drawQuestion(now, send, may("energise") ? "" : lacks("energise"));
  // The outcome of a stop is removed once something runs again, or has tripped since.
  const over =
    ["running", "paused", "asking"].includes(now.state) || (now.trip && now.stop && now.trip.unix_s > now.stop.unix_s);
  if (over) $("stopped").hidden = true;
  else if (now.stop) stopped(now.stop);
  drawRights();
}

// Answers a question of a bench; returns why the answer was refused, or nothing.
async function answer({ bench, run }, question, serial) {
  try {
    await post(`/runs/${run.run}/answer`, { question: question.number, ...(serial ? { serial } : {}) });
  } catch (error) {
    return failure(error);
  }
  known.answered = run.run;
  say(WORDS.answerTaken, false, "answer");
  // The question closes together with its focused control. Focus elsewhere, or at the next question, stays.
  const next = live() && live().question;
  const isHere = document.activeElement === document.body || $("question").contains(document.activeElement);
  if (isHere && bench === known.bench && (!next || next.number === question.number)) $("now-h").focus();
  return "";
}

// Removes earlier messages about a bench that now does something else.
function unsay(before, now) {
  if (now.bench !== known.bench || !before || before.state === now.state) return;
  if (saidOf === "answer" || (saidOf === "end" && ["running", "asking"].includes(now.state))) say("");
}

// Informs a user who answered a question of a run if the run does not finish.
function sayEnd({ item, ended }) {
  if (!ended || item.run !== known.answered) return;
  known.answered = "";
  // A stop shows its own message.
  if (!ended.finished && $("stopped").hidden) say(WORDS.runEnded(item.run, outcome(ended)), true, "end");
}

// Shows actions that are not permitted, with the reason.
function drawRights() {
  const atWork = live() && !["idle", "latched", "unknown"].includes(live().state);
  for (const id of ["identify", "readoutputs"]) {
    const isSimulated = id === "readoutputs" && live().outputs.state === "simulated";
    $(id).disabled = !may("operate") || atWork || isSimulated || known.isAsking;
    $(id).title = !may("operate") ? lacks("operate") : atWork ? live().outputs.words : "";
  }
  text($("identify"), known.isAsking ? WORDS.asking : WORDS.identify);
  const isChosen = Boolean($("experiment").value);
  for (const control of $("submit").querySelectorAll("button"))
    control.disabled = !isChosen || (control.type === "submit" && !may("energise"));
  $("maynot").hidden = may("energise");
  text($("maynot"), may("energise") ? "" : WORDS.maySubmit(lacks("energise")));
}

const lacks = (scope) => WORDS.lacks(scope, known.scopes.join(", "));

// ---- parts of the page --------------------------------------------------------------------------

const MODULES = {
  new: "/forms.js",
  files: "/forms.js",
  catalog: "/catalog.js",
  run: "/run.js",
  cell: "/cell.js",
  analyses: "/analysis.js",
  analysis: "/analysis.js",
  pack: "/pack.js",
  notices: "/notices.js",
};

// Old addresses that users may have stored, with their present names.
const MOVED = { runs: "runs", cells: "cells" };

const context = {
  get,
  post,
  put,
  remove,
  file,
  attempt,
  may,
  Refused,
  go: (hash) => go(hash),
  benches: () => [...known.benches.keys()],
  bench: () => known.bench,
  // While a user watches an active run, a stop refers to its bench.
  watch: (bench) => {
    if (!known.benches.has(bench)) return;
    known.bench = bench;
    draw();
  },
};

const view = { module: null, opened: 0 };

function go(hash) {
  if (location.hash === hash) route();
  else location.hash = hash;
}

// Parses the address: `#/run/demo-3?…` is a part, anything else a bench.
function address() {
  const [path, query] = location.hash.slice(2).split("?");
  return { path: path.split("/").map(plain), query: new URLSearchParams(query || "") };
}

// An address of before becomes the one of now.
function move() {
  const { path, query } = address();
  if (!location.hash.startsWith("#/") || !Object.hasOwn(MOVED, path[0])) return;
  query.set("of", MOVED[path[0]]);
  history.replaceState(history.state, "", `#/catalog?${query}`);
}

// Shows the target of the address. The state of a bench that was not shown before is incomplete, so it is requested.
function route() {
  if (!may("read")) return;
  show();
  if (!$("main").hidden) attempt(refresh);
}

// Opens the part that the address names, or makes room for a bench.
async function show() {
  const opened = (view.opened += 1);
  if (saidOf) say("");
  noteTour();
  if (view.module && view.module.close) view.module.close();
  view.module = null;
  move();
  const part = location.hash.startsWith("#/") ? address() : null;
  const source = part && Object.hasOwn(MODULES, part.path[0]) && MODULES[part.path[0]];
  $("main").hidden = Boolean(source);
  $("view").hidden = !source;
  $("view").replaceChildren();
  for (const link of $("views").querySelectorAll("a"))
    if (source && link.hash.slice(2) === part.path[0]) {
      link.setAttribute("aria-current", "page");
      // On a narrow screen the links are a row that scrolls.
      const row = link.closest("ul");
      row.scrollLeft = link.offsetLeft - row.offsetLeft - row.clientWidth / 3;
    } else link.removeAttribute("aria-current");
  if (!source) {
    if (known.benches.has(addressed())) known.bench = addressed();
    else if (known.asked && location.hash.length > 1 && location.hash !== "#/")
      say(WORDS.noAddress(location.hash, known.bench), true, "address");
    $("stopped").hidden = true;
    dropQuestion();
    // The stop means this bench from now on, and says so.
    draw();
    // Navigation from another part starts at the top of this one.
    if (opened > 1) $("now-h").focus({ preventScroll: true });
    return;
  }
  const parent = el("div", { class: "view" });
  try {
    const module = await import(source);
    if (opened !== view.opened) return;
    view.module = module;
    $("view").append(parent);
    await module.open(parent, part, context);
  } catch (error) {
    sayError(error);
    return;
  }
  const heading = parent.querySelector("h2");
  if (heading && opened === view.opened) document.title = WORDS.title(heading.textContent);
}

// The bench that the address names: `#demo`.
const addressed = () => (location.hash.startsWith("#/") ? "" : plain(location.hash.slice(1)));

// A malformed address has no target.
function plain(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return "";
  }
}

// Shows another bench; each has an address of its own, which can be sent.
const choose = (bench) => go(`#${encodeURIComponent(bench)}`);

async function ask() {
  const [benches, queue, runs, offered] = await Promise.all([
    get("/benches"),
    get("/queue"),
    get("/runs"),
    get("/experiments"),
  ]);
  known.benches = new Map(benches.map((one) => [one.bench, one]));
  if (known.benches.has(addressed())) known.bench = addressed();
  if (!known.benches.has(known.bench))
    known.bench = (benches.find((one) => one.run && one.run.going) || benches[0]).bench;
  [known.queue, known.runs] = [queue, runs];
  $("stopall").hidden = benches.length < 2;
  const before = $("experiment").value;
  const names = offered.map((one) => one.experiment);
  // Of several experiments none is chosen until a user chooses it. The selection stays.
  const choices = names.length === 1 ? names : ["", ...names];
  if (choices.join() !== [...$("experiment").options].map((one) => one.value).join()) {
    $("experiment").replaceChildren(...choices.map((name) => el("option", { value: name }, name || WORDS.choose)));
    $("experiment").value = names.includes(before) ? before : choices[0];
  }
  known.spectra.clear();
  const wanted = new Set(known.chosen);
  if (live().run && live().run.run) wanted.add(live().run.run);
  await Promise.all([...wanted].map((run) => load(run).catch(() => {})));
  known.asked = true;
}

function drawAll() {
  draw();
  drawQueue();
  drawHistory();
  drawSpectra();
  drawStrips(true);
}

async function refresh() {
  await ask();
  drawAll();
}

// Requests the complete state once the stream is connected, at the start and after each reconnection. Then shows the
// target of the address, if nothing is shown yet or a part is missing.
async function again() {
  await attempt(ask);
  const isEmpty = $("main").hidden && !view.module;
  if (isEmpty && may("read")) show();
  drawAll();
}

// A missing event stream or a missing reply must not leave the page empty.
async function insist() {
  if (known.asked || !may("read")) return;
  await again();
  setTimeout(insist, FIRST_MS);
}

// If another user has signed in, or the session has ended, the page starts again.
async function recognise() {
  const nobody = { name: "", scopes: [] };
  const who = await get("/whoami").catch((error) => (isUnknown(error) ? nobody : null));
  if (who && (who.name !== known.who || who.scopes.join() !== known.scopes.join())) location.reload();
}

function heard(kind, data) {
  if (view.module && view.module.heard) view.module.heard(kind, data);
  if (kind === "hello") again();
  if (kind === "lost") attempt(refresh);
  if (kind === "live") {
    const before = known.benches.get(data.bench);
    known.benches.set(data.bench, data);
    unsay(before, data);
    draw();
    if (data.bench === known.bench && before && (before.run && before.run.run) !== (data.run && data.run.run))
      drawSpectra();
    if (data.bench === known.bench) drawStrips(false);
  }
  if (kind === "notice") tellHere(data);
  if (kind === "stop") stopped(data);
  if (kind === "queue") {
    known.queue = data;
    drawQueue();
  }
  if (kind === "run") {
    known.runs = [data, ...known.runs.filter((job) => job.item.run !== data.item.run)];
    drawHistory();
    draw();
    sayEnd(data);
  }
  if (kind === "spectrum" && data.run) {
    if (!known.spectra.has(data.run)) known.spectra.set(data.run, new Map());
    known.spectra.get(data.run).set(data.spectrum.name, data.spectrum);
    drawSpectra();
  }
}

function link(state) {
  // The scopes of a token may have changed during the interruption.
  if (state === "up" && known.link === "down") recognise();
  known.link = state;
  text($("link"), WORDS.link[state]);
  $("link").className = `chip ${state}`;
  document.body.classList.toggle("stale", state !== "up");
  if (state === "up") heard("hello", {});
  if (state === "refused") login(WORDS.ended);
}

function login(words) {
  Object.assign(known, { who: "", scopes: [], asked: false });
  if (view.module && view.module.close) view.module.close();
  view.module = null;
  $("login").hidden = false;
  text($("link"), WORDS.link.nobody);
  $("link").className = "chip";
  $("leave").hidden = $("who").hidden = true;
  $("main").hidden = $("view").hidden = $("views").hidden = true;
  text($("loginsaid"), words || "");
  $("token").focus();
}

async function begin() {
  try {
    const who = await get("/whoami");
    known.scopes = who.scopes;
    known.bench ||= who.benches.length === 1 ? who.benches[0] : "";
    known.who = who.name;
    $("leave").hidden = $("who").hidden = who.name === "local";
    text($("who"), WORDS.who(who.name, who.scopes.join(", ")));
  } catch (error) {
    if (isUnknown(error)) return login("");
    text($("link"), WORDS.link.trying);
    setTimeout(begin, 1000);
    return;
  }
  $("login").hidden = true;
  text($("link"), WORDS.link.connecting);
  if (!may("read")) {
    text($("link"), WORDS.link.stopOnly);
    return;
  }
  $("views").hidden = false;
  listen(known.who, heard, link);
  setTimeout(insist, FIRST_MS);
}

$("stop").addEventListener("click", () => stop(false));
$("stopall").addEventListener("click", () => stop(true));
window.addEventListener("resize", () => {
  fitTime();
  drawStrips(true);
});
$("skip").addEventListener("click", () => ($("main").hidden ? $("view") : $("main")).focus());
$("leave").addEventListener("click", async () => {
  await attempt(signOut);
  location.reload();
});
window.addEventListener("hashchange", route);
onSession(recognise);
// A plan belongs to its experiment.
$("experiment").addEventListener("change", () => {
  $("plan").hidden = true;
  dropQuestion();
  drawRights();
});
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
$("readoutputs").addEventListener("click", () =>
  attempt(() => post(`/benches/${known.bench}/outputs/read`), WORDS.outputsRead),
);
$("identify").addEventListener("click", async () => {
  known.isAsking = true;
  drawRights();
  await attempt(() => post(`/benches/${known.bench}/identify`), WORDS.answered);
  known.isAsking = false;
  drawRights();
});
$("submit").addEventListener("submit", (event) => {
  event.preventDefault();
  submit();
});
$("showplan").addEventListener("click", async () => {
  const plan = await attempt(() => get(`/experiments/${$("experiment").value}/plan?bench=${known.bench}`));
  $("plan").hidden = !plan;
  if (!plan) return;
  const stages = plan.stages.map((stage) =>
    el(
      "li",
      {},
      WORDS.planStage(stage.purpose, duration(stage.expected_s)),
      el("ol", {}, ...stage.steps.map((step) => el("li", {}, step))),
    ),
  );
  $("plan").replaceChildren(
    el("p", {}, WORDS.plan(plan, duration(plan.expected_s), duration(plan.longest_s))),
    el("ol", {}, ...stages),
  );
});

begin();
