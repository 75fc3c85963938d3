// The pack explorer: shows the effect of a load on the voltage of a pack of modelled cells while a slider moves.
"use strict";

import { axis, el, fill, ink, minus, text } from "./bench.js";

const WORDS = {
  title: "Pack explorer",
  given: "The pack and its load",
  answer: "Result",
  groups: { model: "Cell", pack: "Pack", load: "Load", state: "State at the start", limits: "Limits of the pack" },
  model: "Model",
  typed: "typed below",
  mapOf: (m) =>
    `${m.run}: map, ${percent(m.map.soc_low)} to ${percent(m.map.soc_high)} of charge, ` +
    `${rounded(m.map.temperature_low_c, 1)} to ${rounded(m.map.temperature_high_c, 1)} °C`,
  modelOf: (m) =>
    `${m.run} / ${m.name} (${m.order} RC${m.soc === null ? "" : `, ${percent(m.soc)}`}` +
    `${m.temperature_c === null ? "" : `, ${rounded(m.temperature_c, 1)} °C`}${m.ocv ? "" : ", no OCV curve"})`,
  unlisted: (m) => `${m.run} / ${m.name} (not in the list)`,
  erm: "Typed model of a cell",
  ermHelp: "Resistance; then resistance and capacitance of each RC branch: 6.43 mΩ; 1.51 mΩ, 0.553 F",
  ermWrong: "Type a model, or choose one of the list.",
  noModels: (message) => `The list of models could not be loaded: ${message}`,
  profile: "Profile",
  profiles: {
    walking: "walking",
    lateral_jump: "lateral jump",
    spin_jump: "spin jump",
    gap_2m: "jump over a gap of 2 m",
    constant: "constant power",
  },
  profileHelp: "Power of a robot over time; the scale multiplies it.",
  by: "Given by",
  bySoc: "state of charge",
  byOcv: "open-circuit voltage",
  noOcv: "This model has no OCV curve: the open-circuit voltage is given and stays constant.",
  asMeasured: "Temperature as the model was measured",
  temperature: { map: "Temperature of the surroundings", point: "Temperature" },
  perCell: (v, series) => `${rounded(v / series, 3)} V per cell`,
  perParallel: (a, parallel) => `${rounded(a / parallel, 1)} A per cell`,
  fields: {
    series: ["In series", "cells"],
    parallel: ["In parallel", "cells"],
    power: ["Power", "W"],
    scale: ["Scale of the load", "times"],
    soc: ["State of charge", "%"],
    ocv: ["Open-circuit voltage of a cell", "V"],
    temperature: ["Temperature", "°C"],
    vmin: ["Lowest voltage allowed", "V"],
    vmax: ["Highest voltage allowed", "V"],
    amax: ["Largest current allowed", "A"],
  },
  slider: (name, unit) => `${name}, ${unit}, slider`,
  wrong: (least, most, unit) => `✕ a number from ${least} to ${most} ${unit}`,
  crossed: "✕ above the lowest voltage allowed",
  asking: "Calculating …",
  invalid: "✕ Not calculated: a field is not valid. The values shown are older.",
  refused: (message) => `✕ Refused: ${message}. The values shown are older.`,
  lost: (message) => `✕ Not reached: ${message}. The values shown are older.`,
  again: "Try again",
  kept: (words) => `✓ Within the limits: ${words}`,
  broken: (words) => `✕ Limit exceeded: ${words}`,
  brief: (isKept, v, a) => `${isKept ? "✓ within the limits" : "✕ limit exceeded"}: lowest ${v} V, largest ${a} A`,
  old: (words) => `${words} (older)`,
  lowest: "Lowest voltage",
  highest: "Largest current",
  heat: "Heat",
  at: (s) => `at ${s} s: `,
  above: (margin, limit) => `${margin} V above the limit of ${limit} V`,
  below: (margin, limit) => `▲ ${margin} V below the limit of ${limit} V`,
  within: (margin, limit) => `${margin} A below the limit of ${limit} A`,
  beyond: (margin, limit) => `▲ ${margin} A above the limit of ${limit} A`,
  heatOf: (power) => `${power} W on average`,
  otherLimit: (used, given) =>
    `The server judged by a limit of ${used} V, but ${given} V are given here: do not rely on the margin.`,
  cautions: "Cautions",
  plots: "Voltage and current of the pack over time; dashed: limits. Point at them to read a value.",
  noPlots: "The plots cannot be drawn by this browser; the table has the values.",
  table: "Values over time",
  head: ["Time / s", "Power / W", "Voltage / V", "Current / A", ""],
  lowestHere: "lowest",
  highestHere: "largest current",
  link: "The address contains all settings of this page: share it as it is.",
  time: "time / s",
  voltage: "Voltage / V",
  current: "Current / A (discharge +)",
  least: "least / V",
  most: "most / V",
  limit: "limit / A",
  unknown: "–",
};

// For each field: its allowed range, the range of the slider, its step, and its initial value.
const FIELDS = {
  series: { allowed: [1, 400], slide: [1, 30], step: 1, start: 16 },
  parallel: { allowed: [1, 400], slide: [1, 12], step: 1, start: 3 },
  power: { allowed: [-1e6, 1e6], slide: [0, 10000], step: 50, start: 2000 },
  scale: { allowed: [0, 100], slide: [0, 3], step: 0.05, start: 1 },
  soc: { allowed: [0, 100], slide: [0, 100], step: 1, start: 50 },
  ocv: { allowed: [0.1, 10], slide: [2, 4.5], step: 0.01, start: 3.72 },
  temperature: { allowed: [-60, 120], slide: [-20, 60], step: 1, start: 25 },
  vmin: { allowed: [0, 4000], slide: [0, 120], step: 0.1, start: 40 },
  vmax: { allowed: [0, 4000], slide: [0, 140], step: 0.1, start: 67.2 },
  amax: { allowed: [0, 100000], slide: [0, 400], step: 1, start: 135 },
};
// Limits of a cell, V: those of the pack follow its cells in series until they are set manually.
const CELL_V = { vmin: 2.5, vmax: 4.2 };
const ERM = "6.43 mΩ; 1.51 mΩ, 0.553 F; 4.77 mΩ, 1.084 kF";

// So soon after a change it is calculated, ms: while one drags, that often; never two at a time.
const PAUSE_MS = 80;
// The address and the screen-reader text are updated once a slider rests.
const REST_MS = 600;
const HEIGHT = 220;
const MOST_ROWS = 60;

let view = null;
let ids = 0;

const newId = () => `an-pack-${(ids += 1)}`;
const rounded = (value, digits) => minus(String(Number(value.toFixed(digits))));
const fixed = (value, digits) => (value === null || value === undefined ? WORDS.unknown : minus(value.toFixed(digits)));
const percent = (share) => `${rounded(100 * share, 1)} %`;
// Removes rounding errors of binary fractions: 16 × 4.2 is 67.2.
const tidy = (value) => Number(value.toPrecision(9));

export async function open(parent, address, ctx) {
  const heading = el("h2", { tabindex: -1 }, WORDS.title);
  const root = el("div", { class: "an-view" }, heading);
  parent.append(root);
  const mine = { ctx, models: [], timers: {}, busy: false, again: false, ended: false };
  view = mine;
  mine.form = packForm(mine, address.query);
  mine.out = answerView(mine);
  const link = el("p", { class: "quiet" }, WORDS.link);
  const given = el("section", {}, el("h3", {}, WORDS.given), mine.form.node, link, mine.out.brief);
  root.append(el("div", { class: "an-pack" }, given, el("section", { class: "an-answer" }, mine.out.node)));
  heading.focus();
  await loadModels(mine);
  if (view === mine) ask(mine);
}

export function heard(kind) {
  if (!view) return;
  // A run that has ended may have brought models; after a lost connection the last answer may be missing.
  if (kind === "hello" || kind === "run" || kind === "analysis") later(view, "models", REST_MS, () => loadModels(view));
  if (kind === "hello" && view.out.isStale()) ask(view);
}

export function close() {
  if (!view) return;
  view.ended = true;
  Object.values(view.timers).forEach(clearTimeout);
  view.out.over();
  view = null;
}

// Does something once after a pause.
function later(mine, name, pause, work) {
  clearTimeout(mine.timers[name]);
  mine.timers[name] = setTimeout(work, pause);
}

async function loadModels(mine) {
  let [models, why] = [null, ""];
  try {
    models = await mine.ctx.get("/pack/models");
  } catch (error) {
    why = WORDS.noModels(error.message);
  }
  if (!mine.ended) mine.form.offer(models, why);
}

// ---- the form -----------------------------------------------------------------------------------

// A slider and a number for one quantity. The number may go further than the slider, which follows.
function pair(name, query, changed) {
  const { allowed, slide, step, start } = FIELDS[name];
  const [words, unit] = WORDS.fields[name];
  const id = newId();
  const given = query.get(name);
  const isGiven = given !== null && given !== "" && Number.isFinite(Number(given));
  const whole = Number.isInteger(step) && ["series", "parallel"].includes(name);
  const number = el("input", {
    ...{ type: "number", id, min: allowed[0], max: allowed[1], step: whole ? step : "any" },
    ...{ inputmode: "decimal", "aria-describedby": `${id}-said` },
  });
  const range = el("input", { type: "range", step, "aria-label": WORDS.slider(words, unit) });
  const said = el("small", { id: `${id}-said`, hidden: true });
  const label = el("label", { for: id }, `${words} / ${unit}`);
  const node = el("div", { class: "an-pair" }, label, range, number, said);
  const follow = () => {
    const value = Number(number.value);
    range.min = Math.min(slide[0], value);
    range.max = Math.max(slide[1], value);
    range.value = value;
    range.setAttribute("aria-valuetext", `${number.value} ${unit}`);
  };
  const isRight = () => {
    const value = number.valueAsNumber;
    return value >= allowed[0] && value <= allowed[1] && (!whole || Number.isInteger(value));
  };
  const set = (value) => {
    number.value = tidy(value);
    follow();
  };
  const check = () => {
    const right = isRight();
    number.setAttribute("aria-invalid", String(!right));
    if (!right) say(WORDS.wrong(allowed[0], allowed[1], unit), true);
    else say("");
    return right;
  };
  const say = (about, bad) => {
    text(said, about);
    said.className = bad ? "bad" : "";
    said.hidden = !about;
  };
  range.addEventListener("input", () => {
    number.value = range.value;
    range.setAttribute("aria-valuetext", `${range.value} ${unit}`);
    changed(name);
  });
  number.addEventListener("input", () => {
    if (isRight()) follow();
    changed(name);
  });
  set(isGiven ? Number(given) : start);
  const disable = (off) => {
    number.disabled = range.disabled = off;
  };
  const call = (name) => {
    text(label, `${name} / ${unit}`);
    range.setAttribute("aria-label", WORDS.slider(name, unit));
  };
  return { node, set, check, say, disable, call, value: () => number.valueAsNumber, number };
}

function choice(label, help, control) {
  const id = newId();
  control.id = id;
  if (help) control.setAttribute("aria-describedby", `${id}-help`);
  const about = help ? el("small", { id: `${id}-help` }, help) : "";
  return el("div", { class: "an-field" }, el("label", { for: id }, label), control, about);
}

const group = (name, ...children) => el("fieldset", {}, el("legend", {}, WORDS.groups[name]), ...children);

function packForm(mine, query) {
  const changed = (name) => form.changed(name);
  const fields = Object.fromEntries(Object.keys(FIELDS).map((name) => [name, pair(name, query, changed)]));
  const node = el("form", { class: "an-form", novalidate: true, onsubmit: (event) => event.preventDefault() });
  const form = { node, fields, query, ...cellFields(query, changed), ...loadFields(query, changed) };
  Object.assign(form, stateFields(query, changed));
  node.append(
    group("model", ...form.cellNodes),
    group("pack", fields.series.node, fields.parallel.node),
    group("load", form.loadNode, fields.power.node, fields.scale.node),
    group("state", form.byNode, fields.soc.node, fields.ocv.node, form.measuredNode, fields.temperature.node),
    group("limits", fields.vmin.node, fields.vmax.node, fields.amax.node),
  );
  form.before = fields.series.value();
  startLimits(form);
  form.changed = (name) => {
    if (name === "series") followSeries(form);
    adapt(form);
    ask(mine);
  };
  form.offer = (models, why) => {
    offer(form, models, why);
    adapt(form);
  };
  offer(form, [], "");
  adapt(form);
  return form;
}

// Values that the address does not contain follow the cells in series.
function startLimits(form) {
  for (const name of Object.keys(CELL_V))
    if (!form.query.get(name)) form.fields[name].set(CELL_V[name] * form.before);
}

function followSeries(form) {
  const { fields } = form;
  const series = fields.series.value();
  if (!(Number.isInteger(series) && series > 0)) return;
  for (const name of Object.keys(CELL_V))
    if (Math.abs(fields[name].value() - CELL_V[name] * form.before) < 1e-6) fields[name].set(CELL_V[name] * series);
  form.before = series;
}

function cellFields(query, changed) {
  const select = el("select", { onchange: () => changed("model") });
  const typed = { type: "text", autocomplete: "off", spellcheck: "false", value: query.get("erm") || ERM };
  const erm = el("input", { ...typed, oninput: () => changed("erm") });
  const ermNode = choice(WORDS.erm, WORDS.ermHelp, erm);
  const why = el("p", { class: "bad", hidden: true });
  const wanted = query.get("run") && query.get("name") ? { run: query.get("run"), name: query.get("name") } : null;
  return { select, erm, ermNode, why, wanted, cellNodes: [choice(WORDS.model, "", select), ermNode, why] };
}

function loadFields(query, changed) {
  const names = Object.keys(WORDS.profiles);
  const wanted = names.includes(query.get("profile")) ? query.get("profile") : "spin_jump";
  const options = names.map((name) => el("option", { value: name, selected: name === wanted }, WORDS.profiles[name]));
  const profile = el("select", { onchange: () => changed("profile") }, ...options);
  return { profile, loadNode: choice(WORDS.profile, WORDS.profileHelp, profile) };
}

function stateFields(query, changed) {
  const name = newId();
  const radio = (checked) => el("input", { type: "radio", name, checked, onchange: () => changed("by") });
  const byOcv = query.get("ocv") !== null;
  const [bySoc, byVoltage] = [radio(!byOcv), radio(byOcv)];
  const reason = el("small", { id: newId(), hidden: true }, WORDS.noOcv);
  bySoc.setAttribute("aria-describedby", reason.id);
  const labelled = (box, words) => el("label", { class: "an-check" }, box, el("span", {}, words));
  const byNode = el(
    "div",
    { role: "radiogroup", "aria-label": WORDS.by },
    labelled(bySoc, WORDS.bySoc),
    labelled(byVoltage, WORDS.byOcv),
    reason,
  );
  const asMeasured = { type: "checkbox", checked: query.get("temperature") === null };
  const measured = el("input", { ...asMeasured, onchange: () => changed("measured") });
  return { bySoc, byVoltage, reason, byNode, measured, measuredNode: labelled(measured, WORDS.asMeasured) };
}

// Sets the models to select from; the selection, or that of the address, stays.
function offer(form, models, why) {
  text(form.why, why);
  form.why.hidden = !why;
  if (!models) return;
  const before = form.models ? chosenModel(form) : undefined;
  const same = (one, other) => one && other && one.run === other.run && one.name === other.name;
  const byErm = form.query.get("erm") !== null || (!models.length && !form.wanted);
  const wish = form.settled ? before : form.wanted || (byErm ? null : models[0]);
  form.models = [...models];
  if (wish && !models.some((one) => same(one, wish)))
    form.models.push({ ...wish, unlisted: true, ocv: true });
  form.settled = form.settled || models.length > 0;
  // An unchanged list is not redrawn, because it may be open.
  const key = JSON.stringify([form.models, wish]);
  if (form.select.dataset.key === key) return;
  form.select.dataset.key = key;
  const options = form.models.map((one, place) =>
    el(
      "option",
      { value: String(place), selected: Boolean(wish) && same(one, wish) },
      one.unlisted ? WORDS.unlisted(one) : one.map ? WORDS.mapOf(one) : WORDS.modelOf(one),
    ),
  );
  form.select.replaceChildren(...options, el("option", { value: "erm", selected: !wish }, WORDS.typed));
}

const chosenModel = (form) => (form.select.value === "erm" ? null : form.models[Number(form.select.value)]);

// A map starts at the temperature of the surroundings; its file is called so in every run.
const isMap = (model) => Boolean(model && (model.map || model.name === "map"));
const isAsMeasured = (form) => form.measured.checked && !isMap(chosenModel(form));

// Shows the fields that apply to the selection, and why others do not.
function adapt(form) {
  const { fields } = form;
  const model = chosenModel(form);
  const knowsOcv = Boolean(model && model.ocv);
  form.ermNode.hidden = Boolean(model);
  form.bySoc.disabled = !knowsOcv;
  form.reason.hidden = knowsOcv;
  form.usesSoc = knowsOcv && form.bySoc.checked;
  // A choice that does not count is not shown as made; it comes back with a model that has a curve.
  if (!knowsOcv && form.bySoc.checked) [form.wantsSoc, form.byVoltage.checked] = [true, true];
  else if (knowsOcv && form.wantsSoc) {
    [form.wantsSoc, form.bySoc.checked, form.usesSoc] = [false, true, true];
  }
  fields.soc.node.hidden = !form.usesSoc;
  fields.ocv.node.hidden = form.usesSoc;
  fields.power.node.hidden = form.profile.value !== "constant";
  fields.temperature.disable(isAsMeasured(form));
  fields.temperature.call(WORDS.temperature[isMap(model) ? "map" : "point"]);
  form.measuredNode.hidden = isMap(model);
}

// Returns whether all fields that apply are valid; an invalid one shows a message.
function isFilledIn(form) {
  const { fields } = form;
  const unused = { soc: !form.usesSoc, ocv: form.usesSoc, power: form.profile.value !== "constant" };
  unused.temperature = isAsMeasured(form);
  const wrong = Object.keys(fields).filter((name) => !unused[name] && !fields[name].check());
  const typed = chosenModel(form) || form.erm.value.trim();
  form.erm.setAttribute("aria-invalid", String(!typed));
  if (!typed) [form.why.textContent, form.why.hidden] = [WORDS.ermWrong, false];
  else if (form.why.textContent === WORDS.ermWrong) form.why.hidden = true;
  if (wrong.length || !typed) return false;
  if (fields.vmax.value() <= fields.vmin.value()) {
    fields.vmax.say(WORDS.crossed, true);
    return false;
  }
  const [series, parallel] = [fields.series.value(), fields.parallel.value()];
  for (const name of Object.keys(CELL_V)) fields[name].say(WORDS.perCell(fields[name].value(), series));
  fields.amax.say(WORDS.perParallel(fields.amax.value(), parallel));
  return true;
}

function question(form) {
  const value = (name) => form.fields[name].value();
  const model = chosenModel(form);
  return {
    model: model ? { run: model.run, name: model.name } : { erm: form.erm.value.trim() },
    series: value("series"),
    parallel: value("parallel"),
    ...(form.usesSoc ? { soc: tidy(value("soc") / 100) } : { ocv_v: value("ocv") }),
    temperature_c: isAsMeasured(form) ? null : value("temperature"),
    profile: form.profile.value,
    power_w: form.profile.value === "constant" ? value("power") : null,
    scale: value("scale"),
    voltage_min_v: value("vmin"),
    voltage_max_v: value("vmax"),
    current_max_a: value("amax"),
  };
}

// The address that brings all this back.
function addressOf(form) {
  const value = (name) => String(form.fields[name].value());
  const model = chosenModel(form);
  const query = new URLSearchParams(model ? { run: model.run, name: model.name } : { erm: form.erm.value.trim() });
  const names = ["series", "parallel", "scale", form.usesSoc ? "soc" : "ocv", "vmin", "vmax", "amax"];
  query.set("profile", form.profile.value);
  if (form.profile.value === "constant") names.push("power");
  if (!isAsMeasured(form)) names.push("temperature");
  names.forEach((name) => query.set(name, value(name)));
  return `#/pack?${query}`;
}

// ---- asking -------------------------------------------------------------------------------------

// Simulates soon, once for all changes in between. While a slider moves, simulations repeat.
function ask(mine) {
  if (mine.waits) return;
  mine.waits = true;
  mine.timers.ask = setTimeout(() => {
    mine.waits = false;
    calculate(mine);
  }, PAUSE_MS);
}

async function calculate(mine) {
  if (mine.busy) {
    mine.again = true;
    return;
  }
  mine.busy = true;
  do {
    mine.again = false;
    await once(mine);
  } while (mine.again && !mine.ended);
  mine.busy = false;
}

// Not after the user has navigated elsewhere.
function keepAddress(form) {
  if (location.hash.startsWith("#/pack")) history.replaceState(history.state, "", addressOf(form));
}

async function once(mine) {
  const { form, out } = mine;
  if (!isFilledIn(form)) return out.fail(WORDS.invalid, false);
  const asked = question(form);
  later(mine, "address", REST_MS, () => keepAddress(form));
  out.wait();
  try {
    const answer = await mine.ctx.post("/pack", asked);
    if (!mine.ended) out.show(answer, asked);
  } catch (error) {
    if (mine.ended) return undefined;
    const refused = error instanceof mine.ctx.Refused;
    out.fail(refused ? WORDS.refused(error.message) : WORDS.lost(error.message), !refused);
  }
  return undefined;
}

// ---- the answer ---------------------------------------------------------------------------------

function answerView(mine) {
  const kept = el("p", { class: "an-kept" }, WORDS.asking);
  // Stays visible below the sliders; it repeats information from above only.
  const brief = el("p", { class: "an-brief", "aria-hidden": "true", hidden: true });
  const spoken = el("p", { class: "an-hidden", role: "status" });
  const trouble = el("p", { class: "bad", role: "alert", hidden: true });
  const again = el("button", { type: "button", hidden: true, onclick: () => ask(mine) }, WORDS.again);
  const figures = el("dl", { class: "figures an-large" });
  const other = el("p", { class: "note", hidden: true });
  const cautions = el("div", { class: "an-cautions", hidden: true });
  const plots = plotsView();
  const table = tableView();
  const drawn = el("div", { class: "an-drawn" }, plots.node, table.node);
  const heading = el("h3", {}, WORDS.answer);
  const notes = [trouble, again, kept, spoken, figures, other, cautions];
  const node = el("div", { class: "an-answer" }, heading, ...notes, drawn);
  let stale = true;
  const mark = (old) => {
    stale = old;
    node.classList.toggle("an-stale", old);
    if (!old || !brief.dataset.words) return;
    text(brief, WORDS.old(brief.dataset.words));
    brief.className = "an-brief quiet";
  };
  const wait = () => later(mine, "wait", 4 * PAUSE_MS, () => mark(true));
  const fail = (words, mayTry) => {
    clearTimeout(mine.timers.wait);
    mark(true);
    text(trouble, words);
    trouble.hidden = false;
    again.hidden = !mayTry;
  };
  const show = (answer, asked) => {
    clearTimeout(mine.timers.wait);
    mark(false);
    trouble.hidden = again.hidden = true;
    text(kept, answer.kept ? WORDS.kept(answer.words) : WORDS.broken(answer.words));
    kept.className = `an-kept ${answer.kept ? "good" : "bad"}`;
    brief.dataset.words = WORDS.brief(answer.kept, fixed(answer.lowest_v, 1), fixed(answer.highest_a, 1));
    text(brief, brief.dataset.words);
    brief.className = `an-brief ${answer.kept ? "good" : "bad"}`;
    brief.hidden = false;
    later(mine, "spoken", REST_MS, () => text(spoken, kept.textContent));
    drawFigures(figures, answer);
    drawOther(other, answer, asked);
    drawCautions(cautions, answer.cautions);
    plots.show(answer, asked);
    table.show(answer);
  };
  return { node, brief, wait, fail, show, isStale: () => stale, over: plots.over };
}

function drawFigures(list, answer) {
  const average = answer.time_s.length > 1 ? answer.heat_j / (answer.time_s.at(-1) - answer.time_s[0]) : null;
  const rows = [
    [WORDS.lowest, fixed(answer.lowest_v, 1), "V", lowestWords(answer), answer.margin_v < 0],
    [WORDS.highest, fixed(answer.highest_a, 1), "A", highestWords(answer), answer.margin_a < 0],
    [WORDS.heat, ...heatOf(answer.heat_j), average === null ? "" : WORDS.heatOf(fixed(average, 0)), false],
  ];
  list.replaceChildren(
    ...rows.map(([name, value, unit, more, bad]) =>
      el(
        "div",
        {},
        el("dt", {}, name),
        el("dd", { class: bad ? "bad" : "" }, el("b", {}, value), ` ${unit}`, el("small", {}, more)),
      ),
    ),
  );
}

const heatOf = (j) => (j !== null && Math.abs(j) >= 1000 ? [fixed(j / 1000, 2), "kJ"] : [fixed(j, 1), "J"]);

// The limit is the one that the server judged by: that which the margin belongs to.
function lowestWords({ lowest_v, at_s, margin_v }) {
  if (lowest_v === null || margin_v === null) return "";
  const limit = fixed(lowest_v - margin_v, 1);
  const words = margin_v < 0 ? WORDS.below(fixed(-margin_v, 1), limit) : WORDS.above(fixed(margin_v, 1), limit);
  return `${at_s === null ? "" : WORDS.at(fixed(at_s, 2))}${words}`;
}

function highestWords({ highest_a, margin_a }) {
  if (highest_a === null || margin_a === null) return "";
  const limit = fixed(highest_a + margin_a, 1);
  return margin_a < 0 ? WORDS.beyond(fixed(-margin_a, 1), limit) : WORDS.within(fixed(margin_a, 1), limit);
}

// A margin to another limit than the one that is given here would mislead.
function drawOther(node, { lowest_v, margin_v }, asked) {
  const isKnown = lowest_v !== null && margin_v !== null;
  const used = lowest_v - margin_v;
  const differs = isKnown && Math.abs(used - asked.voltage_min_v) > 0.01 * asked.voltage_min_v + 0.01;
  node.hidden = !differs;
  text(node, differs ? `▲ ${WORDS.otherLimit(fixed(used, 2), fixed(asked.voltage_min_v, 2))}` : "");
}

function drawCautions(node, cautions) {
  node.hidden = !cautions.length;
  fill(
    node,
    el("h3", { class: "note" }, `▲ ${WORDS.cautions}`),
    el("ul", {}, ...cautions.map((one) => el("li", {}, one))),
  );
}

// The values at evenly spaced instants, and at the extremes of voltage and current.
function tableView() {
  const body = el("tbody", {});
  const heads = WORDS.head.map((name) => (name ? el("th", { scope: "col" }, name) : el("td", {})));
  const table = el("table", {}, el("thead", {}, el("tr", {}, ...heads)), body);
  const frame = { class: "an-points", tabindex: 0, role: "group", "aria-label": WORDS.table };
  const node = el("div", {}, el("h4", {}, WORDS.table), el("div", frame, table));
  const show = (answer) => {
    const marks = marked(answer);
    body.replaceChildren(...places(answer.time_s.length, marks).map((place) => tableRow(answer, place, marks)));
  };
  return { node, show };
}

// Positions that are labelled.
function marked({ voltage_v, current_a }) {
  const best = (values, better) =>
    values.reduce((found, value, place) => (value !== null && better(value, values[found]) ? place : found), 0);
  const lowest = best(voltage_v, (one, other) => other === null || one < other);
  const highest = best(current_a, (one, other) => other === null || one > other);
  const marks = new Map([[lowest, WORDS.lowestHere]]);
  marks.set(highest, marks.has(highest) ? `${WORDS.lowestHere}, ${WORDS.highestHere}` : WORDS.highestHere);
  return marks;
}

function places(count, marks) {
  const step = Math.max(1, Math.ceil(count / MOST_ROWS));
  const even = Array.from({ length: Math.ceil(count / step) }, (_, k) => k * step);
  const all = new Set([...even, ...marks.keys(), count - 1]);
  return [...all].filter((place) => place >= 0 && place < count).sort((one, other) => one - other);
}

function tableRow({ time_s, power_w, voltage_v, current_a }, place, marks) {
  const cell = (value, digits) => el("td", { class: "an-num" }, fixed(value, digits));
  return el(
    "tr",
    {},
    el("th", { scope: "row", class: "an-num" }, fixed(time_s[place], 2)),
    cell(power_w[place], 0),
    cell(voltage_v[place], 2),
    cell(current_a[place], 1),
    el("td", {}, marks.has(place) ? el("b", {}, marks.get(place)) : ""),
  );
}

// ---- plots --------------------------------------------------------------------------------------

function series(label, colour, digits, dash) {
  return {
    label,
    stroke: () => ink(colour),
    width: dash ? 1.2 : 1.8,
    dash,
    points: { show: false },
    value: (_, value) => (value === null || value === undefined ? WORDS.unknown : minus(value.toFixed(digits))),
  };
}

function strip(holder, lines) {
  const options = {
    width: 300,
    height: HEIGHT,
    cursor: { sync: { key: "pack" } },
    scales: { x: { time: false } },
    series: [
      { label: WORDS.time, value: (_, value) => (value === null ? WORDS.unknown : value.toFixed(2)) },
      ...lines,
    ],
    axes: [axis({ size: 32 }), axis({ size: 56 })],
  };
  return new window.uPlot(options, [[], ...lines.map(() => [])], holder);
}

// Two strips with one time axis. They are hidden from screen readers, because the table and the figures contain the
// same data.
function plotsView() {
  const about = el("p", { class: "quiet" }, window.uPlot ? WORDS.plots : WORDS.noPlots);
  const holders = [el("div", { class: "strip", "aria-hidden": "true" }), el("div", { class: "strip" })];
  holders[1].setAttribute("aria-hidden", "true");
  const node = el("div", {}, ...holders, about);
  if (!window.uPlot) return { node, show: () => {}, over: () => {} };
  const charts = [
    strip(holders[0], [
      series(WORDS.voltage, "--c0", 2),
      series(WORDS.least, "--bad", 1, [8, 4]),
      series(WORDS.most, "--bad", 1, [3, 4]),
    ]),
    strip(holders[1], [series(WORDS.current, "--c1", 1), series(WORDS.limit, "--bad", 1, [8, 4])]),
  ];
  const fit = () =>
    charts.forEach((chart, place) => {
      const width = Math.max(240, holders[place].clientWidth);
      if (Math.abs(chart.width - width) > 1) chart.setSize({ width, height: HEIGHT });
    });
  const watch = new ResizeObserver(fit);
  watch.observe(node);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const redraw = () => charts.forEach((chart) => chart.redraw());
  dark.addEventListener("change", redraw);
  const show = (answer, asked) => {
    const level = (value) => answer.time_s.map(() => value);
    charts[0].setData([answer.time_s, answer.voltage_v, level(asked.voltage_min_v), level(asked.voltage_max_v)]);
    charts[1].setData([answer.time_s, answer.current_a, level(asked.current_max_a)]);
  };
  const over = () => {
    watch.disconnect();
    dark.removeEventListener("change", redraw);
    charts.forEach((chart) => chart.destroy());
  };
  return { node, show, over };
}
