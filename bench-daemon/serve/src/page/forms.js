// Experiments, cells and benches as forms generated from their schemas. The server checks them at each change, and the
// text of the file is shown beside the form. Typed text is stored as a draft until it is submitted.
"use strict";

import { duration, el, fill, person, saveBlob, text, when } from "./bench.js";
import { ask as askFirst, chargeWords, close as closeAsk, figure, known, marginWords, placeOf } from "./energise.js";
import * as schema from "./schema.js";

const WORDS = {
  kinds: { experiments: "Experiments", cells: "Cells", benches: "Benches" },
  one: { experiments: "experiment", cells: "cell", benches: "bench" },
  newTitle: "New experiment",
  copyTitle: (run) => `New experiment, a copy of the run ${run}`,
  fromTitle: (name) => `New experiment, from ${name}`,
  fileTitle: (kind, name) => `${kind.charAt(0).toUpperCase()}${kind.slice(1)} ${name}`,
  filesTitle: "Files",
  loading: "Loading …",
  notLoaded: (why) => `This cannot be shown: ${why}`,
  again: "Try again",
  start: {
    experiments: "Begin with an experiment of this server",
    runs: "Copy a run",
    other: "Begin with something else",
    empty: "Empty form",
    file: "A file of this computer",
    none: "None.",
    unread: (why) => `Not loaded: ${why}`,
  },
  files: {
    edited: (n) => `edited here, ${n} ${n === 1 ? "version" : "versions"}`,
    asInstalled: "never edited here",
    proposed: (n) => `▲ version ${n} is proposed, not in force`,
    use: "Use it for a run",
    all: "All files",
  },
  draft: {
    words: (at) => `There is a draft of ${at}: it was not sent.`,
    take: "Go on with it",
    drop: "Throw it away",
    full: "▲ The browser cannot keep a draft (its store is full): do not leave the page before it is sent.",
  },
  form: {
    general: "General",
    required: " (required)",
    use: "in the file",
    more: "more",
    less: "less",
    about: (more, label) => `${more} about ${label}`,
    fold: (n) => `${n} more ${n === 1 ? "field" : "fields"}, not in the file`,
    fallback: (value) => `default: ${value}`,
    leftOut: "left out",
    leftOutIs: (value) => `left out (default: ${value})`,
    choose: "choose …",
    yes: "yes",
    no: "no",
    notAChoice: (value) => `${value} (not one of the choices)`,
    unit: (label) => `Unit of ${label}`,
    noUnit: "as typed",
    numbers: (n) => `${n} ${n === 1 ? "value" : "values"}`,
    separated: "Values with commas between them.",
    odd: "The value does not have the type of the schema and is shown as JSON.",
    unknown: "The schema does not know this key. It is kept as it is; JSON. Empty it to take it out.",
    json: "JSON. Empty: left out.",
    add: "Add one",
    addTo: (label) => `Add one to ${label}`,
    none: "None.",
    remove: "Remove",
    up: "Up",
    down: "Down",
    act: (act, what) => `${act}: ${what}`,
    item: (label, n) => `${label} ${n}`,
    itemNamed: (label, n, name) => `${label} ${n}${name ? `: ${name}` : ""}`,
  },
  wrong: {
    number: "This is not a number, such as 0.25 or 1e-3.",
    whole: "This is not a whole number.",
    large: "This number has more digits than a page can keep exactly. Write it in the text of the file.",
    json: "This is not JSON.",
    null: "A file cannot contain null: leave the key out instead.",
    missing: "This value is missing: give all of them or none.",
  },
  stale: {
    reading: "The text is being read …",
    unreadable: "The form waits: the text of the file cannot be read. Correct the text, or take it back.",
    large: "A number of this file has more digits than a form can keep exactly. Only its text can be edited.",
    takeBack: "Take the text back to that of the form",
  },
  force: {
    head: (n) => `▲ Version ${n} is proposed, not in force`,
    by: (who, at, why) => `By ${who}, ${at}: ${why}`,
    shown: "The form shows the proposed version. The bench, its guardian and its runs use the file in force.",
    title: "Keys that differ from the file in force",
    columns: ["Key", "In force", "Proposed"],
    absent: "left out",
    none: "No key differs: comments, or the order of keys.",
    take: "A person at the machine puts it in force, while nothing runs on the bench:",
    command: (bench, n) => `eis-bench config take SERVER.toml ${bench} --version ${n}`,
    server: "SERVER.toml is the file that this server was started with. Then the server is started again.",
    withdraw: "To withdraw it: under Versions press Take back at version 0, then Save as a proposal.",
    fine: "✓ The file in force is shown. What is saved here is a proposal: it changes nothing on the bench.",
    restart: (why) => `▲ ${why}. Until then no run starts on this bench.`,
  },
  mistakes: {
    head: (n) => `▲ ${n === 1 ? "A mistake" : `${n} mistakes`}`,
    line: (n) => ` (line ${n} of the text)`,
    go: "Go to the mistake",
    near: "Go to its section",
    goTo: (go, path) => `${go}: ${path}`,
    whole: "(whole file)",
  },
  check: {
    title: "What it would do",
    titleFile: "Check",
    going: "Being checked …",
    fine: "✓ No mistake found.",
    fineFor: (time) => `✓ No mistake found; about ${time}.`,
    wrong: "▲ There is a mistake: see above the form.",
    failed: (why) => `✕ Not checked: ${why}`,
    bench: "Bench",
    noBench: "choose …",
    expected: "Duration",
    longest: "At most",
    charge: "Charge moved",
    margins: "Margins to the limits",
    noMargins: "No limits are stated.",
    plan: (stages, steps) => `The plan: ${stages} ${stages === 1 ? "stage" : "stages"}, ${steps} steps`,
    stage: (purpose, time) => `${purpose}, about ${time}`,
  },
  margin: {
    range: (low, high, unit) => `planned ${low} to ${high} ${unit}`,
    limits: (low, high, unit) => `limits ${low} to ${high} ${unit}`,
  },
  file: {
    title: "The file",
    label: "Text of the file (TOML)",
    copy: "Copy",
    copied: "✓ Copied.",
    select: "The text is selected: copy it with the keys of your system.",
    save: "Save as file",
    comments:
      "This change could not be written into the text as it was: the file is written anew, without its comments. " +
      "To keep them, take the text back and edit it instead.",
    before: "Undo what was changed in the form: the text with its comments",
    waits: "The text follows as soon as the form has no mistake.",
  },
  submit: {
    seed: "Seed",
    seedHint: "as in the file",
    button: "Submit …",
    reasonMistake: "There is a mistake.",
    reasonSeed: "The seed is not a whole number from 0 to 9007199254740991.",
    reasonWaits: "It is being checked.",
    reasonFailed: "It could not be checked.",
    reasonBench: "No bench is chosen.",
    reasonPlan: "The server made no plan of it.",
    reasonScope: (scopes) => `It needs the scope energise; your token has ${scopes}.`,
    noScope: "none",
    go: (bench) => `Yes, submit to ${bench}`,
    done: (run, bench) => `✓ ${run} waits on ${bench}. `,
    seeBench: (bench) => `See the bench ${bench}`,
    seeRun: (run) => `See the run ${run}`,
  },
  save: {
    title: "Save",
    propose: "Propose",
    why: "Why (it is kept with the version)",
    button: "Save a new version",
    proposeButton: "Save as a proposal",
    reasonWhy: "Say why.",
    reasonSame: "Nothing is changed.",
    sending: "Being saved …",
    done: "✓ Saved.",
    proposed: (n) => `✓ Saved as version ${n}. It is proposed, not in force.`,
    withdrawn: "✓ Saved. It is the file in force; the proposal is withdrawn.",
    refused: (why) => `✕ Not saved: ${why}`,
    lost: (why) => `▲ No answer (${why}): it is NOT known whether it was saved. Load the page again to see.`,
    conflict: "▲ Not saved: another person has saved this file in the meantime. Your text is kept.",
    conflictLast: (who, at, why) => `The last version is by ${who}, ${at}: ${why}`,
    difference: "From their text to yours",
    mine: "Save mine as the next version",
    theirs: "Take theirs, throw mine away",
  },
  versions: {
    title: "Versions",
    none: "This file was never edited on this server.",
    head: ["Version", "When", "By", "Why", ""],
    now: " (now)",
    inForce: " (in force)",
    proposed: " (proposed, not in force)",
    look: "Look",
    compare: "Compare",
    back: "Take back",
    lookAt: (n) => `Version ${n}`,
    compared: (n) => `From version ${n} to the text above`,
    same: "No difference.",
    backWhy: (n) => `back to version ${n}`,
    backSaid: (n) => `The text is now that of version ${n}. It is saved as a new version with the button.`,
    replace: (n) => `You have changes that are not saved. Replace them by version ${n}?`,
    yes: "Replace them",
    no: "Keep them",
    close: "Close",
    added: "added",
    removed: "removed",
  },
};

const SCHEMAS = { experiments: "experiment", cells: "cell", benches: "bench" };
const SCOPES = ["read", "operate", "energise", "clear-trip"];
const WAIT_MS = 300;

// The open form. After each await, check that it is still the current one.
let view = null;
let ids = 0;

const id = (name) => `fm-${name}-${(ids += 1)}`;
const button = (label, onclick, more) => el("button", { type: "button", onclick, ...more }, label);
const link = (href, label) => el("a", { href }, label);
const address = (...parts) => `#/${parts.map(encodeURIComponent).join("/")}`;
const reasonOf = (error) => error.message || String(error);
// An answer of the server, not a connection that broke.
const isRefusal = (error) => error instanceof view.ctx.Refused;

// ---- stored drafts ------------------------------------------------------------------------------

const keyOf = (path) => `fm-draft ${address(...path)}`;

function stored(path) {
  try {
    return JSON.parse(sessionStorage.getItem(keyOf(path)));
  } catch {
    return null;
  }
}

// Saves at once with each change, because a page can be closed at any time.
function keep() {
  const typed = { source: view.source, text: view.text, base: view.base, bench: view.bench };
  const more = { at: Date.now() / 1e3, seed: view.seed, why: view.why, was: view.was };
  const aside = schema.putAside(view.model);
  try {
    sessionStorage.setItem(keyOf(view.path), JSON.stringify({ ...typed, ...more, aside, typedText: view.typedText }));
    view.kept = true;
  } catch {
    view.kept = false;
  }
  view.parts.kept.hidden = view.kept;
}

const forget = (path) => sessionStorage.removeItem(keyOf(path));

function clock(unix_s) {
  const [at, now] = [when(unix_s), when(Date.now() / 1e3)];
  return at.slice(0, 10) === now.slice(0, 10) ? at.slice(11, 16) : at.slice(0, 16);
}

// ---- fields -------------------------------------------------------------------------------------

// Elements of a node: `box` around it, `control` to focus, `mistake` for messages, `help` ids.
const places = new WeakMap();

function pieces(description) {
  return schema.piecesOf(description).map((piece, place) => (place % 2 ? el("code", {}, piece) : piece));
}

// One line, and the rest on demand; a reader that speaks has all of it from the beginning.
function helpOf(words, label) {
  if (!words) return null;
  const line = el("span", { id: id("help"), class: "fm-line" }, ...pieces(words));
  if (words.length < 70) return el("div", { class: "fm-help", "data-id": line.id }, line);
  const onclick = () => {
    const open = line.classList.toggle("fm-open");
    more.setAttribute("aria-expanded", String(open));
    more.setAttribute("aria-label", WORDS.form.about(open ? WORDS.form.less : WORDS.form.more, label));
    text(more, open ? WORDS.form.less : WORDS.form.more);
  };
  const name = WORDS.form.about(WORDS.form.more, label);
  const more = button(WORDS.form.more, onclick, { class: "fm-more", "aria-expanded": "false", "aria-label": name });
  return el("div", { class: "fm-help", "data-id": line.id }, line, more);
}

const shownDefault = (node) => {
  const { fallback } = node;
  if (fallback === undefined) return null;
  if (Array.isArray(fallback)) return fallback.join(", ");
  if (typeof fallback === "boolean") return fallback ? WORDS.form.yes : WORDS.form.no;
  return typeof fallback === "object" ? JSON.stringify(fallback) : String(fallback);
};

const placeholder = (node) => {
  const value = shownDefault(node);
  return value === null ? null : WORDS.form.fallback(value);
};

function textBox(node, attributes) {
  const oneLine = !(node.kind === "anything" || (node.kind === "words" && node.text.includes("\n")));
  const numeric = ["number", "whole", "quantity"].includes(node.kind);
  const own = {
    autocomplete: "off",
    spellcheck: "false",
    placeholder: placeholder(node),
    inputmode: numeric ? "decimal" : null,
    oninput: (event) => {
      node.text = event.target.value;
      changed();
    },
    ...attributes,
  };
  if (oneLine) return el("input", { type: "text", ...own, value: node.text });
  const area = el("textarea", { rows: Math.min(8, node.text.split("\n").length + 1), ...own });
  area.value = node.text;
  return area;
}

function options(node, choices) {
  const value = shownDefault(node);
  const blank = value !== null ? WORDS.form.leftOutIs(value) : node.needed ? WORDS.form.choose : WORDS.form.leftOut;
  const all = [["", blank], ...choices];
  if (!all.some(([one]) => one === node.text)) all.push([node.text, WORDS.form.notAChoice(node.text)]);
  return all.map(([one, label]) => el("option", { value: one, selected: one === node.text }, label));
}

function selectBox(node, choices, attributes, then = () => {}) {
  const onchange = (event) => {
    node.text = event.target.value;
    then();
    changed();
  };
  return el("select", { onchange, ...attributes }, ...options(node, choices));
}

function switchBox(node, attributes) {
  const choices = [
    ["true", WORDS.form.yes],
    ["false", WORDS.form.no],
  ];
  return [selectBox(node, choices, attributes)];
}

function choiceBox(node, attributes) {
  const about = el("span", { id: id("choice"), class: "fm-choice" });
  const tell = () => {
    const chosen = node.choices.find((one) => one.value === (node.text || node.fallback));
    about.replaceChildren(...pieces(chosen ? chosen.help : ""));
  };
  tell();
  const choices = node.choices.map((one) => [one.value, one.help ? `${one.value} – ${one.help}` : one.value]);
  const described = [attributes["aria-describedby"], about.id].filter(Boolean).join(" ");
  return [selectBox(node, choices, { ...attributes, "aria-describedby": described }, tell), about];
}

// A number and its unit; a unit that is typed after the number is adopted.
function quantityBox(node, attributes, label) {
  const unit = el("select", {
    "aria-label": WORDS.form.unit(label),
    onchange: (event) => {
      node.unit = event.target.value;
      changed();
    },
  });
  const drawUnits = () => {
    const none = node.unit === "" ? [el("option", { value: "", selected: true }, WORDS.form.noUnit)] : [];
    const units = node.units.map((one) => el("option", { value: one, selected: one === node.unit }, one));
    unit.replaceChildren(...none, ...units);
  };
  drawUnits();
  const box = textBox(node, {
    ...attributes,
    onchange: (event) => {
      schema.type(node, event.target.value);
      // Without a change nothing is checked again: a user who leaves the box to press a button must find the button in
      // its place.
      if (event.target.value === node.text) return;
      event.target.value = node.text;
      drawUnits();
      changed();
    },
  });
  return [box, unit];
}

// Many values as one text, folded.
function listBox(node, attributes) {
  const count = () => node.text.split(/[,;\n]+/).filter((part) => part.trim()).length;
  if (count() <= 12) return [textBox(node, attributes)];
  const head = el("summary", {}, WORDS.form.numbers(count()));
  const area = el("textarea", {
    rows: 8,
    spellcheck: "false",
    ...attributes,
    oninput: (event) => {
      node.text = event.target.value;
      text(head, WORDS.form.numbers(count()));
      changed();
    },
  });
  area.value = node.text;
  return [el("details", { class: "fm-long" }, head, area)];
}

const BOXES = { switch: switchBox, choice: choiceBox, quantity: quantityBox, list: listBox };

// The controls of a field, the one to go to first.
function boxes(node, attributes, label) {
  const parts = BOXES[node.kind] ? BOXES[node.kind](node, attributes, label) : [textBox(node, attributes)];
  const control = parts[0].querySelector("textarea") || parts[0];
  return { parts, control };
}

function remarks(node) {
  if (node.unknown) return WORDS.form.unknown;
  if (node.odd) return WORDS.form.odd;
  if (node.kind === "anything") return WORDS.form.json;
  return node.kind === "list" ? WORDS.form.separated : "";
}

function drawField(node) {
  const own = id("field");
  const help = helpOf([node.help, remarks(node)].filter(Boolean).join(" "), node.label);
  const mistake = el("p", { id: id("mistake"), class: "fm-mistake bad", hidden: true });
  const described = help ? help.dataset.id : null;
  const { parts, control } = boxes(node, { id: own, "aria-describedby": described }, node.label);
  const required = node.needed ? el("span", { class: "fm-required" }, WORDS.form.required) : null;
  const label = el("label", { for: own, class: node.unknown ? "fm-label fm-key" : "fm-label" }, node.label, required);
  const box = el("div", { class: "fm-field" }, label, el("div", { class: "fm-controls" }, ...parts), help, mistake);
  places.set(node, { box, control, mistake });
  return box;
}

// ---- lists and sections -------------------------------------------------------------------------

const isSection = (node) => node.kind === "table" || node.kind === "tables";

function redraw(node, depth) {
  const old = places.get(node).box;
  const next = draw(node, depth);
  old.replaceWith(next);
  view.showMistakes();
  changed();
}

// Focuses the control that moves or removes an item of a list, after the list was redrawn.
function goToAct(node, name, place) {
  const found = [...places.get(node).box.querySelectorAll(`[data-act="${name} ${CSS.escape(node.key)}"]`)];
  const wanted = found[Math.min(place, found.length - 1)];
  if (wanted && !wanted.disabled) wanted.focus();
  else places.get(node).control.focus();
}

// Buttons to move an item of a list up or down, or to remove it; afterwards the focus stays at the button.
function itemActs(node, place, depth) {
  const what = WORDS.form.item(node.label, place + 1);
  const last = node.items.length - 1;
  const act = (name, off, onclick) => {
    const label = WORDS.form.act(WORDS.form[name], what);
    const more = { disabled: off, "aria-label": label, "data-act": `${name} ${node.key}` };
    return button(WORDS.form[name], onclick, more);
  };
  const move = (to, name, back) => () => {
    schema.move(node, place, to);
    redraw(node, depth);
    // At an end of the list, only the opposite direction can be pressed.
    goToAct(node, to === 0 || to === last ? back : name, to);
  };
  const remove = () => {
    node.items.splice(place, 1);
    redraw(node, depth);
    goToAct(node, "remove", place);
  };
  return el(
    "div",
    { class: "fm-acts" },
    act("up", place === 0, move(place - 1, "up", "down")),
    act("down", place === last, move(place + 1, "down", "up")),
    act("remove", false, remove),
  );
}

function addButton(node, depth) {
  const onclick = () => {
    const item = schema.add(node);
    item.open = true;
    redraw(node, depth);
    const first = places.get(item).box.querySelector("input, select, textarea");
    if (first) first.focus();
  };
  const more = { "aria-label": WORDS.form.addTo(node.label) };
  return button(`+ ${WORDS.form.add}`, onclick, more);
}

function drawRow(node, item, place, depth) {
  const label = WORDS.form.item(node.label, place + 1);
  const mistake = el("p", { id: id("mistake"), class: "fm-mistake bad", hidden: true });
  const { parts, control } = boxes(item, { "aria-label": label }, label);
  const acts = node.size ? null : itemActs(node, place, depth);
  const box = el("li", { class: "fm-row" }, el("div", { class: "fm-controls" }, ...parts, acts), mistake);
  places.set(item, { box, control, mistake });
  return box;
}

// A list of values with a control for each.
function drawRows(node, depth) {
  const name = id("rows");
  const help = helpOf(node.help, node.label);
  const mistake = el("p", { id: id("mistake"), class: "fm-mistake bad", hidden: true });
  const required = node.needed ? el("span", { class: "fm-required" }, WORDS.form.required) : null;
  const items = node.items.map((item, place) => drawRow(node, item, place, depth));
  const more = node.size ? null : addButton(node, depth);
  const box = el(
    "div",
    { class: "fm-field", role: "group", "aria-labelledby": name, "aria-describedby": help ? help.dataset.id : null },
    el("span", { id: name, class: "fm-label" }, node.label, required),
    items.length ? el("ol", { class: "fm-rows" }, ...items) : null,
    more,
    help,
    mistake,
  );
  places.set(node, { box, control: more || places.get(node.items[0]).control, mistake });
  return box;
}

function heading(node, depth, own) {
  const sign = node.kind === "tables" ? `[[${node.key}]]` : `[${node.key}]`;
  const required = node.needed ? el("span", { class: "fm-required" }, WORDS.form.required) : null;
  const words = node.key ? [node.label, " ", el("code", {}, sign), required] : [WORDS.form.general];
  return el(`h${Math.min(6, 3 + depth)}`, { id: own, class: "fm-h", tabindex: "-1" }, ...words);
}

function switchOf(node, depth) {
  if (!node.key || (node.needed && node.on)) return null;
  const box = el("input", {
    type: "checkbox",
    checked: node.on,
    "aria-label": `${WORDS.form.use}: ${node.label}`,
    onchange: () => {
      schema.switchTo(node, box.checked);
      redraw(node, depth);
      const { control } = places.get(node);
      control.focus();
    },
  });
  return el("label", { class: "fm-switch" }, box, WORDS.form.use);
}

// Shows fields that are in the file or required, and the optional fields folded below them.
function fieldsOf(node, depth) {
  const plain = node.fields.filter((field) => !isSection(field));
  const first = plain.filter((field) => field.had || field.needed);
  const rest = plain.filter((field) => !first.includes(field));
  const sections = node.fields.filter(isSection);
  const fold = rest.length
    ? folded(node, "more", el("summary", {}, WORDS.form.fold(rest.length)), gridOf(rest, depth))
    : null;
  return [
    first.length ? gridOf(first, depth) : null,
    fold,
    ...sections.map((section) => draw(section, depth + 1)),
  ].filter(Boolean);
}

const gridOf = (fields, depth) => el("div", { class: "fm-grid" }, ...fields.map((field) => draw(field, depth)));

// Keeps its open state when its section is redrawn.
function folded(node, name, ...children) {
  node.unfolded ||= {};
  const ontoggle = (event) => {
    node.unfolded[name] = event.target.open;
  };
  return el("details", { class: "fm-fold", open: Boolean(node.unfolded[name]), ontoggle }, ...children);
}

function section(node, depth, ...children) {
  const own = id("section");
  const help = node.key ? helpOf(node.help, node.label) : null;
  const mistake = el("p", { id: id("mistake"), class: "fm-mistake bad", hidden: true });
  const head = heading(node, depth, own);
  const use = node.kind === "table" ? switchOf(node, depth) : null;
  const box = el(
    "div",
    { class: depth ? "fm-group" : "fm-group fm-card", role: "group", "aria-labelledby": own },
    el("div", { class: "fm-head" }, head, use),
    help,
    mistake,
    ...children,
  );
  places.set(node, { box, control: (use && use.firstChild) || head, mistake });
  return box;
}

function drawTable(node, depth) {
  return section(node, depth, ...(node.on ? fieldsOf(node, depth) : []));
}

function drawItem(node, item, place, depth) {
  const named = () => WORDS.form.itemNamed(node.label, place + 1, schema.nameOf(item));
  const head = el("summary", {}, named());
  const mistake = el("p", { id: id("mistake"), class: "fm-mistake bad", hidden: true });
  const box = el(
    "details",
    {
      class: "fm-item",
      open: item.open ?? node.items.length <= 2,
      oninput: () => text(head, named()),
      ontoggle: (event) => {
        if (event.target === box) item.open = box.open;
      },
    },
    head,
    mistake,
    itemActs(node, place, depth),
    ...fieldsOf(item, depth),
  );
  places.set(item, { box, control: head, mistake });
  return box;
}

function drawTables(node, depth) {
  const items = node.items.map((item, place) => drawItem(node, item, place, depth));
  const none = items.length ? null : el("p", { class: "quiet fm-none" }, WORDS.form.none);
  return section(node, depth, ...[none, ...items, addButton(node, depth)].filter(Boolean));
}

function draw(node, depth) {
  if (node.kind === "table") return drawTable(node, depth);
  if (node.kind === "tables") return drawTables(node, depth);
  return node.kind === "rows" ? drawRows(node, depth) : drawField(node);
}

// Draws the whole form: keys without a section first, then a card for each section.
function drawForm() {
  const { model } = view;
  const general = { ...model, key: "", fields: model.fields.filter((field) => !isSection(field)) };
  const cards = model.fields.filter(isSection).map((field) => draw(field, 0));
  const first = section(general, 0, ...fieldsOf(general, 0));
  places.set(model, places.get(general));
  view.parts.form.replaceChildren(first, ...cards);
  suggest();
}

// Suggests the files of this server for the paths of an experiment; any other path can be typed.
async function suggest() {
  const mine = view;
  if (mine.kind !== "experiments") return;
  for (const [key, kind] of [["bench", "benches"], ["cell", "cells"]]) {
    const field = mine.model.fields.find((one) => one.key === key);
    if (!field || field.kind !== "words") continue;
    mine.known[kind] ||= mine.ctx.get(`/files/${kind}`).catch(() => []);
    const names = await mine.known[kind];
    if (view !== mine || !places.get(field)) return;
    const paths = names.map(({ name }) => el("option", { value: `../${kind}/${name}.toml` }));
    const list = el("datalist", { id: id("names") }, ...paths);
    places.get(field).box.append(list);
    places.get(field).control.setAttribute("list", list.id);
  }
}

// ---- mistakes -----------------------------------------------------------------------------------

function mark(node, words) {
  const { control, mistake } = places.get(node);
  mistake.hidden = !words;
  text(mistake, words ? `▲ ${words}` : "");
  const before = (control.getAttribute("aria-describedby") || "").split(" ");
  const described = before.filter((one) => one && one !== mistake.id);
  if (words) described.push(mistake.id);
  if (described.length) control.setAttribute("aria-describedby", described.join(" "));
  else control.removeAttribute("aria-describedby");
  const isControl = /^(INPUT|SELECT|TEXTAREA)$/.test(control.tagName);
  if (words && isControl) control.setAttribute("aria-invalid", "true");
  else control.removeAttribute("aria-invalid");
}

function goTo(node) {
  const { control } = places.get(node);
  for (let one = control.parentElement; one; one = one.parentElement) if (one.tagName === "DETAILS") one.open = true;
  control.focus();
  control.scrollIntoView({ block: "center" });
}

// If the server names a missing key, returns the field of that key.
function fieldOf(mistake) {
  const missing = /missing field `([^`]+)`/.exec(mistake.message);
  const path = mistake.field.startsWith("(") ? "" : mistake.field;
  if (!missing) return path;
  const whole = path ? `${path}.${missing[1]}` : missing[1];
  return schema.placeOf(view.model, whole).exact ? whole : path;
}

function allMistakes() {
  if (view.wrong.length)
    return view.wrong.map(({ node, path, code }) => ({ node, exact: true, path, message: WORDS.wrong[code] }));
  const found = (view.answer && view.answer.mistakes) || [];
  return found.map((mistake) => {
    const path = fieldOf(mistake);
    const place = path ? schema.placeOf(view.model, path) : { node: null, exact: false };
    return { ...place, path: mistake.field || WORDS.mistakes.whole, message: mistake.message, line: mistake.line };
  });
}

function mistakeLine({ node, exact, path, message, line }) {
  const label = exact ? WORDS.mistakes.go : WORDS.mistakes.near;
  const shown = node && node !== view.model && places.has(node);
  const go = shown ? button(label, () => goTo(node), { "aria-label": WORDS.mistakes.goTo(label, path) }) : null;
  return el("li", {}, el("code", {}, path), `: ${message}${line ? WORDS.mistakes.line(line) : ""} `, go);
}

function showMistakes() {
  view.marked.filter((node) => places.has(node)).forEach((node) => mark(node, ""));
  view.marked = [];
  const found = allMistakes();
  for (const { node, exact, message } of found) {
    if (!node || !exact || !places.has(node) || view.marked.includes(node)) continue;
    mark(node, message);
    view.marked.push(node);
  }
  const { mistakes } = view.parts;
  mistakes.hidden = !found.length;
  if (!found.length) return mistakes.replaceChildren();
  const own = id("mistakes");
  mistakes.setAttribute("aria-labelledby", own);
  const head = el("strong", { id: own }, WORDS.mistakes.head(found.length));
  return mistakes.replaceChildren(head, el("ul", {}, ...found.map(mistakeLine)));
}

// ---- the check ----------------------------------------------------------------------------------

// After a change of the form, the form is authoritative.
function changed() {
  view.source = "form";
  touched(WAIT_MS);
}

// After a change of the text, the text is authoritative, and the form waits until it has been parsed.
function typed(words) {
  view.source = "text";
  view.text = words;
  view.typedText = true;
  touched(WAIT_MS);
}

function touched(wait) {
  keep();
  soon(wait);
}

function soon(wait) {
  view.asked += 1;
  view.state = "waits";
  closeConfirm();
  clearTimeout(view.timer);
  const mine = view;
  view.timer = setTimeout(() => view === mine && check(), wait);
  drawState();
}

// An experiment is judged on a bench, any other file by its kind.
function ask(said) {
  const { kind, name, bench } = view;
  const on = kind === "experiments" ? { bench: bench || null } : { kind, name };
  return view.ctx.post("/drafts", { ...said, ...on });
}

// Writes a change of the form into the text that was parsed last, so that its comments stay. If the result has another
// meaning, the server rewrites the text.
async function draft() {
  if (view.source === "text") return ask({ text: view.text });
  const { value } = schema.valueOf(view.model);
  const patched = view.base && schema.patch(view.base.text, view.base.value, value);
  const [mine, asked] = [view, view.asked];
  const answer = patched ? await ask({ text: patched }) : null;
  if (view !== mine || view.asked !== asked) return null;
  if (answer && schema.equal(answer.value, value)) return { ...answer, kept: true };
  return ask({ value });
}

async function check() {
  const mine = view;
  const asked = (mine.asked += 1);
  mine.wrong = mine.source === "form" ? schema.valueOf(mine.model).wrong : [];
  if (mine.wrong.length) return settle("wrong");
  try {
    const answer = await draft();
    if (view !== mine || asked !== mine.asked) return undefined;
    accept(answer);
  } catch (error) {
    if (view !== mine || asked !== mine.asked) return undefined;
    unchecked(error);
  }
  return undefined;
}

function settle(state) {
  view.state = state;
  if (state !== "checked") view.answer = null;
  showMistakes();
  drawState();
}

// The latest answer. A text that could be read becomes the form.
function accept(answer) {
  view.answer = answer;
  if (view.source === "form") {
    view.text = answer.text;
    view.bare = !answer.kept && Boolean(view.base) && /(^|[\s\]"'])#/m.test(view.base.text);
  } else if (isReadable(answer)) readText(answer);
  settle("checked");
}

function readText({ value }) {
  view.base = { text: view.text, value };
  view.bare = false;
  if (!view.typedText) return;
  view.typedText = false;
  if (!schema.equal(schema.valueOf(view.model).value, value)) become(value);
}

const isReadable = ({ value }) => value !== null && typeof value === "object";

function become(value) {
  view.model = schema.modelOf(view.schema, value);
  drawForm();
}

function unchecked(error) {
  view.notChecked = reasonOf(error);
  settle("failed");
}

// ---- result of the check ------------------------------------------------------------------------

function statusWords() {
  const { answer } = view;
  if (view.state === "waits") return WORDS.check.going;
  if (view.state === "failed") return WORDS.check.failed(view.notChecked);
  if (view.state === "wrong" || answer.mistakes.length) return WORDS.check.wrong;
  return answer.plan ? WORDS.check.fineFor(duration(answer.plan.expected_s)) : WORDS.check.fine;
}

// Returns why the form cannot be used now, or nothing.
function formWaits() {
  if (view.large) return WORDS.stale.large;
  if (view.source !== "text" || !view.typedText) return "";
  return view.state === "waits" ? WORDS.stale.reading : WORDS.stale.unreadable;
}

function drawState() {
  const { parts } = view;
  view.large = schema.tooLarge(view.model);
  const words = statusWords();
  text(parts.status, words);
  parts.status.className = view.state === "failed" || words === WORDS.check.wrong ? "bad" : "";
  parts.again.hidden = view.state !== "failed";
  const waits = formWaits();
  parts.form.inert = Boolean(waits);
  parts.form.classList.toggle("fm-waits", Boolean(waits));
  parts.waits.hidden = !waits;
  text(parts.waitsWords, waits);
  parts.takeBack.hidden = waits !== WORDS.stale.unreadable;
  drawText();
  if (view.state === "checked") drawPlan();
  // An outdated plan is hidden; while a reply is pending, the last one stays.
  parts.plan.hidden = view.state === "failed" || view.state === "wrong" || !parts.plan.childNodes.length;
  drawReasons();
}

function drawText() {
  const { area, comments, fileWaits, fileActs } = view.parts;
  const behind = view.source === "form" && view.state !== "checked";
  // Written only if it differs, so that the cursor stays.
  if (area.value !== view.text) area.value = view.text;
  area.readOnly = behind;
  // A text without the last change cannot be submitted.
  for (const act of fileActs) act.disabled = behind;
  fileWaits.hidden = !(view.source === "form" && (view.state === "wrong" || view.state === "failed"));
  comments.hidden = !(view.source === "form" && view.bare);
}

function drawPlan() {
  const { plan, margins } = view.answer;
  if (!plan) return view.parts.plan.replaceChildren();
  const open = Boolean(view.parts.plan.querySelector("details[open]"));
  const charge = chargeWords(plan);
  const rows = [
    [WORDS.check.expected, duration(plan.expected_s)],
    [WORDS.check.longest, duration(plan.longest_s)],
    ...(charge ? [[WORDS.check.charge, charge]] : []),
  ];
  const facts = rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]);
  return fill(
    view.parts.plan,
    el("dl", { class: "facts" }, ...facts),
    el("h4", { class: "fm-h" }, WORDS.check.margins),
    ...(margins && margins.length ? margins.map(marginBar) : [el("p", { class: "quiet" }, WORDS.check.noMargins)]),
    stagesOf(plan, open),
  );
}

function stagesOf(plan, open) {
  const steps = plan.stages.reduce((sum, stage) => sum + stage.steps.length, 0);
  const stage = (one) =>
    el(
      "li",
      {},
      el("strong", {}, WORDS.check.stage(one.purpose, duration(one.expected_s))),
      el("ol", {}, ...one.steps.map((step) => el("li", {}, step))),
    );
  const list = el("ol", { class: "fm-stages" }, ...plan.stages.map(stage));
  return el("details", { open }, el("summary", {}, WORDS.check.plan(plan.stages.length, steps)), list);
}

// Shows where the plan lies between the limits, with the margin as text.
function marginBar(limit) {
  const { quantity, unit, planned_least, planned_greatest, least, greatest } = limit;
  const [level, words] = marginWords(limit);
  const planned = WORDS.margin.range(figure(planned_least, unit), figure(planned_greatest, unit), unit);
  const limits = WORDS.margin.limits(figure(least, unit), figure(greatest, unit), unit);
  const name = `${quantity}: ${words}; ${planned}; ${limits}`;
  const meter = el("div", { class: `meter ${level}`, role: "img", "aria-label": name });
  const span = meterSpan(limit);
  if (span) meter.append(span);
  return el(
    "div",
    { class: "limit" },
    el("span", {}, quantity),
    meter,
    el("span", { class: level }, words),
    el("small", {}, `${planned}; ${limits}`),
  );
}

function meterSpan({ planned_least, planned_greatest, least, greatest }) {
  if (!known(greatest) || !known(planned_greatest)) return null;
  const low = known(least) ? least : Math.min(0, planned_least ?? 0);
  const at = (value) => Math.max(0, Math.min(100, (100 * (value - low)) / (greatest - low)));
  const [from, to] = [at(planned_least ?? low), at(planned_greatest)];
  const span = el("span", { class: "fm-span" });
  span.style.setProperty("left", `${from}%`);
  span.style.setProperty("width", `${Math.max(1, to - from)}%`);
  return span;
}

// ---- the file -----------------------------------------------------------------------------------

async function copy() {
  const { area, fileSaid } = view.parts;
  try {
    await navigator.clipboard.writeText(area.value);
    text(fileSaid, WORDS.file.copied);
  } catch {
    // Without https a page cannot write to the clipboard directly.
    area.focus();
    area.select();
    text(fileSaid, WORDS.file.select);
  }
}

function download() {
  const value = schema.valueOf(view.model).value;
  const name = view.name || (typeof value.name === "string" && value.name) || WORDS.one[view.kind];
  saveBlob(new Blob([view.text], { type: "application/toml" }), `${name.replace(/[^\w-]+/g, "_")}.toml`);
}

function filePanel() {
  const own = id("text");
  const parts = view.parts;
  parts.area = el("textarea", {
    id: own,
    class: "fm-text",
    rows: 16,
    spellcheck: "false",
    autocomplete: "off",
    wrap: "off",
    oninput: (event) => typed(event.target.value),
  });
  parts.fileActs = [button(WORDS.file.copy, copy), button(WORDS.file.save, download)];
  parts.fileSaid = el("span", { role: "status", class: "quiet" });
  parts.fileWaits = el("p", { class: "note", hidden: true }, WORDS.file.waits);
  const back = () => {
    parts.area.focus();
    typed(view.base.text);
  };
  const comments = [el("p", {}, WORDS.file.comments), button(WORDS.file.before, back)];
  parts.comments = el("div", { class: "note", hidden: true }, ...comments);
  const details = el(
    "details",
    { class: "fm-file", ontoggle: () => view.parts.grid.classList.toggle("fm-beside", details.open) },
    el("summary", {}, WORDS.file.title),
    parts.fileWaits,
    el("label", { for: own, class: "fm-label" }, WORDS.file.label),
    parts.area,
    el("div", { class: "acts" }, ...parts.fileActs, parts.fileSaid),
  );
  return el("div", { class: "fm-group fm-card" }, details, parts.comments);
}

// ---- submitting ---------------------------------------------------------------------------------

const scopeReason = () => {
  if (view.ctx.may("energise")) return "";
  return WORDS.submit.reasonScope(SCOPES.filter((one) => view.ctx.may(one)).join(", ") || WORDS.submit.noScope);
};

const seedValue = () => (/^[0-9]+$/.test(view.seed.trim()) ? Number(view.seed) : NaN);
const seedIsFine = () => !view.seed.trim() || Number.isSafeInteger(seedValue());

function checkReason() {
  if (view.state === "wrong" || (view.answer && view.answer.mistakes.length)) return WORDS.submit.reasonMistake;
  if (view.state === "failed") return WORDS.submit.reasonFailed;
  return view.state === "waits" ? WORDS.submit.reasonWaits : "";
}

function submitReason() {
  const reason = scopeReason() || checkReason();
  if (reason) return reason;
  if (!view.bench) return WORDS.submit.reasonBench;
  if (!view.answer.plan) return WORDS.submit.reasonPlan;
  return seedIsFine() ? "" : WORDS.submit.reasonSeed;
}

function saveReason() {
  const reason = scopeReason() || checkReason();
  if (reason) return reason;
  if (view.text === view.file.text && !view.conflict) return WORDS.save.reasonSame;
  return view.why.trim() ? "" : WORDS.save.reasonWhy;
}

function drawReasons() {
  const reason = view.busy ? "" : view.file ? saveReason() : submitReason();
  view.parts.go.disabled = view.busy || Boolean(reason);
  text(view.parts.reason, reason);
}

function submitPanel() {
  const parts = view.parts;
  parts.reason = el("p", { id: id("reason"), class: "quiet" });
  parts.go = button(WORDS.submit.button, confirm, { "aria-describedby": parts.reason.id });
  parts.confirm = placeOf(id("confirm"));
  parts.said = el("div", { role: "status" });
  const seed = el("input", {
    type: "text",
    inputmode: "numeric",
    autocomplete: "off",
    placeholder: WORDS.submit.seedHint,
    value: view.seed,
    oninput: (event) => {
      view.seed = event.target.value;
      keep();
      closeConfirm();
      drawReasons();
    },
  });
  const acts = el("div", { class: "acts" }, el("label", {}, WORDS.submit.seed, seed), parts.go);
  return [acts, parts.reason, parts.confirm, parts.said];
}

function closeConfirm() {
  if (view.parts.confirm) closeAsk(view.parts.confirm);
}

// Asks for a confirmation. The text that was checked is the one that is sent.
function confirm() {
  const mine = view;
  const sent = { text: view.source === "text" ? view.text : view.answer.text, bench: view.bench };
  if (view.seed.trim()) sent.seed = seedValue();
  const done = (item) => {
    forget(mine.path);
    if (view === mine) submitted(item, sent.bench);
  };
  view.parts.said.replaceChildren();
  askFirst(view.parts.confirm, {
    bench: view.bench,
    draft: view.answer,
    go: WORDS.submit.go(view.bench),
    send: () => mine.ctx.post("/queue", sent),
    done,
    back: view.parts.go,
  });
}

// Shows a running action, which cannot start twice.
function busy(words) {
  view.busy = Boolean(words);
  if (words) text(view.parts.said, words);
  drawReasons();
}

function said(level, ...children) {
  const line = el("p", { class: level, tabindex: "-1" }, ...children);
  view.parts.said.replaceChildren(line);
  line.focus();
}

function submitted(item, bench) {
  said(
    "good",
    WORDS.submit.done(item.run, bench),
    link(`#${encodeURIComponent(bench)}`, WORDS.submit.seeBench(bench)),
    " ",
    link(address("run", item.run), WORDS.submit.seeRun(item.run)),
  );
}

// ---- saving -------------------------------------------------------------------------------------

function savePanel() {
  const parts = view.parts;
  parts.reason = el("p", { id: id("reason"), class: "quiet" });
  const words = isBench() ? WORDS.save.proposeButton : WORDS.save.button;
  parts.go = button(words, () => save(view.was), { "aria-describedby": parts.reason.id });
  parts.said = el("div", { role: "status" });
  parts.conflict = el("div", { hidden: true });
  parts.why = el("input", {
    type: "text",
    autocomplete: "off",
    maxlength: 1000,
    required: true,
    value: view.why,
    oninput: (event) => {
      view.why = event.target.value;
      keep();
      drawReasons();
    },
  });
  const why = el("label", { class: "fm-why" }, WORDS.save.why, WORDS.form.required, parts.why);
  return [
    el("h3", { class: "fm-h" }, isBench() ? WORDS.save.propose : WORDS.save.title),
    el("div", { class: "acts" }, why, parts.go),
    parts.reason,
    parts.said,
    parts.conflict,
  ];
}

const pathOf = (kind, name) => `/files/${kind}/${encodeURIComponent(name)}`;

async function save(was) {
  const mine = view;
  busy(WORDS.save.sending);
  try {
    const sent = { text: mine.text, why: mine.why.trim(), was_sha256: was ?? null };
    const file = await mine.ctx.put(pathOf(mine.kind, mine.name), sent);
    forget(mine.path);
    if (view === mine) saved(file, sent.text);
  } catch (error) {
    if (view !== mine) return;
    await notSaved(error);
  }
  if (view === mine) busy("");
}

async function notSaved(error) {
  if (!isRefusal(error)) return said("bad", WORDS.save.lost(reasonOf(error)));
  if (error.status === 409) return conflict(error);
  const mistake = error.status === 422 ? mistakeOf(error.message) : null;
  if (mistake && view.state === "checked") {
    view.answer.mistakes = [mistake];
    settle("checked");
  }
  return said("bad", WORDS.save.refused(reasonOf(error)));
}

// The field that a refusal names, as in `text: line 3, capacity: expected …`.
function mistakeOf(words) {
  const found = /^text: (?:line (\d+), )?([\w.-]+|\([\w ]+\)): (.*)$/s.exec(words);
  return found && { line: found[1] ? Number(found[1]) : null, field: found[2], message: found[3] };
}

// Text that was typed while the reply was pending stays, as a change of the new version.
function saved(file, sent) {
  const later = view.text !== sent || view.state === "waits" || view.state === "wrong";
  takeFile(file);
  view.why = view.parts.why.value = "";
  closeConflict();
  if (later) keep();
  else show(file.text, file.value);
  drawVersions();
  drawForce();
  said("good", doneWords(file));
}

function doneWords({ proposed }) {
  if (!isBench()) return WORDS.save.done;
  return known(proposed) ? WORDS.save.proposed(proposed) : WORDS.save.withdrawn;
}

function takeFile(file) {
  view.file = file;
  view.was = file.sha256;
}

// Shows the text and the form of a file without changes.
function show(words, value) {
  Object.assign(view, { source: "text", text: words, typedText: false });
  become(value);
  soon(0);
}

function closeConflict() {
  view.conflict = null;
  view.parts.conflict.hidden = true;
  view.parts.conflict.replaceChildren();
}

// Another user has changed the file: both texts are kept, and the user decides.
async function conflict(error) {
  const mine = view;
  const theirs = await mine.ctx.get(pathOf(mine.kind, mine.name)).catch(() => null);
  if (view !== mine) return;
  if (!theirs) return said("bad", WORDS.save.conflict);
  // It was refused for another reason.
  if (theirs.sha256 === view.was) return said("bad", WORDS.save.refused(reasonOf(error)));
  view.conflict = theirs;
  const last = newestFirst(theirs.versions)[0];
  const by = last ? el("p", {}, WORDS.save.conflictLast(person(last.by), when(last.unix_s), last.why)) : null;
  const takeTheirs = () => {
    forget(view.path);
    takeFile(theirs);
    closeConflict();
    show(theirs.text, theirs.value);
    drawVersions();
    drawForce();
    view.parts.why.focus();
  };
  view.parts.conflict.replaceChildren(
    ...[by].filter(Boolean),
    el("p", {}, el("strong", {}, WORDS.save.difference)),
    difference(theirs.text, view.text, WORDS.save.difference),
    el(
      "div",
      { class: "acts" },
      button(WORDS.save.mine, () => save(theirs.sha256)),
      button(WORDS.save.theirs, takeTheirs),
    ),
  );
  view.parts.conflict.hidden = false;
  drawVersions(theirs);
  said("bad", WORDS.save.conflict);
}

// ---- the file of a bench in force ---------------------------------------------------------------

const isBench = () => view.kind === "benches";

function changesTable(changes, own) {
  if (!changes.length) return el("p", { class: "quiet" }, WORDS.force.none);
  const { columns, absent } = WORDS.force;
  const cell = (value, name) =>
    el("td", { "data-name": name }, value === null ? el("span", { class: "quiet" }, absent) : el("code", {}, value));
  const row = ({ key, was, now }) =>
    el(
      "tr",
      {},
      el("th", { scope: "row", "data-name": columns[0] }, el("code", {}, key)),
      cell(was, columns[1]),
      cell(now, columns[2]),
    );
  const table = el(
    "table",
    { class: "fm-changes" },
    el("thead", {}, el("tr", {}, ...columns.map((name) => el("th", { scope: "col" }, name)))),
    el("tbody", {}, ...changes.map(row)),
  );
  return el("div", { class: "scroll stack", role: "region", "aria-labelledby": own, tabindex: "0" }, table);
}

// Shows a proposal, its author, and its difference from the file in force.
function proposal({ proposed, versions, changes }) {
  const one = versions.find(({ version }) => version === proposed);
  const own = id("force");
  return el(
    "div",
    { class: "note" },
    el("p", {}, el("strong", {}, WORDS.force.head(proposed))),
    one ? el("p", {}, WORDS.force.by(person(one.by), when(one.unix_s), one.why)) : null,
    el("p", {}, WORDS.force.shown),
    el("h3", { id: own, class: "fm-h" }, WORDS.force.title),
    changesTable(changes || [], own),
    el("p", {}, WORDS.force.take),
    el("pre", { class: "fm-pre fm-command" }, WORDS.force.command(view.name, proposed)),
    el("p", { class: "quiet" }, WORDS.force.server, " ", WORDS.force.withdraw),
  );
}

function drawForce() {
  const { force } = view.parts;
  if (!force) return;
  const { file } = view;
  const restart = file.restart ? el("p", { class: "bad", role: "alert" }, WORDS.force.restart(file.restart)) : null;
  const words = known(file.proposed) ? proposal(file) : el("p", { class: "quiet" }, WORDS.force.fine);
  force.replaceChildren(...[restart, words].filter(Boolean));
}

// ---- versions -----------------------------------------------------------------------------------

const newestFirst = (versions) => [...versions].sort((a, b) => b.version - a.version);

// Unchanged lines far from any difference are hidden.
function near(found) {
  const differs = found.map(([sign]) => sign !== " ");
  return found.filter((_, place) => differs.slice(Math.max(0, place - 3), place + 4).some(Boolean));
}

function difference(old, now, label) {
  const found = near(schema.lines(old, now));
  if (!found.length) return el("p", {}, WORDS.versions.same);
  const kinds = { "+": ["ins", WORDS.versions.added], "-": ["del", WORDS.versions.removed], " ": ["span", null] };
  const line = ([sign, words]) => {
    const [name, title] = kinds[sign];
    return el(name, { class: "fm-diff", title }, `${sign === "-" ? "−" : sign} ${words}\n`);
  };
  return el("pre", { class: "scroll fm-pre", tabindex: "0", role: "region", "aria-label": label }, ...found.map(line));
}

function oldPanel(title, ...children) {
  const box = view.parts.old;
  const head = el("h4", { class: "fm-h", tabindex: "-1" }, title);
  const shut = () => {
    box.replaceChildren();
    view.parts.versionsHead.focus();
  };
  box.replaceChildren(head, ...children, el("div", { class: "acts" }, button(WORDS.versions.close, shut)));
  head.focus();
}

async function ofVersion(version, then) {
  const mine = view;
  const path = `${pathOf(mine.kind, mine.name)}?version=${encodeURIComponent(version)}`;
  const old = await mine.ctx.attempt(() => mine.ctx.get(path));
  if (old && view === mine) then(old);
}

function look(version, old) {
  const title = WORDS.versions.lookAt(version);
  const pre = { class: "scroll fm-pre", tabindex: "0", role: "region", "aria-label": title };
  oldPanel(title, el("pre", pre, old.text));
}

function compare(version, old) {
  const title = WORDS.versions.compared(version);
  oldPanel(title, difference(old.text, view.text, title));
}

const isChanged = () => view.text !== view.file.text || view.state === "wrong" || view.state === "waits";

function takeBack(version, old) {
  const go = () => {
    view.parts.old.replaceChildren();
    view.why ||= WORDS.versions.backWhy(version);
    view.parts.why.value = view.why;
    typed(old.text);
    text(view.parts.said, WORDS.versions.backSaid(version));
    view.parts.why.focus();
  };
  if (!isChanged()) return go();
  const acts = el("div", { class: "acts" }, button(WORDS.versions.yes, go));
  return oldPanel(WORDS.versions.replace(version), acts);
}

// Returns the state of a version: for a bench, the file itself is in force, and at most one version is proposed.
function standing({ version }, isNow) {
  if (!isBench()) return isNow ? WORDS.versions.now : "";
  if (version === 0) return WORDS.versions.inForce;
  return version === view.file.proposed ? WORDS.versions.proposed : "";
}

function versionRow(one, isNow) {
  const { head } = WORDS.versions;
  const act = (label, work) =>
    button(label, () => ofVersion(one.version, (old) => work(one.version, old)), {
      "aria-label": `${label}: ${WORDS.versions.lookAt(one.version)}`,
    });
  const acts = [
    act(WORDS.versions.look, look),
    act(WORDS.versions.compare, compare),
    act(WORDS.versions.back, takeBack),
  ];
  return el(
    "tr",
    {},
    el("th", { scope: "row", "data-name": head[0] }, `${one.version}${standing(one, isNow)}`),
    el("td", { "data-name": head[1] }, when(one.unix_s)),
    el("td", { "data-name": head[2] }, person(one.by)),
    el("td", { "data-name": head[3] }, one.why),
    el("td", {}, el("div", { class: "fm-acts" }, ...acts)),
  );
}

function drawVersions(file = view.file) {
  const found = newestFirst(file.versions);
  const now = found.find((one) => one.sha256 === file.sha256);
  const head = WORDS.versions.head.map((name) => el(name ? "th" : "td", name ? { scope: "col" } : {}, name));
  const table = el(
    "table",
    {},
    el("thead", {}, el("tr", {}, ...head)),
    el("tbody", {}, ...found.map((one) => versionRow(one, one === now))),
  );
  view.parts.versions.replaceChildren(found.length ? table : el("p", { class: "quiet" }, WORDS.versions.none));
}

function versionsPanel() {
  const parts = view.parts;
  const own = id("versions");
  parts.versionsHead = el("h3", { id: own, class: "fm-h", tabindex: "-1" }, WORDS.versions.title);
  parts.versions = el("div", { class: "scroll stack", role: "region", "aria-labelledby": own, tabindex: "0" });
  parts.old = el("div", {});
  return el("div", { class: "fm-group fm-card" }, parts.versionsHead, parts.versions, parts.old);
}

// ---- the parts of the page ----------------------------------------------------------------------

function benchSelect() {
  const names = view.benches;
  const choices = names.includes(view.bench) ? names : ["", ...names];
  const onchange = (event) => {
    view.bench = event.target.value;
    touched(0);
  };
  const option = (name) => el("option", { value: name, selected: name === view.bench }, name || WORDS.check.noBench);
  return el("label", {}, WORDS.check.bench, el("select", { onchange }, ...choices.map(option)));
}

function checkPanel() {
  const parts = view.parts;
  const experiment = view.kind === "experiments";
  parts.status = el("p", { role: "status" });
  parts.again = button(WORDS.again, () => soon(0), { hidden: true });
  parts.plan = el("div", { class: "fm-plan" });
  return el(
    "div",
    { class: "fm-group fm-card" },
    el("h3", { class: "fm-h" }, experiment ? WORDS.check.title : WORDS.check.titleFile),
    parts.status,
    parts.again,
    experiment ? el("div", { class: "acts" }, benchSelect()) : null,
    parts.plan,
    ...(view.file ? savePanel() : submitPanel()),
  );
}

// The form on the left, its plan and the text on the right; one below the other on a narrow page.
function drawAll() {
  const parts = view.parts;
  const back = () => {
    view.typedText = false;
    view.source = "form";
    touched(0);
  };
  parts.kept = el("p", { class: "bad", role: "alert", hidden: true }, WORDS.draft.full);
  parts.mistakes = el("div", { class: "fm-mistakes", role: "group", hidden: true });
  parts.waitsWords = el("span", {});
  parts.takeBack = button(WORDS.stale.takeBack, back);
  parts.waits = el("p", { class: "note", hidden: true }, parts.waitsWords, " ", parts.takeBack);
  parts.form = el("div", { class: "fm-form" });
  parts.force = isBench() ? el("div", { class: "fm-force" }) : null;
  const left = [parts.force, parts.kept, parts.mistakes, parts.waits, parts.form, view.file ? versionsPanel() : null];
  const side = el("div", { class: "fm-side" }, filePanel(), checkPanel());
  parts.grid = el("div", { class: "fm-two" }, el("div", { class: "fm-left" }, ...left), side);
  view.body.replaceChildren(parts.grid);
  drawForm();
  if (view.file) drawVersions();
  drawForce();
  soon(0);
}

function newView(parent, path, ctx) {
  const title = el("h2", { tabindex: "-1" });
  const links = el("p", { class: "fm-links" });
  const body = el("div", {}, el("p", { role: "status" }, WORDS.loading));
  parent.replaceChildren(el("div", { class: "fm-view" }, title, links, body));
  view = { ctx, path, title, links, body, parts: {}, known: {}, marked: [], wrong: [], asked: 0, showMistakes };
  Object.assign(view, { bench: "", seed: "", why: "", was: null, base: null, file: null, name: "" });
  return view;
}

// Loads the initial content: a text and its value, or an empty form; before that, a stored draft.
async function begin(mine, kind, load) {
  try {
    const asked = [mine.ctx.get(`/schemas/${SCHEMAS[kind]}`), benchNames(mine.ctx), load()];
    const [known, benches, first] = await Promise.all(asked);
    if (view !== mine) return;
    const bench = mine.ctx.bench() || (benches.length === 1 ? benches[0] : "");
    Object.assign(mine, { kind, schema: known, benches, bench });
    if (first.file) takeFile(first.file);
    const draft = stored(mine.path);
    if (draft) offer(draft, first);
    else fresh(first);
  } catch (error) {
    if (view === mine) failed(error, () => begin(mine, kind, load));
  }
}

// A page that was opened at this address does not know its benches yet.
async function benchNames(ctx) {
  const known = ctx.benches();
  return known.length ? known : (await ctx.get("/benches")).map(({ bench }) => bench);
}

function failed(error, again) {
  const words = el("p", { class: "bad", role: "alert" }, WORDS.notLoaded(reasonOf(error)));
  view.body.replaceChildren(words, button(WORDS.again, again));
}

function fresh(first) {
  view.model = schema.modelOf(view.schema, first.value);
  const source = first.text === undefined ? "form" : "text";
  Object.assign(view, { source, text: first.text || "", typedText: Boolean(first.unread) });
  if (first.bench && view.benches.includes(first.bench)) view.bench = first.bench;
  drawAll();
  if (first.unread) keep();
}

function resume(draft) {
  view.model = schema.takeUp(view.schema, draft.aside);
  const { source, text: words, base, typedText, seed, why, was } = draft;
  const bench = view.benches.includes(draft.bench) ? draft.bench : "";
  Object.assign(view, { source, text: words, base, typedText, seed, why, was, bench });
  drawAll();
}

// Until the user decides about the draft, nothing is shown that could overwrite it.
function offer(draft, first) {
  const drop = () => {
    forget(view.path);
    if (first.start) drawStart(view);
    else fresh(first);
    view.title.focus();
  };
  const take = () => {
    resume(draft);
    view.title.focus();
  };
  const acts = el("div", { class: "acts" }, button(WORDS.draft.take, take), button(WORDS.draft.drop, drop));
  view.body.replaceChildren(
    el("div", { class: "fm-group fm-card" }, el("p", {}, WORDS.draft.words(clock(draft.at))), acts),
  );
}

// ---- addresses ----------------------------------------------------------------------------------

function startList(title, found, item) {
  const list = found.length ? el("ul", {}, ...found.map(item)) : el("p", { class: "quiet" }, WORDS.start.none);
  return el("div", { class: "fm-group fm-card" }, el("h3", { class: "fm-h" }, title), list);
}

async function lists(mine, ...paths) {
  const caught = (path) => mine.ctx.get(path).catch((error) => ({ error }));
  return Promise.all(paths.map(caught));
}

// Returns a list, or text that explains why there is none.
function orWhy(title, answer, found, item) {
  if (!answer.error) return startList(title, found(answer), item);
  const words = el("p", { class: "bad" }, WORDS.start.unread(reasonOf(answer.error)));
  return el("div", { class: "fm-group fm-card" }, el("h3", { class: "fm-h" }, title), words);
}

function otherStarts(mine) {
  const open = async (event) => {
    const [file] = event.target.files;
    if (!file) return;
    const words = await file.text();
    if (view === mine) begin(mine, "experiments", async () => ({ text: words, value: {}, unread: true }));
  };
  const box = el("input", { type: "file", accept: ".toml", onchange: open });
  const empty = () => begin(mine, "experiments", async () => ({ value: {} }));
  return el(
    "div",
    { class: "fm-group fm-card" },
    el("h3", { class: "fm-h" }, WORDS.start.other),
    el("div", { class: "acts" }, button(WORDS.start.empty, empty), el("label", {}, WORDS.start.file, box)),
  );
}

async function openStart(mine) {
  text(mine.title, WORDS.newTitle);
  if (stored(mine.path)) return begin(mine, "experiments", async () => ({ value: {}, start: true }));
  return drawStart(mine);
}

async function drawStart(mine) {
  const [experiments, runs] = await lists(mine, "/files/experiments", "/catalog/runs?most=20");
  if (view !== mine) return;
  mine.body.replaceChildren(
    orWhy(WORDS.start.experiments, experiments, (all) => all, ({ name }) =>
      el("li", {}, link(address("new", "experiment", name), name)),
    ),
    orWhy(WORDS.start.runs, runs, ({ runs: found }) => found, ({ name, experiment, started_unix_s }) =>
      el("li", {}, link(address("new", "run", name), name), ` ${experiment}, ${when(started_unix_s)}`),
    ),
    otherStarts(mine),
  );
}

function openRun(mine, run) {
  text(mine.title, WORDS.copyTitle(run));
  return begin(mine, "experiments", () => mine.ctx.get(`/runs/${encodeURIComponent(run)}/experiment`));
}

function openFrom(mine, name) {
  text(mine.title, WORDS.fromTitle(name));
  return begin(mine, "experiments", async () => {
    const { text: words, value } = await mine.ctx.get(pathOf("experiments", name));
    return { text: words, value };
  });
}

function openFile(mine, kind, name) {
  mine.name = name;
  text(mine.title, WORDS.fileTitle(WORDS.one[kind], name));
  const use = kind === "experiments" ? [" ", link(address("new", "experiment", name), WORDS.files.use)] : [];
  mine.links.replaceChildren(link("#/files", WORDS.files.all), ...use);
  return begin(mine, kind, async () => {
    const file = await mine.ctx.get(pathOf(kind, name));
    return { file, text: file.text, value: file.value };
  });
}

async function openFiles(mine, only) {
  const kinds = Object.keys(SCHEMAS).filter((kind) => !only || kind === only);
  text(mine.title, only ? WORDS.kinds[only] : WORDS.filesTitle);
  if (only) mine.links.replaceChildren(link("#/files", WORDS.files.all));
  const answers = await lists(mine, ...kinds.map((kind) => `/files/${kind}`));
  if (view !== mine) return;
  const state = ({ edited, versions, proposed }) => {
    if (known(proposed)) return WORDS.files.proposed(proposed);
    return edited ? WORDS.files.edited(versions) : WORDS.files.asInstalled;
  };
  const item = (kind) => (one) =>
    el("li", {}, link(address("files", kind, one.name), one.name), " ", el("span", { class: "quiet" }, state(one)));
  const cards = kinds.map((kind, place) => orWhy(WORDS.kinds[kind], answers[place], (all) => all, item(kind)));
  mine.body.replaceChildren(...cards);
}

export async function open(parent, { path }, ctx) {
  close();
  const mine = newView(parent, path, ctx);
  const [area, kind, name] = path;
  mine.title.focus();
  if (area === "files" && SCHEMAS[kind] && name) return openFile(mine, kind, name);
  if (area === "files") return openFiles(mine, SCHEMAS[kind] ? kind : "");
  if (kind === "run" && name) return openRun(mine, name);
  if (kind === "experiment" && name) return openFrom(mine, name);
  return openStart(mine);
}

// After the server is back, failed requests are repeated.
export function heard(kind) {
  if (kind === "hello" && view && view.state === "failed") soon(0);
}

export function close() {
  if (view) clearTimeout(view.timer);
  view = null;
}
