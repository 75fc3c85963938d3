// View `#/catalog?of=…`: runs, spectra and cells across all measurements, found by common conditions. Ticked runs or
// spectra are overlaid.
"use strict";

import { el, isKnown, minus, text, when } from "./bench.js";
import { address, begin, calmly, cell, curve, keyed, named, names, runCells, runHeads, shelf, table } from "./find.js";
import { comparing } from "./run.js";

const WORDS = {
  title: "Catalogue",
  of: "Look for",
  kinds: { runs: "Runs", spectra: "Spectra", cells: "Cells" },
  fields: {
    text: "Free text",
    cell: "Cell",
    serial: "Serial number",
    bench: "Bench",
    verdict: "Verdict of the run",
    model: "Kind of model",
    tag: "Tag",
    from: "From day",
    to: "To day",
  },
  hint: "name, experiment, note …",
  any: "any",
  find: "Find",
  clear: "Show all",
  copy: "Copy link",
  copied: "The link is copied.",
  copyByHand: "This browser does not let pages copy; the link is selected, copy it by hand.",
  link: "Link to what is found",
  more: "Show more",
  looking: "Looking …",
  building: "The catalogue is being built: ask again in a moment.",
  daysSwapped: "Nothing found: the first day lies after the last one.",
  none: "Nothing found.",
  nothingYet: "Nothing was measured yet.",
  found: (count, more, shown, kind) =>
    `${more ? "More than " : ""}${count} ${kind[count === 1 && !more ? 0 : 1]} found, ${shown} shown.`,
  nouns: { runs: ["run", "runs"], spectra: ["spectrum", "spectra"], cells: ["cell", "cells"] },
  compare: "Compare",
  compareOne: (name) => `Compare ${name}`,
  hints: {
    runs: (most) => `Tick up to ${most} runs to compare their spectra.`,
    spectra: (most) => `Tick up to ${most} spectra, of several runs, to draw them together.`,
  },
  full: (most) => `${most} are ticked, which is the maximum: untick one to tick another.`,
  compared: "Spectra compared",
  takeOut: (name) => `Take out ${name}`,
  loading: "The spectra are being loaded …",
  overlay: (curves, ticked) => `${curves} ${curves === 1 ? "spectrum" : "spectra"} of ${ticked} ticked.`,
  left: (n) => ` ${n} more are left out to keep the plot readable.`,
  without: (all) => ` Without a spectrum: ${all.join(", ")}.`,
  notLoaded: (all) => ` Could not be loaded: ${all.join(", ")}.`,
  spectrumOf: (run, name) => `${run}: ${name}`,
  unknown: "–",
  spectra: {
    spectrum: "Spectrum",
    cell: "Cell",
    bench: "Bench",
    when: "Measured",
    temperature: "Temperature",
    ocv: "Voltage at rest",
    band: "Frequencies",
    high: "R high ± 1σ",
    low: "R low ± 1σ",
    points: "Points",
  },
  refused: (points, refused) => `${points}${refused ? `, ▲ ${refused} refused` : ""}`,
  fileTime: "time of the file",
  repeat: (n) => `repeat ${n}`,
  cells: {
    cell: "Cell",
    serial: "Serial number",
    batch: "Batch",
    chemistry: "Chemistry",
    runs: "Runs",
    first: "First measured",
    last: "Last measured",
  },
  cellRuns: (n, cell) => `${n} ${n === 1 ? "run" : "runs"} with ${cell}`,
  celsius: (value) => `${value} °C`,
  volts: (value) => `${value} V`,
  milliohm: (value) => `${value} mΩ`,
  hertz: (low, high) => `${low} to ${high} Hz`,
};

const FIELDS = Object.keys(WORDS.fields);
// A map is the one kind of model that runs are found by.
const MAP = "map";
const VERDICTS = ["good", "doubtful", "stopped", "failed", "unfinished", "damaged"];
const MOST_TICKED = { runs: 12, spectra: 24 };
// Maximum number of curves that can be distinguished.
const MOST_CURVES = 24;
// Number of rows that are added at a time, and number of rows that are requested.
const ROWS = 20;
const ASKED = 100;
const TYPING_MS = 300;

let view = null;

const figure = (value, digits, words) =>
  isKnown(value) ? words(minus(value.toFixed(digits))) : WORDS.unknown;
// The name of a spectrum is that of its file.
const stem = (file) => file.replace(/\.csv$/, "");

// ---- kinds of results -----------------------------------------------------------------------------

const cellLink = (name, serial) => {
  const query = serial ? `?${new URLSearchParams({ serial })}` : "";
  return el("a", { href: `${address("cell", name)}${query}` }, name);
};

function resistance(value, sigma) {
  const spread = isKnown(sigma) ? ` ± ${(1e3 * sigma).toPrecision(2)}` : "";
  return isKnown(value) ? WORDS.milliohm((1e3 * value).toPrecision(4) + spread) : WORDS.unknown;
}

function spectrumCells(one) {
  const heads = WORDS.spectra;
  const band = isKnown(one.low_hz) && isKnown(one.high_hz);
  const hertz = (value) => String(Number(value.toPrecision(3)));
  const source = one.time_source === "file" ? el("small", {}, WORDS.fileTime) : null;
  return [
    el(
      "th",
      { scope: "row" },
      el("div", { class: "fd-name" }, el("a", { href: address("run", one.name) }, one.name)),
      el("small", {}, `${named(stem(one.file))}, ${WORDS.repeat(one.repeat)}`),
    ),
    names(heads.cell, cellLink(one.cell)),
    names(heads.bench, one.bench),
    cell(heads.when, when(one.started_unix_s), source),
    cell(heads.temperature, figure(one.temperature_c, 1, WORDS.celsius)),
    cell(heads.ocv, figure(one.ocv_v, 4, WORDS.volts)),
    cell(heads.band, band ? WORDS.hertz(hertz(one.low_hz), hertz(one.high_hz)) : WORDS.unknown),
    cell(heads.high, resistance(one.r_high_ohm, one.r_high_sigma_ohm)),
    cell(heads.low, resistance(one.r_low_ohm, one.r_low_sigma_ohm)),
    cell(heads.points, WORDS.refused(one.points, one.refused_points)),
  ];
}

// Link to the runs with a cell.
const runsOf = ({ cell: name, serial }) =>
  `#/catalog?${new URLSearchParams(serial ? { cell: name, serial } : { cell: name })}`;

function cellCells(one) {
  const heads = WORDS.cells;
  const link = el("a", { href: runsOf(one), "aria-label": WORDS.cellRuns(one.runs, one.cell) }, String(one.runs));
  return [
    el("th", { scope: "row" }, el("div", { class: "fd-name" }, cellLink(one.cell, one.serial))),
    names(heads.serial, one.serial || WORDS.unknown),
    names(heads.batch, one.batch || WORDS.unknown),
    names(heads.chemistry, one.chemistry || WORDS.unknown),
    cell(heads.runs, link),
    cell(heads.first, when(one.first_unix_s)),
    cell(heads.last, when(one.last_unix_s)),
  ];
}

// Each kind with the heads and cells of its rows, its key, and, if its rows can be ticked, their display name. Its
// name is that of its route and of the list in the reply.
const KINDS = {
  runs: {
    heads: runHeads,
    cells: runCells,
    key: (run) => run.run,
    name: (run) => run.name,
    run: (run) => run.name,
  },
  spectra: {
    heads: () => Object.values(WORDS.spectra),
    cells: spectrumCells,
    key: (one) => JSON.stringify([one.run, one.file]),
    name: (one) => WORDS.spectrumOf(one.name, named(stem(one.file))),
    run: (one) => one.name,
  },
  cells: {
    heads: () => Object.values(WORDS.cells),
    cells: cellCells,
    key: (one) => JSON.stringify([one.cell, one.serial]),
  },
};

const kind = () => KINDS[view.kind];
const canTick = () => Boolean(kind().name);
const most = () => MOST_TICKED[view.kind];

// ---- the form -----------------------------------------------------------------------------------

function field(name, query) {
  const kinds = { text: "search", serial: "search", from: "date", to: "date" };
  const value = query.get(name) || "";
  const input = kinds[name]
    ? el("input", { name, type: kinds[name], value, placeholder: name === "text" ? WORDS.hint : null })
    : el("select", { name });
  if (!kinds[name]) choices(input, [], value);
  return el("label", { "data-field": name }, WORDS.fields[name], input);
}

// Sets the options. The selected value stays, because a link may name a value that no longer exists.
function choices(select, values, chosen = select.value) {
  const all = [...new Set([...(chosen ? [chosen] : []), ...values])].sort((a, b) => a.localeCompare(b));
  const key = JSON.stringify(all);
  if (select.dataset.values !== key) {
    select.replaceChildren(new Option(WORDS.any, ""), ...all.map((one) => new Option(one, one)));
    select.dataset.values = key;
  }
  select.value = chosen;
}

// Returns the conditions of the form in the format of the address.
function asked() {
  const value = (name) => view.form.elements[name].value.trim();
  const filled = FIELDS.filter(value);
  return new URLSearchParams(filled.map((name) => [name, value(name)]));
}

// Returns the midnight, local time, at which a day begins, or that of `later` days after it, s since 1970.
function midnight(day, later) {
  const [year, month, date] = day.split("-").map(Number);
  return new Date(year, month - 1, date + later).getTime() / 1e3;
}

// Returns the conditions in the format of the server: whole days as seconds.
function request() {
  const query = asked();
  const [from, to, model] = ["from", "to", "model"].map((name) => query.get(name));
  for (const name of ["from", "to", "model"]) query.delete(name);
  if (model === MAP) query.set("map", "true");
  if (from) query.set("from_s", midnight(from, 0));
  if (to) query.set("to_s", midnight(to, 1));
  query.set("most", ASKED);
  return query;
}

function here() {
  const query = asked();
  if (view.kind !== "runs") query.set("of", view.kind);
  return `#/catalog${String(query) ? `?${query}` : ""}`;
}

// If the page cannot copy, which browsers allow with https only, the link is shown for manual copying.
async function copy() {
  const link = location.href;
  try {
    await navigator.clipboard.writeText(link);
    text(view.copied, WORDS.copied);
  } catch {
    text(view.copied, WORDS.copyByHand);
    view.link.hidden = false;
    const input = view.link.querySelector("input");
    input.value = link;
    input.focus();
    input.select();
  }
}

function clear() {
  for (const name of FIELDS) view.form.elements[name].value = "";
  search();
}

function kindChoice() {
  const radio = (name) =>
    el(
      "label",
      { class: "fd-radio" },
      el("input", { type: "radio", name: "of", value: name, checked: name === view.kind }),
      WORDS.kinds[name],
    );
  const onchange = (event) => become(event.target.value);
  return el("fieldset", { class: "fd-kinds", onchange }, el("legend", {}, WORDS.of), ...Object.keys(KINDS).map(radio));
}

function form(query) {
  const button = (words, onclick) => el("button", { type: "button", onclick }, words);
  view.form = el(
    "form",
    {
      class: "fd-form",
      role: "search",
      onsubmit: (event) => {
        event.preventDefault();
        search();
      },
      oninput: (event) => {
        if (event.target.name === "of") return;
        clearTimeout(view.typing);
        view.typing = setTimeout(search, TYPING_MS);
      },
    },
    kindChoice(),
    ...FIELDS.map((name) => field(name, query)),
    el("div", { class: "acts" }, el("button", {}, WORDS.find), button(WORDS.clear, clear), button(WORDS.copy, copy)),
  );
  view.copied = el("p", { class: "quiet fd-line", role: "status" });
  // Outside the form, because it is not a search condition.
  view.link = el("label", { class: "fd-link", hidden: true }, WORDS.link, el("input", { readonly: true }));
  return el("section", {}, view.form, view.copied, view.link);
}

// Searches for another kind of object, with the present conditions as far as they apply.
function become(name) {
  Object.assign(view, { kind: name, found: [], more: null, shown: ROWS });
  view.ticked.clear();
  makeTable();
  compare();
  search();
}

// ---- finding ------------------------------------------------------------------------------------

// Requests pages until there are `least` rows or no more; starts at a cursor, if given.
async function collect(least, after) {
  const mine = view;
  const query = request();
  const name = mine.kind;
  const all = { found: [], more: after };
  do {
    if (all.more) query.set("after", all.more);
    const got = await mine.ctx.get(`/catalog/${name}?${query}`);
    Object.assign(all, { more: got.after, found: [...all.found, ...got[name]] });
  } while (all.more && all.found.length < least);
  return all;
}

// Offers the cells, benches and tags that can be chosen.
async function offer() {
  const mine = view;
  const got = await mine.ctx.get("/catalog/choices").catch(() => null);
  if (!got || view !== mine) return;
  const { cells, benches, tags } = got;
  const { elements } = view.form;
  choices(elements.cell, cells);
  choices(elements.bench, benches);
  choices(elements.tag, tags);
}

// Searches by the conditions of the form; a late reply is dropped.
async function search() {
  const mine = view;
  clearTimeout(mine.typing);
  history.replaceState(history.state, "", here());
  text(mine.copied, "");
  mine.link.hidden = true;
  const turn = (mine.turn += 1);
  const isBuilding = (error) => error instanceof mine.ctx.Refused && error.status === 503;
  const got = await mine.ctx.attempt(() =>
    collect(1, null).catch((error) => {
      if (!isBuilding(error)) throw error;
      text(mine.said, WORDS.building);
      return null;
    }),
  );
  if (view !== mine || turn !== mine.turn) return;
  if (!got) return;
  mine.shown = ROWS;
  take(got, []);
}

// Repeats the search after an event, with the present number of rows.
async function again() {
  const mine = view;
  const turn = (mine.turn += 1);
  const got = await collect(mine.found.length, null).catch(() => null);
  if (!got || view !== mine || turn !== mine.turn) return;
  take(got, []);
  await offer();
}

async function more() {
  const mine = view;
  const before = mine.shown;
  if (before + ROWS > mine.found.length && mine.more) {
    const turn = (mine.turn += 1);
    const got = await mine.ctx.attempt(() => collect(1, mine.more));
    if (!got || view !== mine || turn !== mine.turn) return;
    take(got, mine.found);
  }
  mine.shown = before + ROWS;
  drawFound();
  const first = mine.rows.children[before];
  if (mine.moreButton.hidden && first) first.querySelector("a").focus();
}

function take(got, before) {
  const { key } = kind();
  const there = new Set(before.map(key));
  view.found = [...before, ...got.found.filter((one) => !there.has(key(one)))];
  view.more = got.more;
  drawFound();
}

function describeResults(shown) {
  const { from, to } = view.form.elements;
  const nouns = WORDS.nouns[view.kind];
  if (view.found.length) return WORDS.found(view.found.length, view.more, shown, nouns);
  if (from.value && to.value && from.value > to.value) return WORDS.daysSwapped;
  return String(asked()) ? WORDS.none : WORDS.nothingYet;
}

// Creates the table of the selected kind.
function makeTable() {
  view.rows = el("tbody", {});
  const heads = [...(canTick() ? [WORDS.compare] : []), ...kind().heads()];
  view.tableHolder.replaceChildren(table(WORDS.kinds[view.kind], heads, view.rows));
  view.results.hidden = true;
  view.moreButton.hidden = true;
  text(view.said, WORDS.looking);
}

function drawFound() {
  const rows = view.found.slice(0, view.shown);
  const isFull = canTick() && view.ticked.size >= most();
  const row = (one) => el("tr", {}, canTick() ? cell(WORDS.compare, tick(one, isFull)) : null, ...kind().cells(one));
  keyed(view.rows, rows, kind().key, row, view.form.elements.text);
  // A box that was ticked keeps its node, so its state is set here: `checked` is not an attribute.
  for (const box of view.rows.querySelectorAll("input")) box.checked = view.ticked.has(box.value);
  view.results.hidden = !rows.length;
  view.full.hidden = !canTick();
  if (canTick()) text(view.full, isFull ? WORDS.full(most()) : WORDS.hints[view.kind](most()));
  text(view.said, describeResults(rows.length));
  view.moreButton.hidden = rows.length >= view.found.length && !view.more;
}

function tick(one, isFull) {
  const key = kind().key(one);
  return el("input", {
    type: "checkbox",
    value: key,
    "aria-label": WORDS.compareOne(kind().name(one)),
    "aria-describedby": "fd-full",
    disabled: isFull && !view.ticked.has(key),
    onchange: (event) => {
      if (event.target.checked) view.ticked.set(key, one);
      else view.ticked.delete(key);
      drawFound();
      compare();
    },
  });
}

// ---- comparing ----------------------------------------------------------------------------------

// Returns the corrected spectra of a run, otherwise all of its spectra; or a spectrum itself.
function chosen(one, spectra) {
  if (view.kind === "spectra") return spectra.filter((spectrum) => spectrum.name === stem(one.file));
  const corrected = spectra.filter((spectrum) => spectrum.corrected);
  return corrected.length ? corrected : spectra;
}

function drawTicked() {
  view.compared.hidden = !view.ticked.size;
  const chip = ([key, one]) =>
    el(
      "li",
      {},
      el("a", { href: address("run", kind().run(one)) }, kind().name(one)),
      el("button", { type: "button", "aria-label": WORDS.takeOut(kind().name(one)), onclick: () => untick(key) }, "✕"),
    );
  const spare = view.rows.querySelector("input") || view.form.elements.text;
  keyed(view.chips, [...view.ticked], ([key]) => key, chip, spare);
}

function untick(key) {
  view.ticked.delete(key);
  drawFound();
  compare();
}

// Loads only the spectra of ticked rows, and draws them.
async function compare() {
  const mine = view;
  drawTicked();
  const turn = (mine.comparison += 1);
  if (!mine.ticked.size) return;
  mine.panel ||= comparing(mine.ctx, mine.holder);
  const ticked = [...mine.ticked.values()];
  const late = setTimeout(() => text(mine.overlaid, WORDS.loading), TYPING_MS);
  const got = await Promise.all(ticked.map((one) => mine.shelf.of(kind().run(one)).catch(() => null)));
  clearTimeout(late);
  if (view === mine && turn === mine.comparison) overlay(ticked, got);
}

function overlay(ticked, got) {
  const each = Math.max(1, Math.floor(MOST_CURVES / ticked.length));
  const spectra = ticked.map((one, place) => chosen(one, got[place] || []));
  const curves = ticked.flatMap((one, place) => {
    const run = kind().run(one);
    return spectra[place].slice(0, each).map((found) => curve(run, found, WORDS.spectrumOf(run, named(found.name))));
  });
  view.panel.show({ curves, models: [] });
  const left = spectra.reduce((sum, one) => sum + Math.max(0, one.length - each), 0);
  const called = (isMeant) => ticked.filter((_, place) => isMeant(place)).map((one) => kind().name(one));
  const failed = called((place) => !got[place]);
  const empty = called((place) => got[place] && !spectra[place].length);
  text(
    view.overlaid,
    WORDS.overlay(curves.length, ticked.length) +
      (left ? WORDS.left(left) : "") +
      (empty.length ? WORDS.without(empty) : "") +
      (failed.length ? WORDS.notLoaded(failed) : ""),
  );
}

// ---- the view -----------------------------------------------------------------------------------

function build(parent, query) {
  view.said = el("p", { role: "status" }, WORDS.looking);
  view.full = el("p", { class: "quiet", id: "fd-full" });
  view.moreButton = el("button", { type: "button", hidden: true, onclick: more }, WORDS.more);
  view.tableHolder = el("div", {});
  view.results = el("div", { hidden: true }, view.full, view.tableHolder);
  view.chips = el("ul", { class: "fd-chips" });
  view.holder = el("div", {});
  view.overlaid = el("p", { class: "quiet", role: "status" });
  view.compared = el(
    "section",
    { hidden: true, "aria-labelledby": "fd-compared" },
    el("h3", { id: "fd-compared" }, WORDS.compared),
    view.chips,
    view.overlaid,
    view.holder,
  );
  begin(
    parent,
    WORDS.title,
    form(query),
    el("section", {}, view.said, view.results, el("div", { class: "acts" }, view.moreButton)),
    view.compared,
  );
}

export async function open(parent, { query }, ctx) {
  const wanted = query.get("of");
  view = { kind: Object.hasOwn(KINDS, wanted) ? wanted : "runs", ctx, found: [], more: null, shown: ROWS };
  Object.assign(view, { ticked: new Map(), turn: 0, comparison: 0, shelf: shelf(ctx) });
  Object.assign(view, { calm: calmly(again), calmCurves: calmly(compare) });
  const mine = view;
  build(parent, query);
  choices(view.form.elements.verdict, VERDICTS);
  choices(view.form.elements.model, [MAP]);
  makeTable();
  await search();
  if (view === mine) await offer();
}

export function heard(event, data) {
  if (!view) return;
  if (["catalog", "hello", "lost"].includes(event)) view.calm.now();
  // The curve of a run that is compared grows, or is corrected in the end.
  const run = event === "spectrum" ? data.run : event === "run" ? data.item.run : "";
  if (run && [...view.ticked.values()].some((one) => kind().run(one) === run)) {
    view.shelf.forget(run);
    view.calmCurves.now();
  }
}

export function close() {
  if (!view) return;
  clearTimeout(view.typing);
  for (const calm of [view.calm, view.calmCurves]) calm.end();
  view = null;
}
