// Results of an analysis: the story of a diagnosis with the experiments that it recommends, pictures, numbers as
// tables, and all files. Also an investigation, which runs these experiments automatically: its form and its steps.
"use strict";

import { duration, el, fill, minus, person, saveBlob, size, text, when } from "./bench.js";
import { ask as askFirst, close, marginWords, placeOf } from "./energise.js";

const WORDS = {
  verdicts: {
    "nothing missing": ["✓", "Nothing missing", "good"],
    missing: ["▲", "Something is missing", "note"],
    "cannot tell": ["?", "Cannot tell", "note"],
    "invalid data": ["✕", "Invalid data", "bad"],
  },
  story: "What was found",
  cell: (name) => `Cell ${name}`,
  cautions: "Cautions",
  where: ["Where", "Where simulation and measurement disagree.", "Nowhere beyond the noise."],
  what: ["What", "Which effect explains it, and by which evidence.", "No effect is named."],
  sure: ["How sure", "How well these data support it.", "Nothing is said about it."],
  next: ["What next", "Experiments that add information.", "No further experiment is recommended."],
  effect: (name) => `Effect: ${name}`,
  evidence: "Evidence: ",
  experiment: "The experiment as text",
  bench: "Bench",
  noBench: "No bench is available for it.",
  showPlan: "Show its plan",
  queue: "Queue it",
  asking: "The plan is being made …",
  needs: (scope, has) => `Queueing needs the scope ${scope}; your token has ${has}.`,
  planOf: (plan) =>
    `${plan.experiment} on ${plan.bench}: about ${duration(plan.expected_s)} of bench time, ` +
    `at most ${duration(plan.longest_s)}. Charge ${digits(plan.charge_c)} C, ` +
    `discharge ${digits(plan.discharge_c)} C.`,
  mistakes: "✕ No plan: the experiment has mistakes:",
  mistake: (one) =>
    `${one.field ? `${one.field}: ` : ""}${one.message}${one.line === null ? "" : ` (line ${one.line})`}`,
  noPlan: "✕ The server gave no plan and named no mistake.",
  stages: "Stages and steps",
  stage: (one) => `${one.purpose}, about ${duration(one.expected_s)}`,
  margins: "Margins to the limits",
  marginHead: ["Quantity", "Planned", "Allowed", "Margin"],
  yes: (bench) => `Yes, queue it on ${bench}`,
  queued: (run, bench) => `✓ Queued on ${bench} as `,
  pictures: "Pictures",
  pictureWait: "is loaded …",
  pictureOf: (name, what) => `${name}: ${what}. Its numbers are in the results and files below.`,
  large: "Open large",
  small: "Show small",
  numbers: "Results",
  tableHead: ["Quantity", "Value ± σ"],
  place: "No.",
  many: (n, low, high) => `${n} numbers from ${low} to ${high}; see the file`,
  matrix: (n, m) => `${n} × ${m} values; see the file`,
  rest: (n) => `${n} more; see the file`,
  tooMany: "There is more; see the file.",
  tooLarge: (bytes) => `The file has ${bytes}: it is not shown here, but can be saved below.`,
  notRead: "It cannot be read as JSON: ",
  failed: (message) => `✕ ${message}`,
  files: "Files",
  fileHead: ["File", "Size", ""],
  save: "Save",
  report: "Save the report",
  none: "–",
  yesNo: { true: "yes", false: "no" },
};

// JSON larger than this is not shown as a table: it would be unreadable, and the page would freeze.
const MOST_BYTES = 2e6;
const MOST_ROWS = 200;
const MOST_TABLES = 60;
const MOST_LISTED = 12;

// ---- files --------------------------------------------------------------------------------------

const isPicture = (path) => /\.(svg|png)$/i.test(path);
const isJson = (path) => /\.json$/i.test(path);
const isReport = (path) => /(^|\/)(report|diagnosis)\.html$/i.test(path);
const addressOf = (id, path) =>
  `/analyses/${encodeURIComponent(id)}/files/${path.split("/").map(encodeURIComponent).join("/")}`;

async function save(ctx, id, path) {
  const blob = await ctx.attempt(() => ctx.file(addressOf(id, path)));
  if (blob) saveBlob(blob, `${id}-${path.replaceAll("/", "-")}`);
}

export function drawFiles(ctx, analysis) {
  const rows = analysis.files.map(({ path, bytes }) =>
    el(
      "tr",
      {},
      el("th", { scope: "row" }, path),
      el("td", {}, size(bytes)),
      el(
        "td",
        {},
        el(
          "button",
          { type: "button", "aria-label": `${WORDS.save} ${path}`, onclick: () => save(ctx, analysis.id, path) },
          WORDS.save,
        ),
      ),
    ),
  );
  const report = analysis.files.find((one) => isReport(one.path));
  return [
    el("h3", {}, WORDS.files),
    report
      ? el("p", {}, el("button", { type: "button", onclick: () => save(ctx, analysis.id, report.path) }, WORDS.report))
      : "",
    framed(WORDS.files, el("table", { class: "an-files" }, head(WORDS.fileHead), el("tbody", {}, ...rows))),
  ];
}

const head = (names) => el("thead", {}, el("tr", {}, ...names.map((name) => heading(name))));
const heading = (name) => (name ? el("th", { scope: "col" }, name) : el("td", {}));
const framed = (name, table) => el("div", { class: "scroll", role: "group", "aria-label": name, tabindex: 0 }, table);

// ---- pictures -----------------------------------------------------------------------------------

// Returns a picture as data address, because the page may load nothing else.
function dataAddress(blob, path) {
  const type = /\.svg$/i.test(path) ? "image/svg+xml" : "image/png";
  return new Promise((done, fail) => {
    const reader = new FileReader();
    reader.onload = () => done(reader.result);
    reader.onerror = () => fail(reader.error);
    reader.readAsDataURL(new Blob([blob], { type }));
  });
}

const nameOf = (path) => path.replace(/\.[a-z]+$/i, "").replaceAll(/[_/]/g, " ");

// Large within the page: over a dialogue the stop could not be reached.
function picture(path, what) {
  const image = el("img", { alt: WORDS.pictureOf(nameOf(path), what), hidden: true });
  const wait = el("p", { class: "quiet" }, `${nameOf(path)} ${WORDS.pictureWait}`);
  const frame = el("div", { class: "scroll" }, image);
  const button = el("button", { type: "button", "aria-pressed": "false", disabled: true }, WORDS.large);
  button.setAttribute("aria-label", `${WORDS.large}: ${nameOf(path)}`);
  const figure = el("figure", {}, el("figcaption", {}, el("b", {}, nameOf(path)), button), wait, frame);
  button.addEventListener("click", () => {
    const wide = figure.classList.toggle("an-wide");
    button.setAttribute("aria-pressed", String(wide));
    text(button, wide ? WORDS.small : WORDS.large);
    button.setAttribute("aria-label", `${button.textContent}: ${nameOf(path)}`);
    if (wide) enlarge(frame, nameOf(path));
    else for (const name of ["tabindex", "role", "aria-label"]) frame.removeAttribute(name);
    figure.scrollIntoView({ block: "nearest" });
  });
  const show = (address) => {
    image.src = address;
    [image.hidden, wait.hidden, button.disabled] = [false, true, false];
  };
  const fail = (message) => text(wait, WORDS.failed(`${nameOf(path)}: ${message}`));
  return { path, figure, show, fail };
}

// Content that is wider than the page can be scrolled by keyboard, too.
function enlarge(frame, name) {
  frame.setAttribute("tabindex", "0");
  frame.setAttribute("role", "region");
  frame.setAttribute("aria-label", name);
}

// The pictures come one after the other: a browser gives each host few connections, and the stop needs one.
export async function drawPictures(parent, ctx, analysis, what, going) {
  const drawn = new Set(analysis.files.map((one) => one.path).filter((path) => /\.svg$/i.test(path)));
  // The SVG version of a picture is sharper, and smaller.
  const twice = (path) => drawn.has(path.replace(/\.png$/i, ".svg")) && !drawn.has(path);
  const files = analysis.files.filter((one) => isPicture(one.path) && !twice(one.path));
  const pictures = files.map((one) => picture(one.path, what));
  if (!pictures.length) return;
  parent.append(
    el("h3", {}, WORDS.pictures),
    el("div", { class: "an-pictures" }, ...pictures.map((one) => one.figure)),
  );
  for (const one of pictures) {
    if (!going()) return;
    try {
      one.show(await dataAddress(await ctx.file(addressOf(analysis.id, one.path)), one.path));
    } catch (error) {
      one.fail(error.message);
    }
  }
}

// ---- numbers as tables --------------------------------------------------------------------------

const UNITS = {
  ohm: "Ω",
  f: "F",
  s: "s",
  hz: "Hz",
  v: "V",
  a: "A",
  w: "W",
  j: "J",
  ah: "Ah",
  c: "C",
  wh: "Wh",
  k: "K",
  percent: "%",
  rad: "rad",
};
const PREFIXED = ["Ω", "F", "s", "Hz", "V", "A", "W", "J"];
const PREFIXES = [
  [1e6, "M"],
  [1e3, "k"],
  [1, ""],
  [1e-3, "m"],
  [1e-6, "µ"],
  [1e-9, "n"],
];

const isMap = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const isScalar = (value) => value === null || typeof value !== "object";

// `time_constant_s` is a time constant in s, `v_per_c` are V/C; a temperature's C are degrees, any other coulombs.
function taken(key) {
  const [, name, over, under] = key.match(/^(?:(.*)_)?([a-z]+)_per_([a-z]+)$/) || [];
  if (UNITS[over] && UNITS[under]) return [name || "", `${UNITS[over]}/${UNITS[under]}`];
  const [, bare, end] = key.match(/^(.+)_([a-z]+)$/) || [];
  if (!UNITS[end]) return [key, ""];
  return [bare, end === "c" && /temp/.test(bare) ? "°C" : UNITS[end]];
}

const unitOf = (key) => taken(key)[1];
const labelOf = (key) => (taken(key)[0] || taken(key)[1]).replaceAll("_", " ");


function plain(value) {
  if (Number.isInteger(value)) return minus(String(value));
  return minus(String(Number(value.toPrecision(6))));
}

// A number with its uncertainty: both by one prefix, and no more digits than the uncertainty bears.
function number(value, sigma, unit) {
  const measure = Math.abs(value || sigma || 0);
  const found = PREFIXED.includes(unit) ? PREFIXES.find(([size]) => measure >= size) : null;
  let [size, prefix] = found || [1, ""];
  // Kiloseconds are not used.
  if (unit === "s" && size > 1) [size, prefix] = [1, ""];
  const behind = unit ? ` ${prefix}${unit}` : "";
  if (!(sigma > 0)) return `${plain(value / size)}${behind}`;
  const digits = Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(sigma / size))));
  const error = `± ${(sigma / size).toFixed(digits)}`;
  if (value === null) return `${error}${behind}`;
  return `${minus((value / size).toFixed(digits))} ${error}${behind}`;
}

function shown(key, value, sigma) {
  if (typeof value === "number") return number(value, sigma, unitOf(key));
  if (value === undefined && typeof sigma === "number") return number(null, sigma, unitOf(key));
  if (typeof value === "boolean") return WORDS.yesNo[value];
  if (Array.isArray(value)) return listed(key, value);
  return value === null || value === undefined || value === "" ? WORDS.none : String(value);
}

function listed(key, values) {
  if (values.length && values.every(Array.isArray)) return WORDS.matrix(values.length, values[0].length);
  if (values.length <= MOST_LISTED) return values.map((one) => shown(key, one)).join(", ") || WORDS.none;
  const numbers = values.filter((one) => typeof one === "number");
  const rest = WORDS.rest(values.length - MOST_LISTED);
  if (!numbers.length) return `${values.slice(0, MOST_LISTED).join(", ")}, … ${rest}`;
  // No spread: arrays of a capture are longer than a call may have arguments.
  const low = numbers.reduce((one, other) => Math.min(one, other));
  const high = numbers.reduce((one, other) => Math.max(one, other));
  return WORDS.many(values.length, shown(key, low), shown(key, high));
}

const isCell = (value) => isScalar(value) || (Array.isArray(value) && !value.some(isMap));

// Of which key another key is the uncertainty: `r_sigma_ohm` of `r_ohm`.
function ofSigma(key, all) {
  const found = [key.replace("_sigma", ""), key.replace("sigma_", "")].find((one) => one !== key && one in all);
  return key.includes("sigma") ? found : undefined;
}

// Returns the keys of an object that are shown as rows, and the uncertainties by key.
function split(value, sigma) {
  const sigmas = { ...(isMap(sigma) ? sigma : {}) };
  const rows = [];
  for (const [key, one] of Object.entries(value)) {
    const of = ofSigma(key, value);
    if (of !== undefined && typeof one === "number") sigmas[of] = one;
    else if (isCell(one)) rows.push(key);
  }
  for (const [key, one] of Object.entries(sigmas)) if (typeof one === "number" && !(key in value)) rows.push(key);
  return { rows, sigmas };
}

// An object `sigma` belongs to the sibling object that has its keys, otherwise to its parent.
function owner(value) {
  if (!isMap(value.sigma)) return null;
  const keys = Object.keys(value.sigma);
  const found = Object.entries(value).find(
    ([key, one]) => key !== "sigma" && isMap(one) && keys.some((name) => name in one),
  );
  return found ? found[0] : "";
}

function quantityTable(title, value, { rows, sigmas }) {
  const body = rows
    .slice(0, MOST_ROWS)
    .map((key) =>
      el("tr", {}, el("th", { scope: "row" }, labelOf(key)), el("td", {}, shown(key, value[key], sigmas[key]))),
    );
  const caption = title ? el("caption", {}, title) : el("caption", { class: "an-hidden" }, WORDS.numbers);
  const table = el("table", { class: "an-quantities" }, caption, head(WORDS.tableHead), el("tbody", {}, ...body));
  return framed(title || WORDS.numbers, table);
}

// Objects that are alike as the rows of one table.
function rowTable(title, items, sigma) {
  const parts = items.slice(0, MOST_ROWS).map((one, place) => split(one, Array.isArray(sigma) ? sigma[place] : null));
  const keys = [...new Set(parts.flatMap((part) => part.rows))];
  if (!keys.length) return null;
  const body = parts.map((part, place) =>
    el(
      "tr",
      {},
      el("th", { scope: "row" }, String(place + 1)),
      ...keys.map((key) => el("td", {}, shown(key, items[place][key], part.sigmas[key]))),
    ),
  );
  const more = items.length > MOST_ROWS ? `${title} (${WORDS.rest(items.length - MOST_ROWS)})` : title;
  const names = [WORDS.place, ...keys.map(labelOf)];
  return framed(title, el("table", {}, el("caption", {}, more), head(names), el("tbody", {}, ...body)));
}

const under = (title, key) => (title ? `${title} › ${labelOf(key)}` : labelOf(key));

function listTables(title, items, sigma, out) {
  const maps = items.filter(isMap);
  const table = rowTable(title, maps, sigma);
  if (table) out.push(table);
  maps.forEach((one, place) => {
    if (out.length > MOST_TABLES) return;
    const errors = Array.isArray(sigma) && isMap(sigma[place]) ? sigma[place] : null;
    nestedTables(`${title} ${place + 1}`, one, errors, out);
  });
}

function nestedTables(title, value, sigma, out) {
  const own = owner(value);
  const errors = own === "" ? value.sigma : sigma;
  for (const [key, one] of Object.entries(value)) {
    if (out.length > MOST_TABLES) return;
    if (isCell(one) || (key === "sigma" && own !== null)) continue;
    const of = key === own ? value.sigma : errors && errors[key];
    if (Array.isArray(one)) listTables(under(title, key), one, of, out);
    else mapTables(under(title, key), one, of, out);
  }
}

function mapTables(title, value, sigma, out) {
  const found = split(value, owner(value) === "" ? value.sigma : sigma);
  if (found.rows.length) out.push(quantityTable(title, value, found));
  nestedTables(title, value, sigma, out);
}

// Any JSON as tables: parameters with their uncertainty and unit, by the ends of the keys.
function tables(value) {
  const out = [];
  if (isMap(value)) mapTables("", value, null, out);
  else if (Array.isArray(value) && value.some(isMap)) listTables(WORDS.numbers, value, null, out);
  else out.push(el("p", {}, shown("", value)));
  if (out.length > MOST_TABLES) out.push(el("p", { class: "quiet" }, WORDS.tooMany));
  return out;
}

// One file of results, read when it is unfolded.
function results(ctx, id, { path, bytes }) {
  const body = el("div", {});
  const details = el("details", {}, el("summary", {}, path), body);
  let read = false;
  details.addEventListener("toggle", async () => {
    if (!details.open || read) return;
    read = true;
    if (bytes > MOST_BYTES) return body.append(el("p", { class: "quiet" }, WORDS.tooLarge(size(bytes))));
    body.replaceChildren(...(await readTables(ctx, addressOf(id, path), () => (read = false))));
  });
  return details;
}

async function readTables(ctx, address, again) {
  let words;
  try {
    const blob = await ctx.file(address);
    words = await blob.text();
  } catch (error) {
    again();
    return [el("p", { class: "bad" }, WORDS.failed(error.message))];
  }
  try {
    return tables(JSON.parse(words));
  } catch (error) {
    return [el("p", { class: "bad" }, WORDS.failed(`${WORDS.notRead}${error.message}`))];
  }
}

export function drawResults(parent, ctx, analysis, opened) {
  const found = analysis.files.filter((one) => isJson(one.path));
  if (!found.length) return;
  const all = found.map((one) => results(ctx, analysis.id, one));
  parent.append(el("h3", {}, WORDS.numbers), ...all);
  // A fit that has chosen an order has one model.
  const models = found.flatMap((one, place) => (/(^|\/)model_\d+rc\.json$/.test(one.path) ? [place] : []));
  if (opened) all[models.length === 1 ? models[0] : 0].open = true;
}

// ---- the story ----------------------------------------------------------------------------------

function part([title, about, none], items, draw) {
  return el(
    "div",
    { class: "an-part" },
    el("h3", {}, title),
    el("p", { class: "quiet" }, about),
    ...(items.length ? items.map(draw) : [el("p", {}, none)]),
  );
}

const titledText = (one) => el("div", {}, el("h4", {}, one.title), el("p", { class: "an-text" }, one.text));

function effect(one) {
  const node = el("div", {}, el("h4", {}, one.title));
  if (one.effect) node.append(el("p", { class: "quiet" }, WORDS.effect(one.effect)));
  node.append(el("p", { class: "an-text" }, one.text));
  if (one.evidence) node.append(el("div", { class: "an-evidence" }, ...evidence(one.evidence)));
  return node;
}

function evidence(found) {
  if (!isScalar(found)) return [el("b", {}, WORDS.evidence), ...tables(found)];
  return [el("p", { class: "an-text" }, el("b", {}, WORDS.evidence), shown("", found))];
}

export function drawStory(parent, ctx, story) {
  const [sign, word, level] = WORDS.verdicts[story.verdict] || ["?", story.verdict, "note"];
  const cautions = story.caution.length
    ? el(
        "div",
        { class: "an-cautions" },
        el("h3", { class: "note" }, `▲ ${WORDS.cautions}`),
        el("ul", {}, ...story.caution.map((one) => el("li", {}, one))),
      )
    : "";
  parent.append(
    story.cell ? el("h3", {}, WORDS.cell(story.cell)) : el("h3", { class: "an-hidden" }, WORDS.story),
    el("p", { class: `an-verdict ${level}` }, `${sign} ${word}: ${story.sentence}`),
    cautions,
    part(WORDS.where, story.where, titledText),
    part(WORDS.what, story.what, effect),
    part(WORDS.sure, story.how_sure, titledText),
    part(WORDS.next, story.next, (one) => recommended(ctx, one)),
  );
}

// ---- a recommended experiment -------------------------------------------------------------------

let cards = 0;

function recommended(ctx, one) {
  const card = el("div", { class: "an-next" }, titledText(one));
  if (one.experiment) card.append(...experiment(ctx, one));
  return card;
}

// A plan is stored with its bench: it can be queued only there.
function experiment(ctx, one) {
  const id = `an-next-${(cards += 1)}`;
  const names = ctx.benches();
  const bench = el("select", {}, ...names.map((name) => el("option", { selected: name === ctx.bench() }, name)));
  const said = el("p", { role: "status" });
  const body = el("div", {});
  const ask = placeOf(`${id}-ask`);
  const why = el("p", { class: "quiet", id });
  const plan = el("button", { type: "button" }, WORDS.showPlan);
  const queue = el("button", { type: "button", "aria-describedby": id }, WORDS.queue);
  const card = { ctx, one, bench, said, body, ask, plan, queue, draft: null, asked: 0 };
  refuse(card, why, names);
  plan.addEventListener("click", () => showPlan(card));
  queue.addEventListener("click", () => confirm(card));
  bench.addEventListener("change", () => changed(card));
  return [
    el(
      "details",
      {},
      el("summary", {}, WORDS.experiment),
      el("pre", { class: "an-pre", tabindex: 0, role: "group", "aria-label": WORDS.experiment }, one.experiment),
    ),
    el("div", { class: "acts" }, el("label", {}, WORDS.bench, bench), plan, queue),
    why,
    said,
    ask,
    body,
  ];
}

// Shows why an experiment cannot be queued.
function refuse(card, why, names) {
  const has = ["read", "operate", "energise", "clear-trip"].filter((scope) => card.ctx.may(scope));
  if (!names.length) text(why, WORDS.noBench);
  else if (!card.ctx.may("energise")) text(why, WORDS.needs("energise", has.join(", ") || WORDS.none));
  why.hidden = !why.textContent;
  card.queue.disabled = !why.hidden;
}

// A plan applies to one bench; another bench invalidates it.
function changed(card) {
  card.asked += 1;
  const before = card.draft;
  card.draft = null;
  close(card.ask);
  card.body.replaceChildren();
  text(card.said, "");
  if (before) showPlan(card);
}

// The plan for the selected bench; null if it was refused, or if another bench was selected meanwhile.
async function showPlan(card) {
  const asked = (card.asked += 1);
  const bench = card.bench.value || null;
  text(card.said, WORDS.asking);
  const draft = await card.ctx.attempt(() => card.ctx.post("/drafts", { text: card.one.experiment, bench }));
  if (asked !== card.asked) return null;
  text(card.said, draft && draft.plan ? WORDS.planOf(draft.plan) : "");
  card.draft = draft && { ...draft, bench };
  card.body.replaceChildren(...(draft ? planned(draft) : []));
  return card.draft;
}

function planned(draft) {
  if (!draft.plan || draft.mistakes.length) {
    const list = draft.mistakes.map((one) => el("li", {}, WORDS.mistake(one)));
    const words = list.length ? WORDS.mistakes : WORDS.noPlan;
    return [el("div", { class: "bad", role: "alert" }, el("p", {}, words), el("ul", {}, ...list))];
  }
  const stages = draft.plan.stages.map((stage) =>
    el("li", {}, WORDS.stage(stage), el("ol", {}, ...stage.steps.map((step) => el("li", {}, step)))),
  );
  return [
    draft.margins.length ? margins(draft.margins) : "",
    el("details", {}, el("summary", {}, WORDS.stages), el("ol", {}, ...stages)),
  ];
}

const digits = (value) => (value === null || value === undefined ? "…" : minus(String(Number(value.toFixed(3)))));
const range = (least, greatest, unit) => `${digits(least)} to ${digits(greatest)} ${unit}`;
function margins(all) {
  const rows = all.map((one) => {
    const [level, words] = marginWords(one);
    return el(
      "tr",
      {},
      el("th", { scope: "row" }, one.quantity),
      el("td", {}, range(one.planned_least, one.planned_greatest, one.unit)),
      el("td", {}, range(one.least, one.greatest, one.unit)),
      el("td", { class: level === "good" ? "" : level }, words),
    );
  });
  const table = el(
    "table",
    {},
    el("caption", {}, WORDS.margins),
    head(WORDS.marginHead),
    el("tbody", {}, ...rows),
  );
  return framed(WORDS.margins, table);
}

// An experiment is queued only after its plan was shown, and a confirmation.
async function confirm(card) {
  const draft = card.draft || (await showPlan(card));
  if (!draft || !draft.plan) return;
  const { bench } = draft;
  const body = { text: card.one.experiment, bench };
  const done = (item) => {
    const link = el("a", { href: `#/run/${encodeURIComponent(item.run)}` }, item.run);
    card.said.replaceChildren(WORDS.queued(item.run, bench), link);
    card.queue.disabled = true;
    link.focus();
  };
  const send = () => card.ctx.post("/queue", body);
  askFirst(card.ask, { bench, draft, go: WORDS.yes(bench), send, done, back: card.queue });
}

// ---- an investigation ---------------------------------------------------------------------------

// Limits of the server for the text: maximum number of experiments, and maximum number of equal ones.
const [MOST_RUNS, MOST_AGAIN] = [6, 2];

const TOLD = {
  open: "Investigate until it is clear…",
  title: (run) => `Investigate ${run} until it is clear`,
  about: "Diagnoses and recommended experiments in turn, without asking again.",
  may: "What it may do",
  mays: (run) => [
    `Diagnose ${run}.`,
    "While the verdict is not clear: put the recommended experiment at the end of the queue. " +
      "It begins when the bench is free: current will flow.",
    "Diagnose all its runs together, and so on: " +
      `at most ${MOST_RUNS} experiments, the same one at most ${MOST_AGAIN} times.`,
  ],
  ends: "When it ends",
  endings: [
    "The verdict is clear, or no experiment adds information.",
    "The next experiment would take more than is left of the budget: it is not queued.",
    "A run does not come to its end, or the bench is stopped, held or latched. It never goes on by itself then.",
    "Somebody cancels it: an experiment that waits is taken out of the queue, one that runs goes on to its end.",
  ],
  bench: "Bench of its experiments",
  own: "that of the run",
  minutes: "Bench time, min",
  charge: "Charge in either direction, Ah",
  budget: "Budget of all its experiments together",
  wrong: "Budget: write a number of 0 or more in both fields.",
  begin: "Begin: current will flow",
  no: "Do not begin",
  sending: "It is being begun …",
  unknown: "✕ It is not known whether it was begun: look at all analyses first.",
  needs: (has) => `Investigating needs the scope energise; your token has ${has}.`,
  states: {
    diagnosing: "▶ Diagnosing all data so far",
    waiting_for_bench: "○ Its experiment waits for the bench",
    measuring: "▶ Its experiment is measured",
  },
  ended: {
    explained: ["✓", "good"],
    at_noise_floor: ["✓", "good"],
    error_reached: ["✓", "good"],
    gain_below_cost: ["✓", "good"],
    no_experiment: ["?", "note"],
    budget: ["■", "note"],
    stopped: ["■", "note"],
    cancelled: ["■", "note"],
    invalid: ["✕", "bad"],
    failed: ["✕", "bad"],
  },
  end: (sign, why, time) => `${sign} Ended: ${why} (${time}).`,
  by: (one) => `On ${one.bench}. Begun by ${person(one.by)}, ${when(one.submitted_unix_s)}.`,
  time: "Bench time used",
  amount: "Charge used",
  ofMinutes: (spent, all) => `${Math.round(spent)} of ${digits(all)} min`,
  ofCharge: (spent, all) => `${spent.toFixed(2)} of ${digits(all)} Ah`,
  steps: "Steps",
  first: "The run that it began with: ",
  experiment: (name) => `Experiment ${name}: `,
  planned: (price) => `Planned: ${Math.round(price.minutes)} min, ${price.charge_ah.toFixed(2)} Ah.`,
  took: (spent) => ` It took ${Math.round(spent.minutes)} min.`,
  diagnosis: "Diagnosis",
  underWay: ": not ready yet",
  verdict: (step) => `: ${step.verdict}. ${step.summary}`,
};

const isInvestigationOver = (one) => Boolean(one.ended);

// Text for the state of an investigation, with its level.
export function investigationState(one) {
  if (!one.ended) return [TOLD.states[one.state] || one.state, ""];
  const [sign, level] = TOLD.ended[one.ended.end] || ["■", "note"];
  return [TOLD.end(sign, one.ended.why, when(one.ended.unix_s)), level];
}

export function investigationUse(one) {
  return [
    TOLD.ofMinutes(one.spent.minutes, one.budget.minutes),
    TOLD.ofCharge(one.spent.charge_ah, one.budget.charge_ah),
  ];
}

const typedNumber = (input) => {
  const value = Number(input.value.trim().replace(",", "."));
  return input.value.trim() !== "" && Number.isFinite(value) && value >= 0 ? value : null;
};

function labelled(label, control) {
  return el("label", { class: "an-field" }, label, control);
}

// The button, and the inputs that are required before the start.
export function investigationForm(ctx, run, isOpen) {
  const id = `an-investigate-${(cards += 1)}`;
  const may = ctx.may("energise");
  const has = ["read", "operate", "energise", "clear-trip"].filter((scope) => ctx.may(scope));
  const why = el("p", { class: "quiet", id, hidden: may }, may ? "" : TOLD.needs(has.join(", ") || WORDS.none));
  const open = el("button", { type: "button", "aria-expanded": "false", disabled: !may }, TOLD.open);
  if (!may) open.setAttribute("aria-describedby", id);
  const typed = { type: "text", inputmode: "decimal", autocomplete: "off", required: true };
  const minutes = el("input", { ...typed, value: "240" });
  const charge = el("input", { ...typed, value: "20" });
  const names = ctx.benches().map((name) => el("option", { value: name }, name));
  const bench = el("select", {}, el("option", { value: "" }, TOLD.own), ...names);
  const wrong = el("p", { class: "bad", role: "alert", hidden: true });
  const said = el("p", { role: "status" });
  // No button submits the form, so that a held Enter key starts nothing.
  const begin = el("button", { type: "button" }, TOLD.begin);
  const no = el("button", { type: "button" }, TOLD.no);
  const list = (words) => el("ul", {}, ...words.map((one) => el("li", {}, one)));
  const budget = el(
    "fieldset",
    {},
    el("legend", {}, TOLD.budget),
    labelled(TOLD.minutes, minutes),
    labelled(TOLD.charge, charge),
  );
  const form = el(
    "form",
    { class: "an-form confirm", novalidate: true, hidden: true, "aria-label": TOLD.title(run) },
    el("p", {}, el("b", {}, TOLD.title(run))),
    el("div", {}, el("h4", {}, TOLD.may), list(TOLD.mays(run)), el("h4", {}, TOLD.ends), list(TOLD.endings)),
    budget,
    labelled(TOLD.bench, bench),
    wrong,
    el("div", { class: "acts" }, begin, no),
  );
  const show = (on) => {
    form.hidden = !on;
    open.setAttribute("aria-expanded", String(on));
  };
  const fields = { minutes, charge, bench, wrong, said, begin, no };
  open.addEventListener("click", () => {
    show(form.hidden);
    if (!form.hidden) minutes.focus();
  });
  no.addEventListener("click", () => {
    show(false);
    open.focus();
  });
  begin.addEventListener("click", () => beginInvestigation(ctx, run, fields));
  form.addEventListener("submit", (event) => event.preventDefault());
  if (isOpen && may) show(true);
  return el("div", {}, el("p", { class: "quiet" }, TOLD.about), el("div", { class: "acts" }, open), why, form, said);
}

async function beginInvestigation(ctx, run, { minutes, charge, bench, wrong, said, begin, no }) {
  const numbers = [minutes, charge].map(typedNumber);
  [minutes, charge].forEach((input, place) => input.setAttribute("aria-invalid", String(numbers[place] === null)));
  const isWrong = numbers.includes(null);
  wrong.hidden = !isWrong;
  text(wrong, isWrong ? TOLD.wrong : "");
  if (isWrong) return (numbers[0] === null ? minutes : charge).focus();
  begin.disabled = no.disabled = true;
  text(said, TOLD.sending);
  const body = { run, bench: bench.value || null, budget_minutes: numbers[0], budget_ah: numbers[1] };
  let unknown = false;
  const one = await ctx.attempt(() =>
    ctx.post("/investigations", body).catch((error) => {
      unknown = !(error instanceof ctx.Refused);
      throw error;
    }),
  );
  begin.disabled = no.disabled = false;
  text(said, unknown ? TOLD.unknown : "");
  if (!one) return begin.focus();
  return ctx.go(`#/analysis/${encodeURIComponent(one.id)}`);
}

// Shows how much of the budget is used, as a bar and as text.
function useRow(name) {
  const bar = el("progress", { max: 1, "aria-label": name });
  const words = el("b", {});
  const node = el("div", { class: "an-progress" }, el("small", {}, name), bar, words);
  const update = (spent, all, shown) => {
    bar.value = all > 0 ? Math.min(1, spent / all) : 1;
    text(words, shown);
  };
  return { node, update };
}

const address = (part, name) => `#/${part}/${encodeURIComponent(name)}`;

function investigationStep(step) {
  const played = step.experiment;
  const item = el(
    "li",
    {},
    el("b", {}, played ? TOLD.experiment(played.name) : TOLD.first),
    el("a", { href: address("run", step.run) }, step.run),
  );
  if (played) {
    const took = played.spent ? TOLD.took(played.spent) : "";
    item.append(el("p", { class: "quiet" }, `${TOLD.planned(played.expected)}${took}`));
  }
  if (step.analysis) {
    const link = el("a", { href: address("analysis", step.analysis) }, `${TOLD.diagnosis} ${step.analysis}`);
    item.append(el("p", {}, link, step.verdict ? TOLD.verdict(step) : TOLD.underWay));
  }
  return item;
}

// The steps of an investigation with the resources they used; `heard` receives the progress of its diagnosis.
export function investigationView(first) {
  const state = el("p", { class: "an-state", role: "status" });
  const progress = el("p", { class: "quiet" });
  const [time, amount] = [useRow(TOLD.time), useRow(TOLD.amount)];
  const steps = el("ol", { class: "an-steps", "aria-label": TOLD.steps });
  const node = el("div", {}, state, progress, el("p", {}, TOLD.by(first)), time.node, amount.node, steps);
  let now = first;
  const update = (one) => {
    now = one;
    const [words, level] = investigationState(one);
    text(state, words);
    state.className = `an-state ${level}`;
    progress.hidden = isInvestigationOver(one) || one.state !== "diagnosing";
    const [minutes, charge] = investigationUse(one);
    time.update(one.spent.minutes, one.budget.minutes, minutes);
    amount.update(one.spent.charge_ah, one.budget.charge_ah, charge);
    fill(steps, ...one.steps.map(investigationStep));
  };
  const heard = (analysis) => {
    const last = now.steps[now.steps.length - 1];
    if (last && analysis.id === last.analysis) text(progress, analysis.progress.words);
  };
  update(first);
  return { node, update, heard };
}
