// A bench as it is now, drawn into the page. Nothing here speaks with the server.
"use strict";

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

// Only what has changed is written, so that a reader that speaks is not made to repeat itself.
export function text(node, value) {
  if (node.textContent !== value) node.textContent = value;
}

// Only what looks different is exchanged: a button that is new between press and release loses the click.
export function fill(parent, ...children) {
  const next = parent.cloneNode(false);
  next.append(...children);
  if (parent.isEqualNode(next)) return;
  // Whoever goes by keyboard stays where they were: at the control of the same name, else at the first.
  // A box has no text of its own, but a label.
  // A link is what it leads to.
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
  if (seconds === null || seconds === undefined) return "unknown";
  const s = Math.round(seconds);
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, "0")} s`;
  return `${Math.floor(s / 3600)} h ${String(Math.floor((s % 3600) / 60)).padStart(2, "0")} min`;
}

// Local time, the same everywhere: 2026-11-22 08:22:35.
export function when(unix_s) {
  if (!unix_s) return "–";
  const at = new Date(1e3 * unix_s);
  return new Date(at - 60000 * at.getTimezoneOffset()).toISOString().slice(0, 19).replace("T", " ");
}

// Who did something: without tokens nobody has a name.
export const person = (who) => (who === "local" ? "somebody on this machine" : who);

const ROLES = { supply4q: "bipolar supply" };

const fixed = (value, digits) =>
  value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−");

const STATES = {
  unknown: ["?", "Unknown: nobody has verified that every output is off"],
  idle: ["○", "Idle: nothing runs"],
  running: ["▶", "Running: current may flow"],
  paused: ["❚❚", "Paused: every output off"],
  stopping: ["■", "Stopping …"],
  latched: ["▲", "Latched: a person has to look"],
};

// Through these a current can flow; a bath that runs is no current.
const DRIVES = ["supply4q", "generator", "load", "supply"];
// As the interlock has it, A.
const NO_CURRENT_A = 0.1;

// Where a run is in work, whether a current may flow: by each output's own word and by the meter.
// What is not known may be a current.
function running(live) {
  const drives = live.instruments.filter((one) => DRIVES.includes(one.role));
  if (!drives.length || drives.some((one) => one.output !== false)) return STATES.running;
  const amps = live.reading && live.reading.fresh ? live.reading.current_a : null;
  if (amps === null || amps === undefined)
    return ["▶", "Running: every output says that it is off, no current was read yet"];
  if (Math.abs(amps) < NO_CURRENT_A) return ["▶", "Running: every output is off"];
  return ["▲", `Running: ${fixed(Math.abs(amps), 2)} A flow, though every output says that it is off`];
}

export function drawNow(live) {
  const [sign, words] = live.state === "running" ? running(live) : STATES[live.state] || ["?", live.state];
  $("state").className = `state ${live.state}`;
  text($("state"), `${sign} ${words}`);
  const reading = live.reading;
  const fresh = reading && reading.fresh;
  const soc = live.soc ? `${(100 * live.soc.share).toFixed(1)} %` : "–";
  const control = reading && reading.fixture !== "cell";
  figures(
    $("reading"),
    [
      [control ? `Voltage (${reading.fixture})` : "Cell voltage", fixed(reading && reading.voltage_v, 4), "V"],
      [
        "Current",
        fixed(reading && reading.current_a, 3),
        "A",
        !fresh
          ? ""
          : reading && reading.current_a > 0.05
            ? "charge"
            : reading && reading.current_a < -0.05
              ? "discharge"
              : "",
      ],
      ["Cell temperature", fixed(reading && reading.temperature_c, 2), "°C"],
      ["State of charge", soc, "", live.soc && !fresh ? "" : live.soc ? "from the voltage at rest" : "not known yet"],
    ],
    reading && !fresh ? "old reading" : "",
  );
  for (const part of ["reading", "limits"]) $(part).classList.toggle("old", Boolean(reading) && !fresh);
  $("limits").replaceChildren(...live.limits.map((limit) => bar(limit, live.trip)));
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
          unit && value !== "–" ? ` ${unit}` : "",
          el("small", {}, more || remark || ""),
        ),
      ),
    ),
  );
}

// Where a value lies between its limits, with the margin in words. The quantity that has tripped the
// bench says so, with the value that was read then.
function bar(limit, trip) {
  if (!trip || trip.quantity !== limit.quantity || trip.value === null) return meter(limit);
  const node = meter({ ...limit, value: trip.value });
  const words = node.querySelector("span:last-of-type");
  words.className = "bad";
  words.textContent = `▲ tripped at ${fixed(trip.value, 3)} ${trip.unit || limit.unit}`;
  node.querySelector(".meter").classList.add("bad");
  return node;
}

function meter(limit) {
  const { quantity, unit, value, least, greatest, margin } = limit;
  const low = least === null ? Math.min(0, value ?? 0) : least;
  const digits = unit === "V" ? 3 : 1;
  const range = `${least === null ? "…" : fixed(least, digits)} to ${fixed(greatest, digits)} ${unit}`;
  const share = margin === null ? 1 : margin / ((greatest - low) / 2);
  const level = margin !== null && margin < 0 ? "bad" : share < 0.1 ? "near" : "fine";
  const by = unit === "°C" ? "K" : unit;
  const end = least === null || greatest - value <= value - least ? "upper" : "lower";
  const words =
    margin === null
      ? value === null
        ? "no reading"
        : "old reading"
      : margin < 0
        ? `▲ beyond by ${fixed(-margin, digits)} ${by}`
        : `${level === "near" ? "▲ only " : ""}${fixed(margin, digits)} ${by} left to the cell's ${end} limit`;
  const at = value === null ? null : Math.max(0, Math.min(100, (100 * (value - low)) / (greatest - low)));
  const scale = el("div", { class: `meter ${level}`, role: "img", "aria-label": `${quantity}: ${words} of ${range}` });
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
    el("small", {}, unit === "A" ? `${range}; the step in work is judged tighter` : range),
  );
}

// How a run ended that this server began.
export function outcome(ended) {
  if (!ended.finished) return `✕ ${ended.how}`;
  if (ended.how !== "finished") return `✓ finished, but ${ended.how}`;
  // So older servers wrote it down.
  return ended.code === 11 ? "✓ finished, but the quality gate refused points" : "✓ finished";
}

export function drawRun(live, job, body) {
  const run = live.run;
  if (!run) {
    body.replaceChildren(el("p", { class: "quiet" }, "No run yet. Submit an experiment below."));
    return;
  }
  const point = run.point
    ? `point ${run.point.number} of ${run.point.of}, ${Number(run.point.freq_hz.toPrecision(4))} Hz`
    : "";
  const known = job && job.ended && run.ended === "finished" ? outcome(job.ended) : "✓ finished";
  const ended = run.going
    ? null
    : run.ended === "finished"
      ? known
      : `✕ ${run.ended || "its process ended without a word"}`;
  const percent = Math.round(100 * run.done);
  const progress = el("progress", { max: 100, value: percent, "aria-label": "share of the plan that is done" });
  const rows = [
    ["Experiment", `${run.experiment}${run.run ? ` (${run.run})` : ""}`],
    ["Stage", run.stage_number ? `${run.stage_number} of ${run.stages}: ${run.stage}` : "beginning"],
    [
      "Step",
      run.step_number && run.going ? `${run.step_number} of ${run.steps}: ${run.step.replace(/\s+/g, " ")}` : "–",
    ],
    ["Point in work", run.going && point ? point : "–"],
    ["Points", `${run.points_done} of ${run.points} finished`],
    ["Time left, by the clock", run.going ? (run.left_s === null ? "unknown" : `about ${duration(run.left_s)}`) : "–"],
  ];
  body.replaceChildren(
    el("div", { class: "progress" }, progress, el("b", {}, `${percent} %`)),
    el("dl", { class: "facts" }, ...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])),
    ...(ended
      ? [el("p", { class: run.ended !== "finished" ? "bad" : known === "✓ finished" ? "good" : "" }, ended)]
      : []),
  );
}

export function drawInstruments(live) {
  const now = live.run ? live.run.bench_time_s : 0;
  const going = live.run && live.run.going;
  $("instrumentrows").replaceChildren(
    ...live.instruments.map((one) => {
      const output =
        one.output === true
          ? el("b", { class: "on" }, "● ON")
          : one.output === false
            ? el("span", { class: "off" }, "○ off")
            : "–";
      const age =
        one.answered_s === null ? "–" : going ? `${duration(Math.max(0, now - one.answered_s))} ago` : "last run";
      const who = one.identity
        ? `${one.model}${one.recognised === false ? " ✕ another model answers" : ""}`
        : `${one.model} (not asked yet)`;
      const by =
        one.output_by === "guardian" ? "the guardian" : one.output_by === "stop" ? "the stop" : "eis-bench safe";
      const proven = one.output_by ? `read back by ${by}` : null;
      const answer = proven
        ? proven
        : one.trouble
          ? `▲ ${one.trouble}`
          : one.answered_s === null
            ? "not asked"
            : going
              ? `answered ${age}`
              : "in the last run";
      return el(
        "tr",
        { class: one.trouble ? "trouble" : "" },
        el("th", { scope: "row", title: one.role }, ROLES[one.role] || one.role),
        el("td", {}, output, el("small", {}, answer)),
        el("td", { title: one.identity || "" }, who, el("small", {}, one.address)),
      );
    }),
  );
}

// The worst is first: a person looks there.
const WORST = ["latched", "unknown", "stopping", "running", "paused", "idle"];

// All benches in a line, each with its address.
export function drawOverview(benches, chosen) {
  const rank = (one) => (WORST.indexOf(one.state) + WORST.length + 1) % (WORST.length + 1);
  const item = (one) => {
    const [sign] = STATES[one.state] || ["?"];
    const left = one.run && one.run.going && one.run.left_s !== null ? `, ${duration(one.run.left_s)} left` : "";
    // While a run or a stop is at work nothing is claimed of the outputs.
    const rests = ["idle", "latched", "unknown"].includes(one.state);
    const proof = !rests ? "" : one.verified ? ", outputs verified off" : ", outputs NOT verified";
    const words = `${sign} ${one.bench}: ${one.trip ? `latched, ${one.trip.cause}` : one.state}${left}${proof}`;
    const here = one.bench === chosen && !location.hash.startsWith("#/");
    return el(
      "li",
      {},
      el(
        "a",
        {
          href: `#${encodeURIComponent(one.bench)}`,
          class: `bench ${one.state}`,
          "aria-current": here ? "page" : null,
        },
        words,
      ),
    );
  };
  const sorted = [...benches].sort((a, b) => rank(a) - rank(b) || a.bench.localeCompare(b.bench));
  fill($("overview"), ...sorted.map(item));
}

// What the benches that are not shown want a person to know.
export function drawOthers(others, choose) {
  const loud = others.filter(
    (one) =>
      one.trip || one.state === "unknown" || (one.stop && one.stop.over && !one.stop.verified && !one.stop.simulated),
  );
  const words = loud.map((one) => [
    one.bench,
    one.trip
      ? `${one.bench} is latched: ${one.trip.cause}`
      : one.state === "unknown"
        ? `${one.bench}: nobody has verified that its outputs are off`
        : `${one.bench} was stopped, but not verified: LOOK AT THE BENCH`,
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
        el("strong", {}, "▲ "),
        `${text} `,
        el("button", { type: "button", onclick: () => choose(bench) }, `Show ${bench}`),
      ),
    ),
  );
}

// Benches that a stop of another one has left as they were, as long as current may flow on them: it
// stays until that is no longer so, or a person has read it.
export function drawMissed(benches, close) {
  const banner = $("missed");
  const words = benches
    .map((one) => `${one.bench} (${one.state === "latched" ? "latched, its outputs are not verified" : one.state})`)
    .join(", ");
  banner.hidden = !words;
  if (banner.dataset.key === words) return;
  banner.dataset.key = words;
  banner.replaceChildren(
    el("strong", {}, `▲ NOT stopped: ${words}. `),
    "STOP ALL stops every bench. ",
    el("button", { type: "button", onclick: close }, "Close this message"),
  );
}

// Nobody clears without saying who looked and what they found: it is kept with the trip.
function clearing(live, clear, lacks) {
  const said = el("input", {
    id: "found",
    required: true,
    maxlength: 1000,
    autocomplete: "off",
    placeholder: "name; what was found and done",
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
    el("label", {}, "Who looked, and what was found ", said),
    el("button", { type: "submit", disabled: Boolean(lacks) }, "I have looked: clear"),
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
    el("strong", {}, `▲ ${live.bench} is latched. `),
    `${live.trip.cause}${live.trip.step ? `, in step “${live.trip.step}”` : ""}. ` +
      `Found by the ${live.trip.by}, ${when(live.trip.unix_s)}. Look at the bench and at the cell. `,
    clearing(live, clear, lacks),
  );
}

export function drawStop(report) {
  const banner = $("stopped");
  banner.hidden = !report;
  if (!report) return;
  const head = !report.over
    ? `■ Stopping ${report.bench} …`
    : report.simulated
      ? `✓ Stopped ${report.bench}: it is simulated within the run's process, and that has ended. ` +
        "There is no output to read back."
      : report.verified
        ? `✓ Stopped ${report.bench}: every output is off, read back.`
        : `▲ ${report.bench} STOPPED, BUT NOT VERIFIED: LOOK AT THE BENCH.`;
  const key = `${report.bench} ${report.unix_s} ${report.over} ${report.verified} ${report.steps.length}`;
  if (banner.dataset.key === key) return;
  banner.dataset.key = key;
  banner.className = `banner ${!report.over ? "note" : report.verified || report.simulated ? "fine" : "bad"}`;
  banner.replaceChildren(
    el("strong", {}, head),
    ` By ${person(report.by)}, ${when(report.unix_s)}.`,
    el(
      "details",
      { open: report.over && !report.verified && !report.simulated },
      el("summary", {}, "What was done and read back"),
      el(
        "ul",
        {},
        ...report.steps.map((step) => el("li", {}, step)),
        ...report.outputs.map((output) =>
          el("li", { class: output.verified ? "" : "bad" }, `${output.verified ? "○" : "▲"} ${output.text}`),
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
            "Close this message",
          ),
        ]
      : []),
  );
}
