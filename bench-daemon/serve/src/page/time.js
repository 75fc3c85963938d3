// A run over time: voltage, current, temperature, chiller and charge as strips with one time, their limits, the bounds
// of the step, and what happened. Drawn by uPlot; numbers are those of the server, thinned without losing a peak.
"use strict";

import { $, axis, decimals, duration, el, fill, ink as colour } from "./bench.js";

const uPlot = window.uPlot;
const RECENT_S = 300;
const MOST = 2000;
const HEIGHT = 190;
// Between two readings that lie further apart than this, or 20 times the usual, no line is drawn, s.
const GAP_S = 30;
// Of one ampere-hour, C.
const AH_C = 3600;
// Rows of the table of what happened, the latest.
const TOLD = 50;
// Bounds of the step are in sight where they lie beyond the readings by no more than this share of the strip.
const BOUNDS_SHARE = 0.5;
// Room above the readings for the letters, as a share of the strip.
const LETTER_SHARE = 0.12;
// A letter closer to another one than this is left out, and a tick of a step is so long, CSS px.
const LETTER_PX = 15;
const TICK_PX = 7;
// Between two lines of the hatching of a pause, CSS px.
const HATCH_PX = 10;

const WORDS = {
  none: "–",
  strips: {
    voltage_v: "Voltage / V",
    current_a: "Current / A (charge +)",
    temperature_c: "Cell temperature / °C",
    bath_c: "Chiller, bath / °C",
    charge_mah: "Charge since the beginning / mAh",
  },
  time: "time / s",
  setpoint: "setpoint / °C",
  notRead: "not read",
  noReading: "no reading",
  nothingYet: "No reading yet.",
  nothingHere: "No reading in this part of the run.",
  span: (from, to) => `${from} to ${to} of bench time`,
  between: (low, high, unit) => `${low} to ${high} ${unit}`,
  at: (value) => `, setpoint ${value} °C`,
  said: (span, of) =>
    `${span}; voltage ${of.voltage_v}; current ${of.current_a}; temperature ${of.temperature_c}; ` +
    `chiller ${of.bath_c}; charge ${of.charge_mah}.`,
  rows: (rows, whole) => ` ${rows} readings${whole ? "" : ", thinned: every peak is kept"}.`,
  kinds: {
    stage: "stage",
    step: "step",
    point: "point",
    check: "check",
    again: "again",
    note: "note",
    request: "request",
    pause: "pause",
    go_on: "goes on",
    resumed: "resumed",
    trip: "trip",
    end: "end",
  },
  key: "Signs in the strips",
  limit: "limit of the cell",
  bound: "limit of this step",
  tables: "The strips as a table",
  numbers: "Values in this part of the run, and the bounds at its end",
  quantity: "Quantity",
  least: "Least",
  greatest: "Greatest",
  last: "Last",
  limits: "Limits of the cell",
  bounds: "Limits of the steps",
  happened: "What happened, the latest first",
  when: "Bench time",
  sign: "Sign",
  what: "What",
  paused: (text, lasted) => `${text}; waits for ${lasted}`,
};

// Key, ink, unit, digits; the setpoint of the chiller is a second line.
const STRIPS = [
  { key: "voltage_v", ink: "--c0", unit: "V", digits: 4 },
  { key: "current_a", ink: "--c1", unit: "A", digits: 3 },
  { key: "temperature_c", ink: "--c2", unit: "°C", digits: 2 },
  { key: "bath_c", ink: "--c4", unit: "°C", digits: 2, setpoint: "--c5" },
  { key: "charge_mah", ink: "--c3", unit: "mAh", digits: 2 },
];
// Quantities that have limits and bounds.
const BOUNDED = ["voltage_v", "current_a", "temperature_c"];
// Letter, colour and dashes of each kind of event. Earlier entries keep their letter if there is not enough room for
// all.
const SIGNS = {
  trip: ["T", "--bad", []],
  pause: ["P", "--note", []],
  go_on: ["G", "--note", []],
  end: ["E", "--ink", []],
  resumed: ["D", "--note", [3, 3]],
  request: ["R", "--note", [3, 3]],
  stage: ["S", "--quiet", []],
  check: ["C", "--note", [3, 3]],
  again: ["A", "--note", [3, 3]],
  note: ["N", "--note", [3, 3]],
  point: ["•", "--accent", [1, 3]],
};
const LIMIT_DASH = [8, 4];
const BOUND_DASH = [2, 3];

const shown = {
  run: "",
  part: "recent",
  zoom: null,
  asked: 0,
  readings: null,
  times: new Map(),
  charts: [],
  limits: [],
};

const lastOf = (list) => list[list.length - 1];
const isNumber = (value) => value !== null && value !== undefined;
// Avoids −0.
const fixed = (value, digits) =>
  isNumber(value) ? value.toFixed(digits).replace(/^-(?=[0.]*$)/, "") : WORDS.none;
// With the sign for minus, as in tables and strips.
const minus = (value, digits) => fixed(value, digits).replace("-", "−");
const kindOf = (mark) => WORDS.kinds[mark.kind] || mark.kind;

// What is asked for: the last minutes, the whole run, or a stretch that was chosen with the mouse.
function query() {
  if (shown.zoom) return `most=${MOST}&from_s=${shown.zoom[0]}&to_s=${shown.zoom[1]}`;
  if (shown.part === "recent" && shown.readings)
    return `most=${MOST}&from_s=${Math.max(0, shown.readings.end_s - RECENT_S)}`;
  return `most=${MOST}`;
}

// ---- signs in a strip ---------------------------------------------------------------------------

// Draws within the area of a strip.
function inside(chart, draw) {
  const { ctx, bbox } = chart;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.lineWidth = devicePixelRatio;
  draw(ctx, bbox);
  ctx.restore();
}

const dashed = (ctx, dashes) => ctx.setLineDash(dashes.map((length) => length * devicePixelRatio));

// One path for all lines: a strip may have some thousands.
function lines(ctx, list) {
  ctx.beginPath();
  for (const [x0, y0, x1, y1] of list) {
    ctx.moveTo(x0, y0);
    ctx.lineTo(x1, y1);
  }
  ctx.stroke();
}

// Pauses lie behind the readings, hatched.
function bands(chart) {
  if (!shown.readings) return;
  inside(chart, (ctx, { left, top, width, height }) => {
    ctx.strokeStyle = colour("--note");
    ctx.fillStyle = colour("--noteground");
    for (const pause of shown.readings.pauses) {
      const from = Math.max(left, chart.valToPos(pause.from_s, "x", true));
      const to = Math.min(left + width, chart.valToPos(pause.to_s, "x", true));
      if (to <= from) continue;
      ctx.save();
      ctx.beginPath();
      ctx.rect(from, top, to - from, height);
      ctx.clip();
      ctx.fillRect(from, top, to - from, height);
      const slants = [];
      for (let x = from - height; x < to; x += HATCH_PX * devicePixelRatio)
        slants.push([x, top + height, x + height, top]);
      ctx.globalAlpha = 0.35;
      lines(ctx, slants);
      ctx.restore();
    }
  });
}

// Where something of a kind happened, rounded to a pixel and each only once.
function places(chart, kind, { left, width }) {
  const all = new Set();
  for (const time_s of shown.times.get(kind) || []) {
    const x = Math.round(chart.valToPos(time_s, "x", true));
    if (x >= left && x <= left + width) all.add(x);
  }
  return [...all];
}

// Times of the marks by kind: each strip asks for them whenever it is drawn.
function timesByKind(marks) {
  const all = new Map();
  for (const { kind, time_s } of marks) {
    if (!all.has(kind)) all.set(kind, []);
    all.get(kind).push(time_s);
  }
  return all;
}

function letter(ctx, text, x, y, ink) {
  const size = LETTER_PX * devicePixelRatio;
  ctx.fillStyle = colour("--card");
  ctx.fillRect(x - size / 2, y, size, size);
  ctx.strokeStyle = ink;
  ctx.strokeRect(x - size / 2, y, size, size);
  ctx.fillStyle = ink;
  ctx.font = `bold ${11 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.fillText(text, x, y + size / 2);
}

// Draws vertical lines at events, with a letter at the top, or a tick if the room is too small: many dashed lines
// would be slow to draw, and would hide the readings.
function events(chart, ctx, box) {
  const bottom = box.top + box.height;
  const [tick, near] = [TICK_PX * devicePixelRatio, LETTER_PX * devicePixelRatio];
  const ticks = places(chart, "step", box).map((x) => [x, bottom - tick, x, bottom]);
  const signed = [];
  for (const [kind, [sign, ink, dashes]] of Object.entries(SIGNS)) {
    const tall = [];
    for (const x of places(chart, kind, box)) {
      // At the edge of the strip, the letter stays inside.
      const middle = Math.min(Math.max(x, box.left + near / 2 + 1), box.left + box.width - near / 2 - 1);
      const isFree = signed.every((other) => Math.abs(other.middle - middle) >= near);
      if (isFree) signed.push({ sign, middle, ink: colour(ink) });
      if (isFree || kind === "trip") tall.push([x, box.top, x, bottom]);
      else ticks.push([x, box.top, x, box.top + tick]);
    }
    ctx.strokeStyle = colour(ink);
    ctx.lineWidth = (kind === "trip" ? 2.5 : 1) * devicePixelRatio;
    dashed(ctx, dashes);
    lines(ctx, tall);
  }
  ctx.lineWidth = devicePixelRatio;
  dashed(ctx, []);
  ctx.strokeStyle = colour("--quiet");
  lines(ctx, ticks);
  for (const { sign, middle, ink } of signed) letter(ctx, sign, middle, box.top + devicePixelRatio, ink);
}

const limitsOf = ({ unit, key }) =>
  BOUNDED.includes(key) ? shown.limits.filter((one) => one.unit === unit) : [];

// Draws the limits of the cell over the whole strip, and the bounds of each step for its duration.
function limits(chart, ctx, box, one) {
  const y = (value) => Math.round(chart.valToPos(value, "y", true));
  const right = box.left + box.width;
  const across = limitsOf(one).flatMap((limit) => [limit.least, limit.greatest]);
  dashed(ctx, LIMIT_DASH);
  ctx.strokeStyle = colour("--bad");
  lines(ctx, across.filter(isNumber).map((value) => [box.left, y(value), right, y(value)]));
  if (!BOUNDED.includes(one.key)) return;
  const held = [];
  for (const key of ["least", "greatest"]) {
    for (const envelope of shown.readings.envelopes) {
      const value = envelope[one.key][key];
      if (!isNumber(value)) continue;
      const from = Math.max(box.left, Math.round(chart.valToPos(envelope.from_s, "x", true)));
      const to = Math.min(right, Math.round(chart.valToPos(envelope.to_s, "x", true)));
      const last = lastOf(held);
      // Steps shorter than a pixel, or with equal bounds, are drawn as one line.
      if (last && last[1] === y(value) && last[2] >= from) last[2] = Math.max(last[2], to);
      else held.push([from, y(value), to, y(value)]);
    }
  }
  dashed(ctx, BOUND_DASH);
  ctx.lineWidth = 1.5 * devicePixelRatio;
  ctx.strokeStyle = colour("--ink");
  lines(ctx, held);
}

const signs = (one) => ({
  hooks: {
    drawClear: [bands],
    draw: [
      (chart) => {
        if (!shown.readings) return;
        inside(chart, (ctx, box) => {
          ctx.save();
          limits(chart, ctx, box, one);
          ctx.restore();
          events(chart, ctx, box);
        });
      },
    ],
  },
});

// ---- strips -------------------------------------------------------------------------------------

// From the least to the greatest reading, and to bounds of the step that are not far from them.
function range(one, low, high) {
  if (!isNumber(low) || !isNumber(high)) return [low, high];
  let [least, greatest] = uPlot.rangeNum(low, high, 0.1, true);
  const beyond = BOUNDS_SHARE * (greatest - least);
  const pad = 0.05 * (greatest - least);
  const [lowest, highest] = [least - beyond, greatest + beyond];
  const envelopes = BOUNDED.includes(one.key) && shown.readings ? shown.readings.envelopes : [];
  for (const envelope of envelopes) {
    const bounds = envelope[one.key];
    if (isNumber(bounds.least) && bounds.least >= lowest) least = Math.min(least, bounds.least - pad);
    if (isNumber(bounds.greatest) && bounds.greatest <= highest)
      greatest = Math.max(greatest, bounds.greatest + pad);
  }
  return [least, greatest + LETTER_SHARE * (greatest - least)];
}

const labels = (_chart, ticks, _axis, _space, step) => ticks.map((value) => minus(value, decimals(step)));

function strip(parent, one, choose) {
  const holder = el("div", { class: "strip" });
  parent.append(holder);
  const line = (label, ink) => ({
    label,
    stroke: () => colour(ink),
    width: 1.5,
    value: (_, value) => minus(value, one.digits),
  });
  // So few that a line would hide which there are.
  const points = { show: (chart) => chart.data[0].length < 40, size: 5 };
  const series = [
    { label: WORDS.time, value: (_, value) => fixed(value, 1) },
    { ...line(WORDS.strips[one.key], one.ink), points },
  ];
  if (one.setpoint) {
    const paths = uPlot.paths.stepped({ align: 1 });
    series.push({ ...line(WORDS.setpoint, one.setpoint), dash: [6, 3], paths, points: { show: false } });
  }
  const options = {
    width: Math.max(260, holder.clientWidth),
    height: HEIGHT,
    cursor: { sync: { key: "time" }, drag: { x: true, y: false, setScale: false } },
    scales: { x: { time: false }, y: { range: (_, low, high) => range(one, low, high) } },
    series,
    axes: [
      axis({ size: 32 }),
      axis({ size: 60, values: labels }),
    ],
    plugins: [signs(one)],
    hooks: {
      setSelect: [
        (chart) => {
          const { left, width } = chart.select;
          if (width < 4) return;
          choose([chart.posToVal(left, "x"), chart.posToVal(left + width, "x")]);
        },
      ],
    },
  };
  const chart = new uPlot(options, series.map(() => []), holder);
  chart.over.addEventListener("dblclick", () => choose(null));
  shown.charts.push({ one, chart, holder });
}

// Readings further apart than this are not joined, s.
function gapOf(times) {
  const usual = (lastOf(times) - times[0]) / Math.max(1, times.length - 1);
  return Math.max(GAP_S, 20 * usual);
}

// The readings of one quantity; long gaps between readings are left empty.
function line(readings, key) {
  const [times, values] = [[], []];
  const gap = gapOf(readings.time_s);
  readings.time_s.forEach((time, k) => {
    if (readings[key][k] === null) return;
    const last = lastOf(times);
    if (times.length && time - last > gap) {
      times.push((last + time) / 2);
      values.push(null);
    }
    times.push(time);
    values.push(readings[key][k]);
  });
  return [times, values];
}

// The bath and its setpoint, which holds between readings, and up to the end of the part.
function bathLines({ bath }, end_s) {
  const [times, read, set] = [[], [], []];
  const push = (time, value, setpoint) => {
    times.push(time);
    read.push(value);
    set.push(setpoint);
  };
  const gap = gapOf(bath.time_s);
  bath.time_s.forEach((time, k) => {
    const last = lastOf(times);
    if (times.length && time - last > gap) push((last + time) / 2, null, lastOf(set));
    push(time, bath.bath_c[k], bath.setpoint_c[k]);
  });
  if (times.length && lastOf(times) < end_s) push(end_s, null, lastOf(set));
  return [times, read, set];
}

// As wide as there is room; needs no server.
export function fitTime() {
  for (const { chart, holder } of shown.charts) {
    if (holder.hidden) continue;
    const width = Math.max(260, holder.clientWidth);
    if (Math.abs(chart.width - width) > 1) chart.setSize({ width, height: HEIGHT });
  }
}

// ---- beside the strips --------------------------------------------------------------------------

const valuesOf = (readings, { key }) => (key === "bath_c" ? readings.bath.bath_c : readings[key]).filter(isNumber);

function spread(values, { digits, unit }) {
  if (!values.length) return WORDS.notRead;
  return WORDS.between(fixed(Math.min(...values), digits), fixed(Math.max(...values), digits), unit);
}

// Text alternative of the strips for screen readers.
function words(readings) {
  if (!readings.time_s.length && !readings.bath.time_s.length) return shown.zoom ? WORDS.nothingHere : WORDS.nothingYet;
  const of = Object.fromEntries(STRIPS.map((one) => [one.key, spread(valuesOf(readings, one), one)]));
  const setpoint = lastOf(readings.bath.setpoint_c);
  if (isNumber(setpoint)) of.bath_c += WORDS.at(fixed(setpoint, 2));
  const span = readings.time_s.length
    ? WORDS.span(duration(readings.time_s[0]), duration(lastOf(readings.time_s)))
    : WORDS.noReading;
  return WORDS.said(span, of) + WORDS.rows(readings.rows, readings.whole);
}

// Describes the letters and lines of the strips as text, for visible events only.
function legend(readings) {
  const kinds = new Set(readings.marks.map((mark) => mark.kind));
  const item = (sign, text) => el("li", {}, sign, ` ${text}`);
  const rows = Object.entries(SIGNS)
    .filter(([kind]) => kinds.has(kind))
    .map(([kind, [sign]]) => item(el("b", { class: `strip-sign strip-${kind}` }, sign), WORDS.kinds[kind]));
  if (kinds.has("step")) rows.push(item(el("i", { class: "strip-line strip-step" }), WORDS.kinds.step));
  if (readings.pauses.length && !kinds.has("pause"))
    rows.push(item(el("b", { class: "strip-sign strip-pause" }, SIGNS.pause[0]), WORDS.kinds.pause));
  if (shown.limits.length) rows.push(item(el("i", { class: "strip-line" }), WORDS.limit));
  if (readings.envelopes.length) rows.push(item(el("i", { class: "strip-line strip-bound" }), WORDS.bound));
  return rows;
}

function table(id, caption, heads) {
  const row = el("tr", {}, ...heads.map((head) => el("th", { scope: "col" }, head)));
  const body = el("tbody", { id });
  return el("table", {}, el("caption", {}, caption), el("thead", {}, row), body);
}

const cells = (list) => list.map((value) => el("td", {}, value));

// Least, greatest and last value of each quantity, its limits, and its bounds at the end.
function numbers(readings) {
  const envelope = lastOf(readings.envelopes);
  const pair = (bounds, digits) =>
    bounds ? `${minus(bounds.least, digits)} … ${minus(bounds.greatest, digits)}` : WORDS.none;
  return STRIPS.map((one) => {
    const values = valuesOf(readings, one);
    const extremes = values.length ? [Math.min(...values), Math.max(...values)] : [null, null];
    const bounded = BOUNDED.includes(one.key);
    const row = [...extremes, lastOf(values)].map((value) => minus(value, one.digits));
    row.push(pair(limitsOf(one)[0], one.digits));
    row.push(pair(bounded && envelope ? envelope[one.key] : null, one.digits));
    return el("tr", {}, el("th", { scope: "row" }, WORDS.strips[one.key]), ...cells(row));
  });
}

// Lists events, without steps, which are many; a pause with its duration.
function happened(readings) {
  const text = (mark) => {
    const pause = mark.kind === "pause" && readings.pauses.find((one) => one.from_s === mark.time_s);
    const of = `${kindOf(mark)}, ${mark.text}`;
    return pause ? WORDS.paused(of, duration(pause.to_s - pause.from_s)) : of;
  };
  const marks = readings.marks.filter((mark) => mark.kind !== "step").slice(-TOLD).reverse();
  const sign = (mark) => (SIGNS[mark.kind] || [WORDS.none])[0];
  return marks.map((mark) => el("tr", {}, ...cells([duration(mark.time_s), sign(mark), text(mark)])));
}

// The key above the strips, and the tables below them, are made with the strips.
function frame(parent) {
  parent.before(el("ul", { id: "timekey", class: "strip-key", "aria-label": WORDS.key }));
  const { quantity, least, greatest, last, limits, bounds } = WORDS;
  const values = table("timenumbers", WORDS.numbers, [quantity, least, greatest, last, limits, bounds]);
  const marks = table("timehappened", WORDS.happened, [WORDS.when, WORDS.sign, WORDS.what]);
  const scroll = (attributes, child) => el("div", { class: "scroll", tabindex: "0", ...attributes }, child);
  const list = $("timemarks");
  const summary = el("summary", {}, WORDS.tables);
  list.closest("details").after(el("details", { class: "strip-tables" }, summary, scroll({}, values)));
  list.replaceWith(scroll({ id: "timemarks", class: "scroll strip-marks" }, marks));
}

// Events of this part are visible: a run ends, and trips, some seconds after its last reading.
function stretch({ time_s, marks }) {
  const times = [time_s[0], lastOf(time_s), marks[0]?.time_s, lastOf(marks)?.time_s].filter(isNumber);
  if (!times.length) return [0, 1];
  const [start, end] = [Math.min(...times), Math.max(...times)];
  return [start, end > start ? end : start + 1];
}

// Draws each strip in a separate task, so that the page stays responsive.
async function drawStrips(readings) {
  const [start, end] = stretch(readings);
  for (const { one, chart } of shown.charts) {
    // All strips show one time interval.
    chart.setData(one.key === "bath_c" ? bathLines(readings, end) : line(readings, one.key), false);
    chart.batch(() => {
      chart.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      chart.setScale("x", { min: start, max: end });
    });
    await new Promise((done) => setTimeout(done));
    // Newer readings have come meanwhile, or another run.
    if (shown.readings !== readings) return;
  }
}

async function draw(choose) {
  const { readings } = shown;
  const parent = $("strips");
  if (!shown.charts.length) {
    frame(parent);
    STRIPS.forEach((one) => strip(parent, one, choose));
  }
  const timesOf = ({ key }) => (key === "bath_c" ? readings.bath.time_s : readings.time_s);
  for (const { one, holder } of shown.charts) holder.hidden = !timesOf(one).length;
  fitTime();
  $("timesaid").textContent = words(readings);
  $("zoomout").hidden = !shown.zoom;
  fill($("timekey"), ...legend(readings));
  fill($("timenumbers"), ...numbers(readings));
  fill($("timehappened"), ...happened(readings));
  await drawStrips(readings);
}

// Removes the previous run from strips and tables.
function empty() {
  $("timesaid").textContent = WORDS.nothingYet;
  if (!shown.charts.length) return;
  for (const { holder } of shown.charts) holder.hidden = true;
  for (const id of ["timekey", "timenumbers", "timehappened"]) fill($(id));
}

// Shows a run; `get` sends requests to the server. Can be called again at any time: the latest request counts, and a
// late reply is dropped.
export async function drawTime(get, run, limits) {
  $("time").hidden = !run;
  if (!run || !uPlot) return;
  if (shown.run !== run) Object.assign(shown, { run, zoom: null, readings: null });
  shown.limits = limits;
  const choose = (stretch) => {
    shown.zoom = stretch;
    drawTime(get, run, limits);
  };
  $("zoomout").onclick = () => choose(null);
  for (const name of ["recent", "whole"]) {
    $(name).setAttribute("aria-pressed", String(shown.part === name && !shown.zoom));
    $(name).onclick = () => {
      shown.part = name;
      choose(null);
    };
  }
  const asked = (shown.asked += 1);
  try {
    if (!shown.readings) shown.readings = await get(`/runs/${run}/readings?most=8`);
    const readings = await get(`/runs/${run}/readings?${query()}`);
    if (asked !== shown.asked || shown.run !== run) return;
    readings.charge_mah = readings.charge_c.map((charge) => (1000 * charge) / AH_C);
    shown.readings = readings;
    shown.times = timesByKind(readings.marks);
    await draw(choose);
  } catch {
    // A run without readings; the caller reports a lost server.
    if (asked === shown.asked && !shown.readings) empty();
  }
}
