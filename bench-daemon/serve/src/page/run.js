// View `#/run/NAME`: one run, its spectra with their models, the capture behind each point, its campaign, its files,
// and its notes.
"use strict";

import {
  $, axis, decimals, duration, el, fill, ink, minus, outcome, person, saveBlob, size, text, when,
} from "./bench.js";
import {
  address,
  begin,
  calmly,
  cell,
  cellLinks,
  controls,
  curve,
  keyed,
  lack,
  named,
  plot,
  table,
  verdict,
} from "./find.js";
import { notes } from "./notes.js";

const WORDS = {
  title: (run) => `Run ${run}`,
  looking: "Looking …",
  missing: (run) => `This server has no run ${run}.`,
  waits: (run) => `${run} waits in the queue, or is just beginning: it is shown as soon as it has begun.`,
  facts: "What it is",
  fact: {
    state: "State",
    progress: "Done",
    stage: "Stage",
    bench: "Bench",
    cells: "Cells",
    experiment: "Experiment",
    by: "By",
    submitted: "Submitted",
    ended: "Ended",
    verdict: "Verdict",
    seed: "Seed",
    resume: "To go on",
  },
  unknown: "–",
  inWork: "▶ in work",
  left: (time) => `, about ${time} left`,
  stage: (n, of, words) => `${n} of ${of}: ${words}`,
  resumable: "can go on where it was interrupted",
  seen: (bench) => `${bench}: readings, limits and the strips over time`,
  acts: "What to do with it",
  repeat: "Repeat as it was",
  analyses: { diagnose: "Diagnose", fit: "Fit", kk: "Kramers–Kronig" },
  investigate: "Investigate until it is clear…",
  analysisOf: (name) =>
    `Fit and Kramers–Kronig take the spectrum that is chosen: ${name}; a diagnosis takes all that its cell has.`,
  analysisOfRun: "Fit and Kramers–Kronig take all spectra of the run that are corrected.",
  noSpectrum: "No spectrum yet.",
  fileTooLong: (bytes) => `expected at most ${MOST_FILE_BYTES} bytes, found ${bytes}`,
  notReached: (why) => `the server was not reached (${why})`,
  spectra: "Spectra",
  choose: "Spectrum",
  all: (n) => `all ${n} that are corrected`,
  asRead: " (as read)",
  points: (n) => `${n} ${n === 1 ? "point" : "points"}`,
  models: (n) => (n ? `; ${n} ${n === 1 ? "model" : "models"}` : "; no model was fitted to it"),
  modelsLost: "; its models could not be loaded",
  modelsOfOne: ". Choose one to see its models",
  openPoint: ". Click a point, or press Enter at it, to see the capture behind it.",
  campaign: "Campaign",
  matrix: "Spectra of the campaign: cells and repeats",
  repeatHead: (n) => `Repeat ${n}`,
  cellHead: "Cell",
  done: (done, all) => `${done} of ${all} are done. Press one that is done to see its spectrum.`,
  states: {
    good: ["✓", "good"],
    doubtful: ["▲", "doubtful"],
    done: ["✓", "done"],
    "in work": ["▶", "in work"],
    "to do": ["○", "to do"],
    none: ["–", "not planned"],
  },
  place: (cell, repeat, state) => `${cell}, repeat ${repeat}: ${state}`,
  map: "Map over charge and temperature",
  mapPicture: "Series resistance, and with all branches, over state of charge, a line for each temperature",
  mapRange: (soc, degc) =>
    `Measured from ${(100 * soc[0]).toFixed(0)} to ${(100 * soc.at(-1)).toFixed(0)} % of charge, ` +
    `${minus(degc.map((value) => value.toFixed(1)).join(", "))} °C.`,
  mapPack: "Put a load on a pack of this cell",
  mapTables: { "map_logs.csv": "Errors on logs", "map_spectra.csv": "Errors on spectra" },
  mapHeads: {
    log: "Log",
    spectrum: "Spectrum",
    soc: "State of charge",
    temperature_degc: "Temperature / °C",
    rms_mv: "Error, rms / mV",
    left_out_rms_mv: "Left out of the fit / mV",
    worst_mv: "Worst tenth of charge / mV",
    error_percent: "Error / %",
    left_out_percent: "Left out of the fit / %",
  },
  report: "Save the report",
  files: "Report and files",
  noReport: "No report yet.",
  noFile: "No file yet.",
  folder: (name, n, size) => `${name}: ${n} ${n === 1 ? "file" : "files"}, ${size}`,
  top: "In the folder of the run",
  saveFile: (path, size) => `Save ${path}, ${size}`,
  log: "Log",
  noLog: "The log is empty.",
  logFailed: "The log could not be read.",
  tags: "Tags",
  noTag: "No tag yet.",
  tag: "New tag",
  addTag: "Add the tag",
  removeTag: (tag) => `Remove the tag ${tag}`,
  tagRule: "A tag has 1 to 40 letters, digits, - and _.",
  tagsFull: "20 tags are the most.",
  tagsUnknown: "The tags of this run are not known.",
  tagAdded: (tag) => `The tag ${tag} is added.`,
  tagRemoved: (tag) => `The tag ${tag} is removed.`,
  capture: (freq) => `Capture at ${freq}`,
  captureOf: (name) => `Spectrum ${name}`,
  close: "Close",
  captureLoading: "The capture is being loaded …",
  noCapture: "No capture of this point is kept.",
  captureFailed: (why) => `The capture could not be loaded: ${why}`,
  figures: "Figures of the capture",
  figureHeads: {
    channel: "Channel",
    samples: "Samples",
    amplitude: "Amplitude of the fit, zero to peak",
    residual: "Residual, rms",
    share: "Residual / amplitude",
    clipped: "Clipped",
  },
  clipped: (n) => `▲ ${n} ${n === 1 ? "sample" : "samples"}`,
  notClipped: "✓ none",
  captureFile: (path) => `Kept in ${path}.`,
  overTime: "measured and fit over time",
  time: "time",
  frequency: "frequency / Hz",
  measured: "measured",
  fit: "fit",
  residual: "residual",
  value: "value",
  amplitude: "amplitude",
  noCharts: "The part of the page that draws charts is missing; the figures are above.",
};

const ANALYSES = {
  diagnose: {},
  fit: { rc: "auto" },
  kk: { drt: false },
};
const REPORT = "report.html";
const MAP_PICTURE = "map.svg";
const MAP_FILES = ["map.json", ...Object.keys(WORDS.mapTables), MAP_PICTURE, "map.png"];
const TAG = /^[\p{L}\p{N}_-]{1,40}$/u;
const MOST_TAGS = 20;
// Maximum number of spectra that can be distinguished in one plot.
const MOST_CURVES = 12;
const LOG_LINES = 200;
// The longest file of spectra that the server reads; and how long it may take over a slow line.
const MOST_FILE_BYTES = 8e6;
const FILE_PATIENCE_MS = 60000;

let view = null;

const path = (...more) => ["/runs", encodeURIComponent(view.run), ...more].join("/");
const query = (values) => new URLSearchParams(values).toString();
// A part that a run may not have, or not yet.
const orNone = (ctx, asked, none) =>
  asked.catch((error) => {
    if (error instanceof ctx.Refused && error.status === 404) return none;
    throw error;
  });

// ---- properties of the run ----------------------------------------------------------------------

// Fetches the summary of this run: its cells, its verdict and its tags, together with all existing tags.
async function findCard(ctx, run) {
  const choices = ctx.get("/catalog/choices").catch(() => ({ tags: [] }));
  const [reply, { tags }] = await Promise.all([ctx.get(`/runs/${encodeURIComponent(run)}`), choices]);
  return { card: reply.card, tags };
}
function state({ job, now }) {
  if (job && job.ended) return outcome(job.ended);
  if (now && now.going) return WORDS.inWork;
  if (view.card) return view.card.how === "in work" ? WORDS.inWork : view.card.how;
  return (now && now.ended) || WORDS.unknown;
}

function factRows() {
  const { info, card } = view;
  const item = info.job ? info.job.item : {};
  const names = WORDS.fact;
  const bench = item.bench || (card && card.bench);
  const experiment = item.experiment || (card && card.experiment) || (info.now && info.now.experiment);
  const by = item.by || (card && card.by);
  const ended = info.job && info.job.ended ? info.job.ended.unix_s : card && card.ended_unix_s;
  return [
    [names.state, state(info)],
    [names.verdict, card ? verdict(card.verdict) : null],
    ...progressRows(info.now),
    [names.bench, bench ? el("a", { href: `#${encodeURIComponent(bench)}` }, WORDS.seen(bench)) : null],
    [names.cells, card && card.cells.length ? el("span", {}, ...cellLinks(card.cells)) : null],
    [names.experiment, experiment ? el("a", { href: address("files", "experiments", experiment) }, experiment) : null],
    [names.by, by ? person(by) : null],
    [names.submitted, when(item.submitted_unix_s || (card && card.submitted_unix_s))],
    [names.ended, ended ? when(ended) : null],
    ...(item.seed === null || item.seed === undefined ? [] : [[names.seed, String(item.seed)]]),
    ...(info.resumable ? [[names.resume, WORDS.resumable]] : []),
  ];
}

function progressRows(now) {
  if (!now || !now.going) return [];
  const percent = Math.round(100 * now.done);
  const left = now.left_s === null ? "" : WORDS.left(duration(now.left_s));
  const meter = el("progress", { max: 100, value: percent, "aria-label": WORDS.fact.progress });
  return [
    [WORDS.fact.progress, el("span", {}, meter, ` ${percent} %${left}`)],
    [WORDS.fact.stage, WORDS.stage(now.stage_number, now.stages, now.stage)],
  ];
}

function drawFacts() {
  keyed(
    view.facts,
    factRows(),
    ([name]) => name,
    ([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value ?? WORDS.unknown)),
  );
}

// ---- actions ------------------------------------------------------------------------------------

function acts() {
  const { ctx, run } = view;
  const why = lack(ctx, "operate");
  view.analyse = Object.entries(WORDS.analyses).map(([kind, words]) =>
    el(
      "button",
      { type: "button", disabled: true, "aria-describedby": "fd-actsaid", onclick: () => analyse(kind) },
      words,
    ),
  );
  view.actsSaid = el("p", { id: "fd-actsaid", class: "quiet fd-line" }, why || WORDS.noSpectrum);
  const repeat = el("button", { type: "button", onclick: () => ctx.go(address("new", "run", run)) }, WORDS.repeat);
  const form = `#/analyses?investigate=${encodeURIComponent(run)}`;
  const investigate = el("a", { href: form }, WORDS.investigate);
  const all = el("div", { class: "acts" }, repeat, ...view.analyse, investigate);
  return section("fd-acts", WORDS.acts, all, view.actsSaid);
}

function drawActs() {
  const why = lack(view.ctx, "operate");
  const ready = !why && view.spectra.length > 0;
  for (const button of view.analyse) button.disabled = !ready;
  const one = only();
  text(
    view.actsSaid,
    why || (!ready ? WORDS.noSpectrum : one ? WORDS.analysisOf(named(one.name)) : WORDS.analysisOfRun),
  );
}

async function analyse(kind) {
  const mine = view;
  const one = only();
  // A diagnosis uses the whole run; for a campaign, it uses the cell whose spectrum is selected.
  const place = mine.campaign && one ? mine.campaign.runs.find((run) => run.spectrum === one.name) : null;
  const body =
    kind === "diagnose"
      ? { kind, runs: [mine.run], options: place ? { cell: place.cell } : {} }
      : { kind, runs: [mine.run], ...(one ? { spectra: [one.name] } : {}), options: ANALYSES[kind] };
  const begun = await mine.ctx.attempt(() => mine.ctx.post("/analyses", body));
  if (begun && view === mine) mine.ctx.go(address("analysis", begun.id));
}

// ---- spectra ------------------------------------------------------------------------------------

const ALL = "*";
const corrected = () => view.spectra.filter((one) => one.corrected);

// The spectra that are chosen.
function shown() {
  if (view.chosen === ALL) return corrected().slice(0, MOST_CURVES);
  return view.spectra.filter((one) => one.name === view.chosen);
}

// The one that is chosen, unless all are.
const only = () => (view.chosen === ALL ? null : shown()[0]);

// Returns the initial selection: the latest spectrum of a campaign, otherwise the corrected one.
function preferred() {
  const done = view.campaign ? view.campaign.runs.filter((one) => one.spectrum && one.state === "done") : [];
  const last = done[done.length - 1];
  if (last && view.spectra.some((one) => one.name === last.spectrum)) return last.spectrum;
  const first = corrected()[0] || view.spectra[0];
  return first ? first.name : "";
}

function drawChoice() {
  // A visible curve is not removed; but a corrected spectrum replaces the raw one.
  if (!shown().length || (!view.byHand && !only().corrected)) view.chosen = preferred();
  const many = corrected().length;
  const options = view.spectra.map((one) => [one.name, named(one.name) + (one.corrected ? "" : WORDS.asRead)]);
  if (many > 1 && many <= MOST_CURVES) options.push([ALL, WORDS.all(many)]);
  const key = JSON.stringify(options);
  if (view.select.dataset.options !== key) {
    view.select.replaceChildren(...options.map(([value, words]) => new Option(words, value)));
    view.select.dataset.options = key;
  }
  view.select.value = view.chosen;
  view.spectraBody.hidden = !view.spectra.length;
  view.spectraNone.hidden = view.spectra.length > 0;
}

function chooseSpectrum(name) {
  view.byHand = true;
  view.chosen = name;
  drawSpectra();
}

// Draws the available data, and again when the models have arrived; until then with the previous models.
async function drawSpectra() {
  const mine = view;
  drawChoice();
  drawCampaign();
  drawActs();
  if (!mine.spectra.length) return;
  mine.panel ||= comparing(mine.ctx, mine.holder, showCapture);
  const one = only();
  showCurves(one ? mine.models.get(one.name) : []);
  // Raw spectra are not fitted.
  if (!one || !one.corrected || mine.asked.has(one.name)) return;
  mine.asked.add(one.name);
  const asked = mine.ctx.get(path("models") + `?${query({ spectrum: one.name })}`);
  const models = await orNone(mine.ctx, asked, []).catch(() => null);
  if (view !== mine) return;
  mine.models.set(one.name, models);
  if (only() && only().name === one.name) showCurves(models);
}

// Null if they could not be loaded, undefined while they are loading.
function modelWords(models) {
  if (models === null) return WORDS.modelsLost;
  return models ? WORDS.models(models.length) : "";
}

function showCurves(models) {
  const curves = shown().map((one) => curve(view.run, one, named(one.name)));
  view.panel.show({ curves, models: (models || []).map((one) => ({ ...one, curve: curves[0].id })) });
  const points = curves.reduce((sum, one) => sum + one.points.length, 0);
  const fitted = curves.length > 1 ? WORDS.modelsOfOne : modelWords(models);
  text(view.spectraSaid, WORDS.points(points) + fitted + WORDS.openPoint);
}

function spectraSection() {
  view.select = el("select", { onchange: (event) => chooseSpectrum(event.target.value) });
  view.holder = el("div", {});
  view.spectraSaid = el("p", { class: "quiet", role: "status" });
  view.spectraNone = el("p", { class: "quiet" }, WORDS.looking);
  const choose = el("div", { class: "acts" }, el("label", {}, WORDS.choose, view.select));
  view.spectraBody = el("div", { hidden: true }, choose, view.spectraSaid, view.holder);
  return section("fd-spectra", WORDS.spectra, view.spectraNone, view.spectraBody);
}

// The spectra of a file that somebody has brought, which the server reads and does not keep.
function fileReader(ctx) {
  return async (file) => {
    if (file.size > MOST_FILE_BYTES) throw new Error(WORDS.fileTooLong(file.size));
    const init = {
      method: "POST",
      // A page of elsewhere cannot send the second one.
      headers: { "Content-Type": "application/octet-stream", "X-Eis-Bench": "page" },
      body: file,
      signal: AbortSignal.timeout(FILE_PATIENCE_MS),
    };
    const response = await fetch(`/api/v1/spectra/read?${query({ name: file.name })}`, init).catch((error) => {
      throw new Error(WORDS.notReached(error.message));
    });
    if (response.ok) return response.json();
    throw new ctx.Refused(response.status, await response.json().catch(() => ({})));
  };
}

// The panel of the spectra, which are compared with files too.
export function comparing(ctx, holder, onPoint) {
  const panel = plot(holder, onPoint);
  if (panel.offerFiles) panel.offerFiles(fileReader(ctx));
  return panel;
}

// ---- the campaign -------------------------------------------------------------------------------

function drawCampaign() {
  const { campaign } = view;
  view.campaignSection.hidden = !campaign;
  if (!campaign) return;
  const repeats = Array.from({ length: campaign.repeats }, (_, place) => place + 1);
  fill(
    view.matrixHead,
    el("th", { scope: "col" }, WORDS.cellHead),
    ...repeats.map((n) => el("th", { scope: "col" }, WORDS.repeatHead(n))),
  );
  // Of a place that was done again, the latest.
  const places = new Map(campaign.runs.map((one) => [JSON.stringify([one.cell, one.repeat]), one]));
  const row = (one) =>
    el(
      "tr",
      {},
      el("th", { scope: "row" }, ...cellLinks([one])),
      ...repeats.map((n) => el("td", {}, place(places.get(JSON.stringify([one.name, n])), one.name, n))),
    );
  keyed(view.matrix, campaign.cells, (one) => one.name, row);
  const done = campaign.runs.filter((one) => one.state === "done").length;
  text(view.campaignSaid, WORDS.done(done, campaign.cells.length * campaign.repeats));
  const chosen = campaign.runs.find((one) => one.spectrum && one.spectrum === view.chosen);
  text(view.placeSaid, chosen ? WORDS.place(chosen.cell, chosen.repeat, chosen.words) : "");
}

// An entry of the matrix: its outcome as symbol, word and colour; it shows its spectrum if there is one.
function place(one, name, repeat) {
  const state = one ? (one.state === "done" && one.verdict) || one.state : "none";
  const [sign, words] = WORDS.states[state] || ["?", state];
  const there = Boolean(one && one.spectrum && view.spectra.some((found) => found.name === one.spectrum));
  return el(
    "button",
    {
      type: "button",
      class: `fd-place fd-${state.replaceAll(" ", "-")}`,
      disabled: !there,
      "aria-pressed": there ? String(view.chosen === one.spectrum) : null,
      "aria-label": WORDS.place(name, repeat, words),
      title: one ? one.words : null,
      onclick: () => chooseSpectrum(one.spectrum),
    },
    el("span", { "aria-hidden": "true" }, sign),
    ` ${words}`,
  );
}

function campaignSection() {
  view.matrixHead = el("tr", {});
  view.matrix = el("tbody", {});
  view.campaignSaid = el("p", { class: "quiet" });
  view.placeSaid = el("p", { class: "fd-line", role: "status" });
  const matrix = el("table", { class: "fd-matrix" }, el("thead", {}, view.matrixHead), view.matrix);
  const frame = el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": WORDS.matrix }, matrix);
  view.campaignSection = section("fd-campaign", WORDS.campaign, view.campaignSaid, frame, view.placeSaid);
  view.campaignSection.hidden = true;
  return view.campaignSection;
}

// ---- the map ------------------------------------------------------------------------------------

function mapSection() {
  view.mapPicture = el("img", { class: "fd-map", alt: WORDS.mapPicture, hidden: true });
  view.mapTables = el("div", {});
  view.mapFiles = el("ul", { class: "fd-files" });
  const pack = `#/pack?${query({ run: view.run, name: "map" })}`;
  view.mapRange = el("p");
  view.mapNotes = el("ul");
  const load = el("a", { href: pack }, WORDS.mapPack);
  const parts = [view.mapRange, view.mapPicture, view.mapTables, view.mapNotes, view.mapFiles, load];
  view.mapSection = section("fd-map", WORDS.map, ...parts);
  view.mapSection.hidden = true;
  return view.mapSection;
}

// Shows the picture and the errors of the map once its files exist, and again when they have changed.
async function drawMap() {
  const mine = view;
  const files = mine.files.filter((file) => MAP_FILES.includes(file.path));
  mine.mapSection.hidden = !files.some((file) => file.path === MAP_FILES[0]);
  const key = JSON.stringify(files);
  if (mine.mapSection.hidden || mine.mapKey === key) return;
  mine.mapKey = key;
  fill(mine.mapFiles, ...files.map((file) => fileRow(file, file.path)));
  const read = (name) => mine.ctx.file(path("files", name)).catch(() => null);
  const tables = Object.keys(WORDS.mapTables).filter((name) => files.some((file) => file.path === name));
  const [model, picture, ...texts] = await Promise.all([
    read(MAP_FILES[0])
      .then(async (file) => file && JSON.parse(await file.text()))
      .catch(() => null),
    read(MAP_PICTURE),
    ...tables.map(async (name) => (await read(name))?.text()),
  ]);
  if (view !== mine) return;
  const errors = (name, place) => (texts[place] ? mapTable(WORDS.mapTables[name], texts[place]) : "");
  fill(mine.mapTables, ...tables.map(errors));
  if (model?.map) fill(mine.mapRange, WORDS.mapRange(model.map.soc, model.map.temperature_degc));
  fill(mine.mapNotes, ...(model?.warnings ?? []).map((note) => el("li", {}, note)));
  if (!picture || !model) {
    mine.mapKey = "";
    return;
  }
  // An image shows a file of the server only as data: the server sends files as downloads.
  const reader = new FileReader();
  reader.onload = () => Object.assign(mine.mapPicture, { src: reader.result, hidden: false });
  reader.readAsDataURL(new Blob([picture], { type: "image/svg+xml" }));
}

// The columns of a table of errors that have a head, a row for each log or spectrum.
function mapTable(label, csv) {
  const [names, ...lines] = csv.trim().split("\n").map((line) => line.split(","));
  const kept = names.map((name, place) => [WORDS.mapHeads[name], place]).filter(([head]) => head);
  const value = (number) => number.replace("-", "−") || WORDS.unknown;
  const row = (line) =>
    el(
      "tr",
      {},
      ...kept.map(([head, place]) =>
        place ? cell(head, value(line[place])) : el("th", { scope: "row" }, line[place]),
      ),
    );
  return table(label, kept.map(([head]) => head), el("tbody", {}, ...lines.map(row)));
}

// ---- files and log ------------------------------------------------------------------------------

// A file of the run.
async function save(file) {
  const mine = view;
  const from = path("files", ...file.split("/").map(encodeURIComponent));
  const blob = await mine.ctx.attempt(() => mine.ctx.file(from));
  if (blob) saveBlob(blob, `${mine.run}-${file.replaceAll("/", "-")}`);
}

const fileRow = (file, name) =>
  el(
    "li",
    {},
    el(
      "button",
      {
        type: "button",
        class: "fd-file",
        "aria-label": WORDS.saveFile(file.path, size(file.bytes)),
        onclick: () => save(file.path),
      },
      name,
    ),
    el("span", { class: "quiet" }, ` ${size(file.bytes)}`),
  );

// Groups the files by their first folder; files without a folder come first.
function folders() {
  const found = new Map([["", []]]);
  for (const file of view.files) {
    const folder = file.path.includes("/") ? file.path.slice(0, file.path.indexOf("/")) : "";
    if (!found.has(folder)) found.set(folder, []);
    found.get(folder).push(file);
  }
  return [...found].filter(([, files]) => files.length);
}

// A folder may have a thousand files: its list is created when it is opened, and stays open when redrawn.
function drawFiles() {
  const there = view.files.some((file) => file.path === REPORT);
  view.report.disabled = !there;
  text(view.filesSaid, view.files.length ? (there ? "" : WORDS.noReport) : WORDS.noFile);
  const seen = new Set();
  for (const [folder, files] of folders()) {
    seen.add(folder);
    if (!view.folders.has(folder)) view.folders.set(folder, newFolder());
    const { box, summary, list } = view.folders.get(folder);
    const bytes = files.reduce((sum, file) => sum + file.bytes, 0);
    text(summary, WORDS.folder(folder || WORDS.top, files.length, size(bytes)));
    const cut = folder ? folder.length + 1 : 0;
    const row = (file) => fileRow(file, file.path.slice(cut));
    const draw = () => keyed(list, files, (file) => file.path, row, summary);
    box.ontoggle = () => box.open && draw();
    if (box.open) draw();
    if (!box.isConnected) view.fileList.append(box);
  }
  for (const [folder, { box }] of view.folders) box.hidden = !seen.has(folder);
}

function newFolder() {
  const summary = el("summary", {});
  const list = el("ul", { class: "fd-files" });
  return { box: el("details", {}, summary, list), summary, list };
}

function filesSection() {
  view.folders = new Map();
  view.report = el(
    "button",
    { type: "button", disabled: true, "aria-describedby": "fd-filesaid", onclick: () => save(REPORT) },
    WORDS.report,
  );
  view.filesSaid = el("p", { id: "fd-filesaid", class: "quiet fd-line" });
  view.fileList = el("div", {});
  view.logText = el("pre", { class: "fd-log", tabindex: "0", role: "region", "aria-label": WORDS.log });
  view.log = el("details", { ontoggle: loadLog }, el("summary", {}, WORDS.log), view.logText);
  return section(
    "fd-filesh",
    WORDS.files,
    el("div", { class: "acts" }, view.report),
    view.filesSaid,
    view.fileList,
    view.log,
  );
}

// Loads the last lines. If the view is at the end, it stays there; otherwise the scroll position stays.
async function loadLog() {
  const mine = view;
  if (!mine || !mine.log.open) return;
  const got = await mine.ctx.get(path("log") + `?most=${LOG_LINES}`).catch(() => null);
  if (view !== mine) return;
  const frame = mine.logText;
  const atEnd = !frame.textContent || frame.scrollTop + frame.clientHeight >= frame.scrollHeight - 4;
  text(frame, got ? got.lines.join("\n") || WORDS.noLog : WORDS.logFailed);
  if (atEnd) frame.scrollTop = frame.scrollHeight;
}

// ---- tags ---------------------------------------------------------------------------------------

function tagsPart() {
  view.tagWhy = lack(view.ctx, "operate");
  view.tagList = el("ul", { class: "fd-chips" });
  view.tagNone = el("p", { class: "quiet" }, WORDS.noTag);
  view.tagSaid = el("p", { id: "fd-tagsaid", class: "quiet fd-line", role: "status" });
  view.tagKnown = el("datalist", { id: "fd-tagknown" });
  view.tagField = el("input", {
    id: "fd-tag",
    list: "fd-tagknown",
    autocomplete: "off",
    spellcheck: "false",
    "aria-describedby": "fd-tagsaid",
  });
  view.tagAdd = el("button", {}, WORDS.addTag);
  const form = el(
    "form",
    { class: "acts", onsubmit: addTag },
    el("label", {}, WORDS.tag, view.tagField),
    view.tagAdd,
    view.tagKnown,
  );
  return [el("h3", {}, WORDS.tags), view.tagNone, view.tagList, form, view.tagSaid];
}

function drawTags() {
  const why = view.tagWhy || (view.card ? null : WORDS.tagsUnknown);
  const tags = view.card ? view.card.tags : [];
  const chip = (tag) =>
    el(
      "li",
      {},
      el("a", { href: `#/catalog?${query({ tag })}` }, tag),
      el(
        "button",
        {
          type: "button",
          "aria-label": WORDS.removeTag(tag),
          "aria-describedby": "fd-tagsaid",
          disabled: Boolean(why),
          onclick: () => setTags(view.card.tags.filter((one) => one !== tag), WORDS.tagRemoved(tag)),
        },
        "✕",
      ),
    );
  keyed(view.tagList, tags, (tag) => tag, chip, view.tagField);
  view.tagNone.hidden = tags.length > 0;
  view.tagField.disabled = view.tagAdd.disabled = Boolean(why);
  if (why) text(view.tagSaid, why);
  const others = view.tagsKnown.filter((tag) => !tags.includes(tag));
  fill(view.tagKnown, ...others.map((tag) => el("option", { value: tag })));
}

async function addTag(event) {
  event.preventDefault();
  const tag = view.tagField.value.trim();
  const tags = [...new Set([...view.card.tags, tag])];
  const mistake = !TAG.test(tag) ? WORDS.tagRule : tags.length > MOST_TAGS ? WORDS.tagsFull : "";
  view.tagField.setAttribute("aria-invalid", String(Boolean(mistake)));
  text(view.tagSaid, mistake);
  if (mistake) return view.tagField.focus();
  if (await setTags(tags, WORDS.tagAdded(tag))) view.tagField.value = "";
  return undefined;
}

async function setTags(tags, words) {
  const mine = view;
  const got = await mine.ctx.attempt(() => mine.ctx.put(path("tags"), { tags }));
  if (!got || view !== mine) return false;
  mine.card.tags = got.tags;
  drawTags();
  text(mine.tagSaid, words);
  return true;
}

// ---- the capture of a point ---------------------------------------------------------------------

// The dialog takes the focus and keeps it, but lies below the header of the page, which stays usable: a modal dialog
// would cover STOP and messages of the server. Esc closes it and continues to the page, where a second Esc stops the
// bench.
function dialog(title, below) {
  const back = document.activeElement;
  const heading = el("h3", { id: "fd-dialog", tabindex: "-1" }, title);
  const body = el("div", {}, el("p", { role: "status" }, WORDS.captureLoading));
  const shut = el("button", { type: "button", onclick: () => end() }, WORDS.close);
  const box = el(
    "dialog",
    { class: "fd-dialog", "aria-labelledby": "fd-dialog", onkeydown: keys },
    el("div", { class: "fd-dialoghead" }, heading, shut),
    el("p", { class: "quiet" }, below),
    body,
  );
  // The heading of the page stays, because it has no control and that of the dialog is below it.
  const others = [...view.root.children].slice(1);
  const room = () => box.style.setProperty("--fd-top", `${$("top").getBoundingClientRect().bottom}px`);
  const watch = new ResizeObserver(room);
  const charts = [];
  const self = { body, charts, open: true, end };

  function keys(event) {
    if (event.key === "Escape") end();
    if (event.key === "Tab") turn(event, box);
  }
  function end() {
    if (!self.open) return;
    self.open = false;
    watch.disconnect();
    charts.forEach((chart) => chart.destroy());
    box.remove();
    for (const one of others) one.inert = false;
    (back.isConnected && back !== document.body ? back : view.select).focus({ preventScroll: true });
  }

  for (const one of others) one.inert = true;
  view.root.append(box);
  box.show();
  watch.observe($("top"));
  heading.focus({ preventScroll: true });
  return self;
}

// Keeps the focus in the dialog.
function turn(event, box) {
  const all = [...controls(box), ...box.querySelectorAll(".scroll")];
  const inOrder = all.sort((a, b) => (a.compareDocumentPosition(b) & Node.DOCUMENT_POSITION_FOLLOWING ? -1 : 1));
  const [first, last] = [inOrder[0], inOrder[inOrder.length - 1]];
  const at = document.activeElement;
  const leaves = event.shiftKey ? at === first || !inOrder.includes(at) : at === last;
  if (!leaves) return;
  event.preventDefault();
  (event.shiftKey ? last : first).focus();
}

async function showCapture(one, point) {
  const mine = view;
  if (mine.dialog) mine.dialog.end();
  const box = dialog(WORDS.capture(si(point.freq_hz, "Hz", 4)), WORDS.captureOf(named(one.spectrum)));
  mine.dialog = box;
  const asked = query({ spectrum: one.spectrum, freq_hz: point.freq_hz });
  try {
    const got = await mine.ctx.get(`${path("capture")}?${asked}`);
    if (box.open) drawCapture(box, got);
  } catch (error) {
    const none = error instanceof mine.ctx.Refused && error.status === 404;
    if (box.open) text(box.body.firstChild, none ? WORDS.noCapture : WORDS.captureFailed(error.message));
  }
}

const PREFIXES = ["G", "M", "k", "", "m", "µ", "n", "p"].map((prefix, place) => [prefix, 1000 ** (3 - place)]);

// The prefix that suits a value, and its factor. Neither shares nor degrees take one.
function prefixOf(value, unit) {
  if (!value || !/^[A-Za-zΩ]+$/.test(unit)) return ["", 1];
  return PREFIXES.find(([, factor]) => Math.abs(value) >= 0.9995 * factor) || PREFIXES[PREFIXES.length - 1];
}

// A figure with its unit: 1.23 mV.
function si(value, unit, digits = 3) {
  if (!Number.isFinite(value)) return WORDS.unknown;
  const [prefix, factor] = prefixOf(value, unit);
  return `${Number((value / factor).toPrecision(digits))} ${prefix}${unit}`.replace("-", "−");
}

// Columns in a unit that suits the greatest of them.
function scaled(unit, ...columns) {
  const greatest = columns.reduce((most, values) => Math.max(most, ...reach(values).map(Math.abs)), 0);
  const [prefix, factor] = prefixOf(Number.isFinite(greatest) ? greatest : 0, unit);
  const by = (value) => (Number.isFinite(value) ? value / factor : null);
  return { unit: `${prefix}${unit}`, columns: columns.map((values) => values.map(by)) };
}

// Least and greatest without spreading an array that may be long.
function reach(values) {
  let [least, greatest] = [Infinity, -Infinity];
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    if (value < least) least = value;
    if (value > greatest) greatest = value;
  }
  return [least, greatest];
}

function rms(values) {
  const read = values.filter(Number.isFinite);
  return Math.sqrt(read.reduce((sum, value) => sum + value * value, 0) / read.length);
}

// Uses the figures that the server computes from all samples, otherwise those of the samples that it sent.
function figures({ channels, samples }) {
  const heads = WORDS.figureHeads;
  const row = (one) => {
    const [least, greatest] = reach(one.fit);
    const amplitude = one.amplitude_v ?? (greatest - least) / 2;
    const off = one.residual_rms_v ?? rms(one.residual);
    return el(
      "tr",
      {},
      el("th", { scope: "row" }, one.name),
      cell(heads.samples, String(samples ?? one.value.length)),
      cell(heads.amplitude, si(amplitude, one.unit)),
      cell(heads.residual, si(off, one.unit)),
      cell(heads.share, amplitude > 0 ? si((100 * off) / amplitude, "%") : WORDS.unknown),
      cell(heads.clipped, clipped(one.clipped_samples)),
    );
  };
  return table(WORDS.figures, Object.values(heads), el("tbody", {}, ...channels.map(row)));
}

const clipped = (count) =>
  count ? el("b", { class: "bad" }, WORDS.clipped(count)) : count === 0 ? WORDS.notClipped : WORDS.unknown;

function drawCapture(box, got) {
  const holders = got.channels.map((one) => {
    const charts = el("div", { class: "fd-charts", "aria-hidden": "true" });
    return [one, charts, el("div", {}, el("h4", {}, `${one.name}: ${WORDS.overTime}`), charts)];
  });
  box.body.replaceChildren(
    figures(got),
    el("p", { class: "quiet" }, got.path ? WORDS.captureFile(got.path) : ""),
    window.uPlot ? "" : el("p", { class: "bad" }, WORDS.noCharts),
    el("div", { class: "fd-channels" }, ...holders.map(([, , whole]) => whole)),
  );
  if (!window.uPlot) return;
  for (const [one, charts] of holders) {
    const spectrum = got.spectrum.find((other) => other.name === one.name);
    box.charts.push(timeChart(charts, one), residualChart(charts, one));
    if (spectrum) box.charts.push(spectrumChart(charts, spectrum));
  }
  const charts = [...box.charts];
  const watch = new ResizeObserver(() => {
    for (const one of charts) one.setSize({ width: one.root.parentNode.clientWidth, height: one.height });
  });
  watch.observe(box.body);
  box.charts.push({ destroy: () => watch.disconnect() });
}

// On a log axis most ticks have no label.
function labels(log) {
  const power = (value) => (value < 1e-3 || value >= 1e5 ? value.toExponential(0) : String(value));
  const label = log ? power : (value, step) => value.toFixed(decimals(step));
  return (_, ticks, axis, space, step) =>
    ticks.map((value) => (value === null ? "" : label(value, step).replaceAll("-", "−")));
}

// Lines of a log axis at whole decades only.
const decades = (_, ticks) => ticks.map((value) => (Number.isInteger(Math.log10(value)) ? value : null));

const axisOf = (label, log, size) => {
  const look = axis({ label, size, values: labels(log) });
  return log ? { ...look, grid: { ...look.grid, filter: decades } } : look;
};

function chart(parent, height, { x, y, series, data, log = false }) {
  const value = (_, at) => (at === null || at === undefined ? WORDS.unknown : String(Number(at.toPrecision(5))));
  const distr = log ? 3 : 1;
  const options = {
    width: Math.max(220, parent.clientWidth),
    height,
    cursor: { drag: { x: true, y: false } },
    scales: { x: { time: false, distr }, y: { distr } },
    series: [{ label: x, value }, ...series.map((one) => ({ width: 1.5, value, ...one }))],
    axes: [axisOf(x, log, 30), axisOf(y, log, 62)],
  };
  return new window.uPlot(options, data, parent);
}

// In time and amplitude each chart has the unit that suits it.
function overTime(parent, height, title, one, columns, series) {
  const time = scaled("s", one.time_s);
  const shown = scaled(one.unit, ...columns);
  const data = [...time.columns, ...shown.columns];
  return chart(parent, height, { x: `${WORDS.time} / ${time.unit}`, y: `${title} / ${shown.unit}`, series, data });
}

function timeChart(parent, one) {
  const colour = () => ink("--c0");
  const series = [
    { label: WORDS.measured, stroke: colour, width: 0, points: { show: true, size: 4, fill: colour } },
    { label: WORDS.fit, stroke: () => ink("--c1"), dash: [7, 3], points: { show: false } },
  ];
  return overTime(parent, 190, WORDS.value, one, [one.value, one.fit], series);
}

function residualChart(parent, one) {
  const series = [{ label: WORDS.residual, stroke: () => ink("--c3"), points: { show: false } }];
  return overTime(parent, 140, WORDS.residual, one, [one.residual], series);
}

// A log axis cannot show zero: a line of frequency or amplitude 0 is left out.
function spectrumChart(parent, one) {
  const kept = one.freq_hz.map((_, k) => k).filter((k) => one.freq_hz[k] > 0 && one.amplitude[k] > 0);
  const pick = (values) => kept.map((k) => values[k]);
  const shown = scaled(one.unit, pick(one.amplitude));
  const series = [{ label: WORDS.amplitude, stroke: () => ink("--c2"), points: { show: false } }];
  const y = `${WORDS.amplitude} / ${shown.unit}`;
  return chart(parent, 170, { x: WORDS.frequency, y, series, data: [pick(one.freq_hz), ...shown.columns], log: true });
}

// ---- the view -----------------------------------------------------------------------------------

function section(id, title, ...parts) {
  return el("section", { "aria-labelledby": id }, el("h3", { id }, title), ...parts);
}

// Draws each part as it arrives; an error affects all parts that wait for the request, and is shown once.
async function load() {
  const mine = view;
  const { ctx, run } = mine;
  const part = (asked, take) =>
    asked.then((got) => {
      if (view === mine) take(got);
    });
  const ask = (name, none) => orNone(ctx, ctx.get(path(name)), none);
  const info = Promise.all([ctx.get(path()), findCard(ctx, run)]);
  // Only a campaign has a matrix: for other runs the server returns none.
  const campaign = info.then(([, { card }]) => (card && !card.campaign ? null : ask("campaign", null)));
  const spectra = Promise.all([ask("spectra", []), campaign]);
  await Promise.all([
    part(info, takeInfo),
    part(spectra, takeSpectra),
    part(ask("files", []), (got) => {
      mine.files = got;
      drawFiles();
      drawMap();
    }),
    part(ask("notes", []), mine.notes.take),
    loadLog(),
  ]);
  return true;
}

function takeInfo([info, { card, tags }]) {
  view.info = info;
  view.card = card;
  view.tagsKnown = tags;
  if (card && info.now && info.now.going) view.ctx.watch(card.bench);
  drawFacts();
  drawTags();
}

function takeSpectra([spectra, campaign]) {
  view.spectra = spectra;
  view.campaign = campaign;
  view.asked.clear();
  text(view.spectraNone, WORDS.noSpectrum);
  if (view.wanted && spectra.some((one) => one.name === view.wanted.name)) view.chosen = view.wanted.name;
  drawSpectra();
  openWanted();
}

// Opens the point that the address names, once.
function openWanted() {
  const one = view.wanted && view.spectra.find((found) => found.name === view.wanted.name);
  const point = one && one.points.find((found) => found.freq_hz === view.wanted.freq_hz);
  if (!point) return;
  view.wanted = null;
  showCapture({ spectrum: one.name }, point);
}

function build(parent) {
  view.facts = el("dl", { class: "facts fd-facts" });
  const said = el("section", {}, ...tagsPart());
  view.notes = notes(said, path("notes"), view.ctx);
  view.root = begin(
    parent,
    WORDS.title(view.run),
    el(
      "div",
      { class: "fd-pair" },
      section("fd-factsh", WORDS.facts, view.facts),
      el("div", { class: "fd-stacked" }, acts(), said),
    ),
    campaignSection(),
    mapSection(),
    spectraSection(),
    filesSection(),
  );
}

// Checks first that the run exists: otherwise nothing else is requested.
async function exists() {
  const mine = view;
  try {
    await mine.ctx.get(path());
    return true;
  } catch (error) {
    if (!(error instanceof mine.ctx.Refused) || error.status !== 404) throw error;
    const { items } = await mine.ctx.get("/queue");
    if (view !== mine) return false;
    // A run has no folder before it has begun.
    mine.waits = items.some((item) => item.run === mine.run);
    for (const one of [...mine.root.children].slice(1)) one.remove();
    const words = mine.waits ? WORDS.waits(mine.run) : WORDS.missing(mine.run);
    mine.root.append(el("p", mine.waits ? { role: "status" } : { class: "bad", role: "alert" }, words));
    return false;
  }
}

export async function open(parent, where, ctx) {
  view = { run: where.path[1], ctx, spectra: [], campaign: null, chosen: "", files: [] };
  // Models of each spectrum, and the spectra whose models were requested since the last change.
  Object.assign(view, { models: new Map(), asked: new Set() });
  Object.assign(view, { card: null, tagsKnown: [], byHand: false, calm: calmly(() => load().catch(() => {})) });
  view.again = () => {
    const held = document.activeElement;
    close();
    parent.replaceChildren();
    const opened = open(parent, where, ctx);
    // A rebuild must not move the focus.
    if (held && held.isConnected) held.focus({ preventScroll: true });
    return opened;
  };
  const name = where.query.get("spectrum");
  view.wanted = name ? { name, freq_hz: Number(where.query.get("freq_hz")) } : null;
  build(parent);
  const mine = view;
  await ctx.attempt(async () => (await exists()) && view === mine && load());
}

export function heard(kind, data) {
  if (!view) return undefined;
  if (view.waits) {
    const run = kind === "live" ? data.run && data.run.run : kind === "run" ? data.item.run : "";
    return run === view.run ? view.again() : undefined;
  }
  const ours = kind === "run" ? data.item.run === view.run : kind === "hello" || kind === "lost";
  if (ours) view.calm.now();
  if (kind === "live" && view.info && data.run && data.run.run === view.run) {
    view.info.now = data.run;
    drawFacts();
  }
  if (kind === "spectrum" && data.run === view.run) grown(data.spectrum);
  return undefined;
}

// A sweep has a new point, or a spectrum has arrived: requests the data that came with it.
function grown(spectrum) {
  const at = view.spectra.findIndex((one) => one.name === spectrum.name);
  if (at < 0) view.spectra.push(spectrum);
  else view.spectra[at] = spectrum;
  view.asked.delete(spectrum.name);
  if (at < 0) view.calm.now();
  drawSpectra();
}

export function close() {
  if (!view) return;
  view.calm.end();
  if (view.dialog) view.dialog.end();
  view = null;
}
