// The ageing of a cell, within its view: resistances and diffusion of fitted models over time, as the catalogue has
// them. Values at another temperature are marked and joined to none.
"use strict";

import { el, fill, isKnown, minus, saveBlob, text, when } from "./bench.js";
import { address, cell, keyed, table } from "./find.js";
import { bar, noCharts, overTime } from "./overtime.js";

const WORDS = {
  title: "Ageing, by fitted models",
  looking: "Looking …",
  none: "No fitted model of this cell is in the catalogue yet. A run is fitted at its end.",
  building: "The catalogue is being built.",
  again: "Ask again",
  failed: (why) => `▲ The ageing cannot be shown: ${why}`,
  rc: "RC pairs of the models",
  rcAuto: (rc) => `automatic: ${rc}`,
  rcOf: (rc) => `${rc} RC ${rc === 1 ? "pair" : "pairs"}`,
  rcHint:
    "Only models with the same number of RC pairs can be compared. Automatic: the greatest number that every run " +
    "has, otherwise the one that most runs have.",
  serial: "Serial number",
  serialAll: "all of this name",
  serialOf: (one, n) => `${one} (${n} ${n === 1 ? "run" : "runs"})`,
  serialsMixed: (n) =>
    `▲ ${n} serial numbers have this name: they are different cells and are not joined. Choose one.`,
  identity: { batch: (value) => `Batch ${value}. `, chemistry: (value) => `Chemistry: ${value}. ` },
  at: "Compare at",
  atGroup: (celsius, n) => `${celsius} °C (${n} ${n === 1 ? "value" : "values"})`,
  atNone: "temperature not known",
  within: "Within, K",
  count: (n, runs) => `${n} fitted ${n === 1 ? "model" : "models"} of ${runs} ${runs === 1 ? "run" : "runs"}.`,
  others: (n) =>
    ` ${n} ${n === 1 ? "is" : "are"} at another temperature, or at one that is not known: marked ◇, and not joined.`,
  bars: "Bars: ±1σ. A press on a mark, or the link in the table, opens its run.",
  voltage: "Resistances depend on the state of charge too: compare values at about the same voltage at rest.",
  fromFile: "A run in virtual time has no calendar: the time of its file is used instead.",
  quantities: {
    r: "R",
    dc: "DC resistance",
    slow: "R of the slowest RC pair",
    tau: "Time constant of the slowest RC pair",
  },
  parameter: (one) => `${one.effect}: ${one.name}`,
  axis: (name, unit) => (unit ? `${name} / ${unit}` : name),
  head: (name, unit) => `${name} ± 1σ${unit ? `, ${unit}` : ""}`,
  columns: { when: "When", run: "Run", bench: "Bench", temperature: "Temperature", ocv: "Voltage at rest" },
  celsius: (value) => `${value} °C`,
  volts: (value) => `${value} V`,
  other: "◇ other",
  unknown: "–",
  table: "Ageing of this cell",
  save: "Save as CSV",
};

// Values within this of each other are at one temperature unless a person says otherwise, K: a chamber holds its
// set-point and two sensors agree to some tenths of a kelvin.
const WITHIN_K = 1;
const MAX_PARAMETERS = 12;

const QUANTITIES = [
  ["r", "r_ohm", "r_sigma_ohm", 1e3, "mΩ", "--c0"],
  ["dc", "dc_resistance_ohm", "dc_resistance_sigma_ohm", 1e3, "mΩ", "--c1"],
  ["slow", "slow_r_ohm", "slow_r_sigma_ohm", 1e3, "mΩ", "--c2"],
  ["tau", "slow_tau_s", "slow_tau_sigma_s", 1, "s", "--c3"],
].map(([key, value, sigma, times, unit, colour]) => ({
  key,
  name: WORDS.quantities[key],
  unit,
  colour,
  times,
  columns: [value, sigma],
  of: (point) => ({ value: point[value], sigma: point[sigma] }),
}));

// Parameters of diffusion that a diagnosis of a run names.
function parameters(points) {
  const found = new Map();
  for (const one of points.flatMap((point) => point.diffusion)) {
    const key = JSON.stringify([one.effect, one.name, one.unit]);
    if (found.has(key)) continue;
    const isSame = (other) => other.effect === one.effect && other.name === one.name && other.unit === one.unit;
    const column = `${one.effect}_${one.name}`.replace(/\W+/g, "_");
    found.set(key, {
      key,
      name: WORDS.parameter(one),
      unit: one.unit,
      colour: "--c4",
      times: 1,
      columns: [column, `${column}_sigma`],
      of: (point) => point.diffusion.find(isSame) || {},
    });
  }
  return [...found.values()].slice(0, MAX_PARAMETERS);
}

// Groups temperatures that are equal within `within`, each with its points; the largest group first.
function groups(points, within) {
  const sorted = points.filter((one) => isKnown(one.temperature_c)).sort((a, b) => a.temperature_c - b.temperature_c);
  const found = [];
  for (const point of sorted) {
    const last = found[found.length - 1];
    if (last && point.temperature_c - last[0].temperature_c <= within) last.push(point);
    else found.push([point]);
  }
  const middle = (group) => group[Math.floor(group.length / 2)].temperature_c;
  return found
    .map((group) => ({ at: middle(group), points: new Set(group) }))
    .sort((a, b) => b.points.size - a.points.size);
}

// The ageing part of the view of a cell in the section `node`; `refresh()` requests the data again. A serial number may
// be selected.
export function ageing(name, serial, ctx) {
  const part = { name, ctx, got: null, cells: [], charts: new Map(), turn: 0 };
  part.said = el("p", { role: "status" }, WORDS.looking);
  part.identity = el("p", {});
  part.again = el("button", { type: "button", hidden: true, onclick: () => refresh(part) }, WORDS.again);
  const redraw = () => draw(part);
  part.rc = el("select", { onchange: () => refresh(part) });
  part.serial = el("select", { onchange: () => refresh(part) }, ...(serial ? [new Option(serial, serial)] : []));
  part.at = el("select", { onchange: redraw });
  part.within = el("input", { type: "number", min: 0.1, max: 100, step: 0.1, value: WITHIN_K, onchange: redraw });
  part.mixed = el("p", { class: "note" });
  part.hints = el("div", {});
  part.figures = el("div", { class: "fd-pair" });
  part.holder = el("div", {});
  part.save = el("button", { type: "button", onclick: () => save(part) }, WORDS.save);
  part.serialLabel = el("label", {}, WORDS.serial, part.serial);
  part.form = el(
    "div",
    { class: "fd-form" },
    el("label", {}, WORDS.rc, part.rc),
    part.serialLabel,
    el("label", {}, WORDS.at, part.at),
    el("label", {}, WORDS.within, part.within),
  );
  const lacking = noCharts() ? el("p", { class: "bad" }, noCharts()) : null;
  const acts = el("div", { class: "acts" }, part.save);
  part.body = el("div", { hidden: true }, lacking, part.figures, part.hints, part.holder, acts);
  const heading = el("h3", { id: "fd-ageing" }, WORDS.title);
  const again = el("div", { class: "acts" }, part.again);
  part.node = el(
    "section",
    { "aria-labelledby": "fd-ageing" },
    heading,
    part.identity,
    part.form,
    part.mixed,
    part.said,
    again,
    part.body,
  );
  part.watch = new ResizeObserver(() => part.charts.forEach(({ chart }) => chart.fit()));
  part.watch.observe(part.figures);
  return {
    node: part.node,
    refresh: () => refresh(part),
    close: () => close(part),
  };
}

function close(part) {
  part.turn += 1;
  part.watch.disconnect();
  part.charts.forEach(({ chart }) => chart.destroy());
}

async function refresh(part) {
  const turn = (part.turn += 1);
  const query = new URLSearchParams({ cell: part.name });
  if (part.serial.value) query.set("serial", part.serial.value);
  if (part.rc.value) query.set("rc", part.rc.value);
  try {
    const [got, { cells }] = await Promise.all([
      part.ctx.get(`/catalog/ageing?${query}`),
      part.ctx.get(`/catalog/cells?${new URLSearchParams({ cell: part.name })}`),
    ]);
    if (turn !== part.turn) return;
    Object.assign(part, { got, cells });
    part.again.hidden = true;
    take(part);
  } catch (error) {
    if (turn !== part.turn) return;
    const isBuilding = error instanceof part.ctx.Refused && error.status === 503;
    text(part.said, isBuilding ? WORDS.building : WORDS.failed(error.message));
    part.again.hidden = false;
  }
}

// Sets the options; the selected one stays while it exists.
function choose(select, choices) {
  const chosen = select.value;
  if (select.dataset.key === JSON.stringify(choices)) return;
  select.dataset.key = JSON.stringify(choices);
  select.replaceChildren(...choices.map(([value, words]) => new Option(words, value)));
  select.value = choices.some(([value]) => value === chosen) ? chosen : choices.length ? choices[0][0] : "";
}

function take(part) {
  const { got, cells } = part;
  const serials = cells.filter((one) => one.serial);
  // The automatic choice is shown with its result.
  const own = part.rc.value ? part.ownRc : got.rc;
  part.ownRc = own;
  choose(part.rc, [["", WORDS.rcAuto(own ?? WORDS.unknown)], ...got.orders.map((rc) => [String(rc), WORDS.rcOf(rc)])]);
  const choices = serials.map((one) => [one.serial, WORDS.serialOf(one.serial, one.runs)]);
  // A link may name a serial number that no longer exists.
  const chosen = part.serial.value;
  if (chosen && !choices.some(([value]) => value === chosen)) choices.push([chosen, WORDS.serialOf(chosen, 0)]);
  choose(part.serial, [["", WORDS.serialAll], ...choices]);
  part.serialLabel.hidden = choices.length < 2;
  // A cell without serial numbers is identified by its name only.
  const meant = cells.filter((one) => !part.serial.value || one.serial === part.serial.value);
  const valuesOf = (key) => [...new Set(meant.map((one) => one[key]).filter(Boolean))].join(", ");
  const words = ["batch", "chemistry"].map((key) => (valuesOf(key) ? WORDS.identity[key](valuesOf(key)) : ""));
  text(part.identity, words.join("").trim());
  part.identity.hidden = !part.identity.textContent;
  part.form.hidden = !got.orders.length && !part.serial.value;
  draw(part);
}

// Returns the points with their reference points.
function marked(part) {
  const { points } = part.got;
  const within = Math.max(0.1, Number(part.within.value) || WITHIN_K);
  const found = groups(points, within);
  const choices = found.map(({ at, points: same }) => [at.toFixed(2), WORDS.atGroup(at.toFixed(1), same.size)]);
  choose(part.at, choices.length ? choices : [["", WORDS.atNone]]);
  const chosen = found.find(({ at }) => at.toFixed(2) === part.at.value);
  // Without a known temperature the difference is undefined.
  return points.map((point) => ({ ...point, isSame: chosen ? chosen.points.has(point) : true }));
}

function draw(part) {
  if (!part.got) return;
  part.shown = marked(part);
  part.quantities = [...QUANTITIES, ...parameters(part.shown)].filter((quantity) =>
    part.shown.some((point) => isKnown(quantity.of(point).value)),
  );
  part.body.hidden = !part.shown.length;
  const others = part.shown.filter((point) => !point.isSame).length;
  const runs = new Set(part.shown.map((point) => point.run)).size;
  text(
    part.said,
    part.shown.length ? WORDS.count(part.shown.length, runs) + (others ? WORDS.others(others) : "") : WORDS.none,
  );
  drawHints(part);
  drawFigures(part);
  drawTable(part);
}

function drawHints(part) {
  text(part.mixed, isMixed(part) ? WORDS.serialsMixed(part.cells.filter((one) => one.serial).length) : "");
  part.mixed.hidden = !part.mixed.textContent;
  const lines = [WORDS.bars, WORDS.rcHint, WORDS.voltage];
  if (part.shown.some((point) => point.time_source === "file")) lines.push(WORDS.fromFile);
  fill(part.hints, ...lines.map((words) => el("p", { class: "quiet" }, words)));
}

// Whether several cells are shown, which have one name.
const isMixed = (part) => !part.serial.value && part.cells.filter((one) => one.serial).length > 1;

// Draws a chart for each quantity, and removes obsolete charts.
function drawFigures(part) {
  if (noCharts()) return;
  const there = new Set(part.quantities.map((one) => one.key));
  for (const [key, { chart, node }] of part.charts)
    if (!there.has(key)) {
      chart.destroy();
      node.remove();
      part.charts.delete(key);
    }
  for (const quantity of part.quantities) {
    if (!part.charts.has(quantity.key)) part.charts.set(quantity.key, figure(part, quantity));
    const point = (one) => ({
      unix_s: one.started_unix_s,
      ...bar(quantity.of(one), quantity.times),
      mark: one.isSame ? "good" : "other",
      joined: one.isSame && !isMixed(part),
      href: address("run", one.name),
    });
    const points = part.shown.filter((one) => isKnown(quantity.of(one).value)).map(point);
    part.charts.get(quantity.key).chart.show(points);
  }
}

function figure(part, quantity) {
  const holder = el("div", { "aria-hidden": "true" });
  const node = el("figure", {}, el("figcaption", { class: "fd-caption" }, quantity.name), holder);
  part.figures.append(node);
  const look = { name: WORDS.axis(quantity.name, quantity.unit), axis: quantity.unit, colour: quantity.colour };
  return { node, chart: overTime(holder, look) };
}

// ---- the table ----------------------------------------------------------------------------------

const digits = (value, count) => minus(value.toPrecision(count));

function figureOf(quantity, point) {
  const { value, sigma } = quantity.of(point);
  if (!isKnown(value)) return WORDS.unknown;
  const spread = isKnown(sigma) ? ` ± ${digits(quantity.times * sigma, 2)}` : "";
  return digits(quantity.times * value, 4) + spread;
}

function drawTable(part) {
  const heads = part.quantities.map((one) => WORDS.head(one.name, one.unit));
  const all = [...Object.values(WORDS.columns), ...heads];
  const key = JSON.stringify(all);
  if (part.holder.dataset.key !== key) {
    part.holder.dataset.key = key;
    part.rows = el("tbody", {});
    const node = table(WORDS.table, all, part.rows);
    node.classList.add("fd-tall");
    part.holder.replaceChildren(node);
  }
  const row = (point) =>
    el(
      "tr",
      {},
      ...factsOf(point),
      ...part.quantities.map((one, place) =>
        cell(heads[place], el("span", { class: "fd-figure" }, figureOf(one, point))),
      ),
    );
  // The latest entries come first, because they matter most.
  keyed(part.rows, [...part.shown].reverse(), (point) => JSON.stringify([point.run, point.file]), row);
}

function factsOf(point) {
  const { run, bench, temperature, ocv } = WORDS.columns;
  const other = point.isSame ? null : el("b", { class: "note" }, ` ${WORDS.other}`);
  const celsius = isKnown(point.temperature_c) ? WORDS.celsius(digits(point.temperature_c, 4)) : WORDS.unknown;
  return [
    el("th", { scope: "row" }, when(point.started_unix_s)),
    cell(run, el("div", { class: "fd-name" }, el("a", { href: address("run", point.name) }, point.name))),
    cell(bench, point.bench),
    cell(temperature, celsius, other),
    cell(ocv, isKnown(point.ocv_v) ? WORDS.volts(point.ocv_v.toFixed(4)) : WORDS.unknown),
  ];
}

// ---- saving -------------------------------------------------------------------------------------

// RFC 4180. A table program would run a text that begins like a formula.
const quoted = (value) => {
  const isFormula = typeof value === "string" && /^[=+\-@\t\r]/.test(value);
  const words = `${isFormula ? "'" : ""}${value ?? ""}`;
  return /[",\r\n]/.test(words) ? `"${words.replaceAll('"', '""')}"` : words;
};

const FACTS = ["started_unix_s", "time_source", "run", "name", "file", "bench", "cell", "rc", "temperature_c", "ocv_v"];

function csv(part) {
  const heads = [...FACTS, "same_temperature", ...part.quantities.flatMap((one) => one.columns)];
  const row = (point) => [
    ...FACTS.map((fact) => point[fact]),
    point.isSame,
    ...part.quantities.flatMap((one) => [one.of(point).value, one.of(point).sigma]),
  ];
  return [heads, ...part.shown.map(row)].map((line) => `${line.map(quoted).join(",")}\r\n`).join("");
}

function save(part) {
  const name = `ageing-${part.name}-${part.got.rc}rc.csv`.replace(/[^\w.-]+/g, "_");
  saveBlob(new Blob([csv(part)], { type: "text/csv" }), name);
}
