// Draws the present state of a bench into the page. Nothing here sends requests to the server.
"use strict";

const WORDS = {
  unknown: "–",
  seconds: (s) => `${s} s`,
  minutes: (min, s) => `${min} min ${s} s`,
  hours: (h, min) => `${h} h ${min} min`,
  noDuration: "unknown",
  somebody: "user of this machine",
  roles: { supply4q: "bipolar supply" },
  states: {
    unknown: ["?", "Unknown: a run has left outputs that were not read back as off"],
    idle: ["○", "Idle: nothing runs"],
    running: ["▶", "Running: current may flow"],
    paused: ["❚❚", "Paused: every output that the program switches is off"],
    asking: ["◆", "Waits for a person to change the fixture: every output that the program switches is off"],
    stopping: ["■", "Stopping …"],
    latched: ["▲", "Latched: a person has to look"],
  },
  noState: "?",
  state: (sign, words) => `${sign} ${words}`,
  unread: ["▶", "Running: every output reports off; no current has been read yet"],
  allOff: ["▶", "Running: every output is off"],
  flows: (amps) => ["▲", `Running: ${amps} A flow, although every output reports off`],
  voltage: "Cell voltage",
  voltageOf: (fixture) => `Voltage (${fixture})`,
  current: "Current",
  charge: "charge",
  discharge: "discharge",
  temperature: "Cell temperature",
  soc: "State of charge",
  share: (percent) => `${percent} %`,
  socFrom: "from the voltage at rest",
  noSoc: "not known yet",
  oldReading: "old reading",
  noReading: "no reading",
  tripped: (value, unit) => `▲ tripped at ${value} ${unit}`,
  range: (least, greatest, unit) => `${least} to ${greatest} ${unit}`,
  noLeast: "…",
  beyond: (margin, unit) => `▲ beyond by ${margin} ${unit}`,
  left: (margin, unit, end, whose, isNear) =>
    `${isNear ? "▲ only " : ""}${margin} ${unit} left to the ${end} limit of ${whose}`,
  whose: { step: "the present step", cell: "the cell" },
  control: (fixture) => `the ${fixture} in the jig`,
  wider: (whose, range) => `limits of ${whose}: ${range}`,
  upper: "upper",
  lower: "lower",
  meter: (quantity, words, range) => `${quantity}: ${words} of ${range}`,
  failed: (how) => `✕ ${how}`,
  stopped: (who) => `■ stopped${who ? ` by ${who}` : ""}; it can go on`,
  pausing: (plain, left) => `${plain}; pauses after this step${left ? `, in about ${left}` : ""}`,
  finished: "✓ finished",
  finishedBut: (how) => `✓ finished, but ${how}`,
  gateRefused: "✓ finished, but the quality gate refused points",
  noRun: "No run yet. Submit an experiment below.",
  noEnd: "its process ended without a message",
  point: (number, of, hz) => `point ${number} of ${of}, ${hz} Hz`,
  progress: "share of the plan that is done",
  experiment: "Experiment",
  experimentOf: (experiment, run) => `${experiment}${run ? ` (${run})` : ""}`,
  stage: "Stage",
  place: (number, of, words) => `${number} of ${of}: ${words}`,
  beginning: "beginning",
  step: "Step",
  pointInWork: "Point in work",
  points: "Points",
  pointsDone: (done, of) => `${done} of ${of} finished`,
  timeLeft: "Time left, by the clock",
  noTimeLeft: "unknown",
  about: (time) => `about ${time}`,
  outputOn: "● ON",
  outputOff: "○ off",
  answered: (time) => `answered ${time} ago`,
  lastRun: "in the last run",
  notAsked: "not asked",
  otherModel: (model) => `${model} ✕ another model answers`,
  identityNotAsked: "not asked yet",
  readBackBy: (who, time) => `read ${time} by ${who}`,
  readers: {
    run: "the run",
    guardian: "the guardian",
    stop: "the stop",
    safe: "eis-bench safe",
    read: "a reading",
    "next run": "the next run",
  },
  withOutputs: (words, outputs) => `${words}; ${outputs}`,
  readsIdle: (time) => `This server reads the outputs every ${time} while nothing runs.`,
  readsNever: "This server does not read idle benches by itself.",
  trouble: (words) => `▲ ${words}`,
  overview: (sign, bench, state, left, proof) => `${sign} ${bench}: ${state}${left}${proof}`,
  overviewAsking: "waits for a person",
  overviewTrip: (cause) => `latched, ${cause}`,
  overviewLeft: (time) => `, ${time} left`,
  overviewOutputs: (words, isLoud) => `, ${isLoud ? "▲ " : ""}${words}`,
  warning: "▲ ",
  otherTrip: (bench, cause) => `${bench} is latched: ${cause}`,
  otherOutputs: (bench, words) => `${bench}: ${words}`,
  otherStop: (bench) => `${bench} was stopped, but not verified: LOOK AT THE BENCH`,
  show: (bench) => `Show ${bench}`,
  missed: (benches) => `▲ NOT stopped: ${benches}. `,
  missedOne: (bench, state) => `${bench} (${state})`,
  missedOutputs: (state, outputs) => `${state}, ${outputs}`,
  missedHint: "STOP ALL stops every bench. ",
  close: "Close this message",
  looked: "Who looked, and what was found ",
  lookedHint: "name; what was found and done",
  clear: "I have looked: clear",
  trip: (bench) => `▲ ${bench} is latched. `,
  tripWhy: ({ cause, step, by }, time) =>
    `${cause}${step ? `, in step “${step}”` : ""}. Found by the ${by}, ${time}. Look at the bench and at the cell. `,
  stopping: (bench) => `■ Stopping ${bench} …`,
  stoppedSimulated: (bench) =>
    `✓ Stopped ${bench}: it is simulated within the run's process, and that has ended. ` +
    "It has no outputs to read back.",
  stopped: (bench, words) => `✓ Stopped ${bench}: ${words}.`,
  stoppedUnverified: (bench) => `▲ ${bench} STOPPED, BUT NOT VERIFIED: LOOK AT THE BENCH.`,
  stoppedBy: (who, time) => ` By ${who}, ${time}.`,
  stopSteps: "What was done and read back",
  output: (isVerified, words) => `${isVerified ? "○" : "▲"} ${words}`,
};

export const $ = (id) => document.getElementById(id);

export function el(name, attributes, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes || {})) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value === true) node.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(key, value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

// The browser saves it under a name: it never becomes a page of this server.
export function saveBlob(blob, name) {
  const href = URL.createObjectURL(blob);
  const link = el("a", { href, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(href), 60000);
}

// Writes only changes, so that a screen reader does not repeat itself.
export function text(node, value) {
  if (node.textContent !== value) node.textContent = value;
}

// Replaces only nodes that differ: a button that is replaced between press and release loses the click.
export function fill(parent, ...children) {
  const next = parent.cloneNode(false);
  next.append(...children);
  if (parent.isEqualNode(next)) return;
  // Keyboard focus stays at the control of the same name, otherwise it moves to the first. A box is identified by its
  // label, because it has no text, and a link by its target.
  const named = (control) =>
    control.getAttribute("href") || control.getAttribute("aria-label") || control.textContent;
  const held = parent.contains(document.activeElement) ? named(document.activeElement) : null;
  parent.replaceChildren(...next.childNodes);
  if (held === null) return;
  const controls = [...parent.querySelectorAll("a, button, input, select")];
  const same = controls.find((one) => named(one) === held) || controls[0];
  if (same) same.focus();
  else {
    parent.tabIndex = -1;
    parent.focus();
  }
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return WORDS.noDuration;
  const two = (number) => String(number).padStart(2, "0");
  const s = Math.round(seconds);
  if (s < 60) return WORDS.seconds(s);
  if (s < 3600) return WORDS.minutes(Math.floor(s / 60), two(s % 60));
  return WORDS.hours(Math.floor(s / 3600), two(Math.floor((s % 3600) / 60)));
}

// Digits after the point that the ticks of an axis need: a step of 2.5 needs one, a step of 20 none.
export function decimals(step) {
  for (let digits = 0; digits < 9; digits += 1) {
    const scaled = step * 10 ** digits;
    if (scaled > 0.5 && Math.abs(scaled - Math.round(scaled)) < 1e-6 * scaled) return digits;
  }
  return 9;
}

// Formats local time independently of the locale: 2026-11-22 08:22:35.
export function when(unix_s) {
  if (!unix_s) return WORDS.unknown;
  const at = new Date(1e3 * unix_s);
  return new Date(at - 60000 * at.getTimezoneOffset()).toISOString().slice(0, 19).replace("T", " ");
}

// Writes numbers with the sign for minus, as tables and charts do.
export const minus = (words) => words.replaceAll("-", "−");

export const isKnown = (value) => Number.isFinite(value);

// Returns a colour of the style sheet.
export const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Look of an axis of a chart, with more options.
export const axis = (more) => ({
  stroke: () => ink("--quiet"),
  grid: { stroke: () => ink("--grid"), width: 1 },
  ticks: { stroke: () => ink("--grid"), width: 1 },
  font: "12px system-ui, sans-serif",
  labelFont: "12px system-ui, sans-serif",
  labelSize: 18,
  ...more,
});

const BYTES = ["B", "kB", "MB", "GB", "TB"];

export function size(bytes) {
  let [value, unit] = [bytes, 0];
  while (value >= 999.5 && unit < BYTES.length - 1) [value, unit] = [value / 1000, unit + 1];
  return `${unit && value < 99.5 ? value.toPrecision(2) : value.toFixed(0)} ${BYTES[unit]}`;
}

// Display name of a user. Without tokens, users have no names.
export const person = (who) => (who === "local" ? WORDS.somebody : who);

const fixed = (value, digits) =>
  value === null || value === undefined ? WORDS.unknown : minus(value.toFixed(digits));

// Roles through which current can flow. A running bath does not count.
const DRIVES = ["supply4q", "generator", "load", "supply"];
// As the interlock has it, A.
const NO_CURRENT_A = 0.1;

// Returns whether current may flow in an active run, by the reported state of each output and by the meter. An unknown
// state counts as current.
function running(live) {
  const drives = live.instruments.filter((one) => DRIVES.includes(one.role));
  if (!drives.length || drives.some((one) => one.output !== false)) return WORDS.states.running;
  const amps = live.reading && live.reading.fresh ? live.reading.current_a : null;
  if (amps === null || amps === undefined) return WORDS.unread;
  if (Math.abs(amps) < NO_CURRENT_A) return WORDS.allOff;
  return WORDS.flows(fixed(Math.abs(amps), 2));
}

// Symbol and text of a state.
const stateOf = (state) => WORDS.states[state] || [WORDS.noState, state];

// Returns whether the bench is idle. The state of its outputs is then shown only from a reading, with its time.
export const rests = (live) => ["idle", "latched", "unknown"].includes(live.state);

export function drawNow(live) {
  const [sign, plain] = live.state === "running" ? running(live) : stateOf(live.state);
  const { run } = live;
  const left = run && run.step_left_s !== null ? duration(run.step_left_s) : "";
  const doing = run && run.pausing ? WORDS.pausing(plain, left) : plain;
  const words = rests(live) ? WORDS.withOutputs(plain, live.outputs.words) : doing;
  $("state").className = `state ${live.needs_look ? "latched" : live.state}`;
  text($("state"), WORDS.state(sign, words));
  const reading = live.reading;
  const fresh = reading && reading.fresh;
  const soc = live.soc ? WORDS.share((100 * live.soc.share).toFixed(1)) : WORDS.unknown;
  const control = reading && reading.fixture !== "cell";
  figures(
    $("reading"),
    [
      [control ? WORDS.voltageOf(reading.fixture) : WORDS.voltage, fixed(reading && reading.voltage_v, 4), "V"],
      [
        WORDS.current,
        fixed(reading && reading.current_a, 3),
        "A",
        !fresh
          ? ""
          : reading && reading.current_a > 0.05
            ? WORDS.charge
            : reading && reading.current_a < -0.05
              ? WORDS.discharge
              : "",
      ],
      [WORDS.temperature, fixed(reading && reading.temperature_c, 2), "°C"],
      [WORDS.soc, soc, "", live.soc && !fresh ? "" : live.soc ? WORDS.socFrom : WORDS.noSoc],
    ],
    reading && !fresh ? WORDS.oldReading : "",
  );
  for (const part of ["reading", "limits"]) $(part).classList.toggle("old", Boolean(reading) && !fresh);
  const fixture = reading ? reading.fixture.replaceAll("_", " ") : "";
  $("limits").replaceChildren(...live.limits.map((limit) => bar(limit, live.trip, fixture)));
}

function figures(list, rows, remark) {
  list.replaceChildren(
    ...rows.map(([name, value, unit, more]) =>
      el(
        "div",
        {},
        el("dt", {}, name),
        el(
          "dd",
          {},
          el("b", {}, value),
          unit && value !== WORDS.unknown ? ` ${unit}` : "",
          el("small", {}, more || remark || ""),
        ),
      ),
    ),
  );
}

// Shows a value between its limits, with the margin as text. The quantity that tripped the bench is marked, with the
// value that was read then.
function bar(limit, trip, fixture) {
  if (!trip || trip.quantity !== limit.quantity || trip.value === null) return meter(limit, fixture);
  const node = meter({ ...limit, value: trip.value }, fixture);
  const words = node.querySelector("span:last-of-type");
  words.className = "bad";
  words.textContent = WORDS.tripped(fixed(trip.value, 3), trip.unit || limit.unit);
  node.querySelector(".meter").classList.add("bad");
  return node;
}

function meter(limit, fixture) {
  const { quantity, unit, value, of, margin } = limit;
  const { least, greatest } = limit.in_force;
  const low = least === null ? Math.min(0, value ?? 0) : least;
  const digits = unit === "V" ? 3 : unit === "A" ? 2 : 1;
  const bound = (from) => (from === null ? WORDS.noLeast : fixed(from, digits));
  const between = (from, to) => WORDS.range(bound(from), fixed(to, digits), unit);
  const range = between(least, greatest);
  const whole = fixture === "cell" ? WORDS.whose.cell : WORDS.control(fixture);
  const whose = of === "step" ? WORDS.whose.step : whole;
  const share = margin === null ? 1 : margin / ((greatest - low) / 2);
  const level = margin !== null && margin < 0 ? "bad" : share < 0.1 ? "near" : "fine";
  const by = unit === "°C" ? "K" : unit;
  const end = least === null || greatest - value <= value - least ? WORDS.upper : WORDS.lower;
  const words =
    margin === null
      ? value === null
        ? WORDS.noReading
        : WORDS.oldReading
      : margin < 0
        ? WORDS.beyond(fixed(-margin, digits), by)
        : WORDS.left(fixed(margin, digits), by, end, whose, level === "near");
  const at = value === null ? null : Math.max(0, Math.min(100, (100 * (value - low)) / (greatest - low)));
  const label = WORDS.meter(quantity, words, range);
  const scale = el("div", { class: `meter ${level}`, role: "img", "aria-label": label });
  if (at !== null) {
    const needle = el("i", {});
    needle.style.setProperty("left", `${at}%`);
    scale.append(needle);
  }
  return el(
    "div",
    { class: "limit" },
    el("span", {}, quantity),
    scale,
    el("span", { class: level }, words),
    el("small", {}, of === "step" ? WORDS.wider(whole, between(limit.least, limit.greatest)) : range),
  );
}

// How a run ended that this server began.
export function outcome(ended) {
  if (ended.stopped) return WORDS.stopped(ended.stopped_by && person(ended.stopped_by));
  if (!ended.finished) return WORDS.failed(ended.how);
  if (ended.how !== "finished") return WORDS.finishedBut(ended.how);
  // So older servers wrote it down.
  return ended.code === 11 ? WORDS.gateRefused : WORDS.finished;
}

export function drawRun(live, job, body) {
  const run = live.run;
  if (!run) {
    body.replaceChildren(el("p", { class: "quiet" }, WORDS.noRun));
    return;
  }
  const point = run.point ? WORDS.point(run.point.number, run.point.of, Number(run.point.freq_hz.toPrecision(4))) : "";
  const isFinished = run.ended === "finished";
  const plain = isFinished ? WORDS.finished : run.stopped ? WORDS.stopped("") : WORDS.failed(run.ended || WORDS.noEnd);
  const ended = run.going ? null : job && job.ended ? outcome(job.ended) : plain;
  const level = ended === WORDS.finished ? "good" : isFinished || run.stopped ? "" : "bad";
  const percent = Math.round(100 * run.done);
  const progress = el("progress", { max: 100, value: percent, "aria-label": WORDS.progress });
  const timeLeft = run.left_s === null ? WORDS.noTimeLeft : WORDS.about(duration(run.left_s));
  const rows = [
    [WORDS.experiment, WORDS.experimentOf(run.experiment, run.run)],
    [WORDS.stage, run.stage_number ? WORDS.place(run.stage_number, run.stages, run.stage) : WORDS.beginning],
    [
      WORDS.step,
      run.step_number && run.going
        ? WORDS.place(run.step_number, run.steps, run.step.replace(/\s+/g, " "))
        : WORDS.unknown,
    ],
    [WORDS.pointInWork, run.going && point ? point : WORDS.unknown],
    [WORDS.points, WORDS.pointsDone(run.points_done, run.points)],
    [WORDS.timeLeft, run.going ? timeLeft : WORDS.unknown],
  ];
  body.replaceChildren(
    el("div", { class: "progress" }, progress, el("b", {}, WORDS.share(percent))),
    el("dl", { class: "facts" }, ...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])),
    ...(ended ? [el("p", { class: level }, ended)] : []),
  );
}

export function drawInstruments(live) {
  const now = live.run ? live.run.bench_time_s : 0;
  const going = live.run && live.run.going;
  $("instrumentrows").replaceChildren(
    ...live.instruments.map((one) => {
      const output =
        one.output === true
          ? el("b", { class: "on" }, WORDS.outputOn)
          : one.output === false
            ? el("span", { class: "off" }, WORDS.outputOff)
            : WORDS.unknown;
      const who = one.recognised === false ? WORDS.otherModel(one.model) : one.model;
      const answer = one.output_by
        ? WORDS.readBackBy(WORDS.readers[one.output_by] || one.output_by, when(one.output_unix_s))
        : one.trouble
          ? WORDS.trouble(one.trouble)
          : one.answered_s === null
            ? WORDS.notAsked
            : going
              ? WORDS.answered(duration(Math.max(0, now - one.answered_s)))
              : WORDS.lastRun;
      const said = one.output_by && one.trouble ? `${WORDS.trouble(one.trouble)}; ${answer}` : answer;
      return el(
        "tr",
        { class: one.trouble ? "trouble" : "" },
        el("th", { scope: "row", title: one.role }, WORDS.roles[one.role] || one.role),
        el("td", {}, output, el("small", {}, said)),
        el("td", {}, who, el("small", {}, one.identity || WORDS.identityNotAsked), el("small", {}, one.address)),
      );
    }),
  );
}

// Shows the readings of the outputs, and whether the server reads them automatically.
export function drawOutputs(live) {
  text($("outputssaid"), rests(live) ? live.outputs.words : "");
  const every = live.read_idle_s;
  text($("readsidle"), every ? WORDS.readsIdle(duration(every)) : WORDS.readsNever);
  $("readsidle").hidden = live.outputs.state === "simulated";
}

// States in order of severity, the worst first.
const WORST = ["latched", "unknown", "stopping", "asking", "running", "paused", "idle"];

// All benches in a line, each with its address.
export function drawOverview(benches, chosen) {
  const rank = (one) =>
    one.state === "idle" && one.needs_look ? 1 : (WORST.indexOf(one.state) + WORST.length + 1) % (WORST.length + 1);
  const item = (one) => {
    const [sign] = stateOf(one.state);
    const hasEnd = one.run && one.run.going && one.run.left_s !== null;
    const left = hasEnd ? WORDS.overviewLeft(duration(one.run.left_s)) : "";
    // While a run or a stop is active, no statement about the outputs is shown.
    const proof = rests(one) ? WORDS.overviewOutputs(one.outputs.words, one.needs_look) : "";
    const plain = one.state === "asking" ? WORDS.overviewAsking : one.state;
    const state = one.trip ? WORDS.overviewTrip(one.trip.cause) : plain;
    const words = WORDS.overview(sign, one.bench, state, left, proof);
    const here = one.bench === chosen && !location.hash.startsWith("#/");
    return el(
      "li",
      {},
      el(
        "a",
        {
          href: `#${encodeURIComponent(one.bench)}`,
          class: `bench ${one.needs_look ? "latched" : one.state}`,
          "aria-current": here ? "page" : null,
        },
        words,
      ),
    );
  };
  const sorted = [...benches].sort((a, b) => rank(a) - rank(b) || a.bench.localeCompare(b.bench));
  fill($("overview"), ...sorted.map(item));
}

// Notices about the benches that are not shown.
export function drawOthers(others, choose) {
  const loud = others.filter(
    (one) =>
      one.trip || one.needs_look || (one.stop && one.stop.over && !one.stop.verified && !one.stop.simulated),
  );
  const words = loud.map((one) => [
    one.bench,
    one.trip
      ? WORDS.otherTrip(one.bench, one.trip.cause)
      : one.needs_look
        ? WORDS.otherOutputs(one.bench, one.outputs.words)
        : WORDS.otherStop(one.bench),
  ]);
  const banner = $("others");
  banner.hidden = !words.length;
  const key = JSON.stringify(words);
  if (banner.dataset.key === key) return;
  banner.dataset.key = key;
  banner.replaceChildren(
    ...words.map(([bench, text]) =>
      el(
        "p",
        {},
        el("strong", {}, WORDS.warning),
        `${text} `,
        el("button", { type: "button", onclick: () => choose(bench) }, WORDS.show(bench)),
      ),
    ),
  );
}

// Shows benches that a stop of another bench did not affect, as long as current may flow on them. The message stays
// until they are confirmed, or a user closes it.
export function drawMissed(benches, close) {
  const banner = $("missed");
  const state = (one) => (rests(one) ? WORDS.missedOutputs(one.state, one.outputs.words) : one.state);
  const words = benches.map((one) => WORDS.missedOne(one.bench, state(one))).join(", ");
  banner.hidden = !words;
  if (banner.dataset.key === words) return;
  banner.dataset.key = words;
  banner.replaceChildren(
    el("strong", {}, WORDS.missed(words)),
    WORDS.missedHint,
    el("button", { type: "button", onclick: close }, WORDS.close),
  );
}

// Clearing requires the name of the inspector and the finding; both are stored with the trip.
function clearing(live, clear, lacks) {
  const said = el("input", {
    id: "found",
    required: true,
    maxlength: 1000,
    autocomplete: "off",
    placeholder: WORDS.lookedHint,
  });
  return el(
    "form",
    {
      class: "acts",
      onsubmit: (event) => {
        event.preventDefault();
        clear(live, said.value.trim());
      },
    },
    el("label", {}, WORDS.looked, said),
    el("button", { type: "submit", disabled: Boolean(lacks) }, WORDS.clear),
    lacks ? el("span", {}, lacks) : "",
  );
}

export function drawTrip(live, clear, lacks) {
  const banner = $("trip");
  banner.hidden = !live.trip;
  if (!live.trip) return;
  const key = `${live.bench} ${live.trip.unix_s}`;
  if (banner.dataset.key === key) return;
  banner.dataset.key = key;
  banner.replaceChildren(
    el("strong", {}, WORDS.trip(live.bench)),
    WORDS.tripWhy(live.trip, when(live.trip.unix_s)),
    clearing(live, clear, lacks),
  );
}

export function drawStop(report) {
  const banner = $("stopped");
  banner.hidden = !report;
  if (!report) return;
  const head = !report.over
    ? WORDS.stopping(report.bench)
    : report.simulated
      ? WORDS.stoppedSimulated(report.bench)
      : report.verified
        ? WORDS.stopped(report.bench, report.read)
        : WORDS.stoppedUnverified(report.bench);
  const key = `${report.bench} ${report.unix_s} ${report.over} ${report.verified} ${report.steps.length}`;
  if (banner.dataset.key === key) return;
  banner.dataset.key = key;
  banner.className = `banner ${!report.over ? "note" : report.verified || report.simulated ? "fine" : "bad"}`;
  banner.replaceChildren(
    el("strong", {}, head),
    WORDS.stoppedBy(person(report.by), when(report.unix_s)),
    el(
      "details",
      { open: report.over && !report.verified && !report.simulated },
      el("summary", {}, WORDS.stopSteps),
      el(
        "ul",
        {},
        ...report.steps.map((step) => el("li", {}, step)),
        ...report.outputs.map((output) =>
          el("li", { class: output.verified ? "" : "bad" }, WORDS.output(output.verified, output.text)),
        ),
      ),
    ),
    ...(report.over
      ? [
          el(
            "button",
            {
              type: "button",
              onclick: () => {
                banner.hidden = true;
                banner.dataset.gone = String(report.unix_s);
              },
            },
            WORDS.close,
          ),
        ]
      : []),
  );
}
