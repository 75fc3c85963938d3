// Converts a JSON Schema and a value to the content of a form, and back to the value. Pure: no page, no server.
// Unchanged values are preserved exactly, and so are keys that the schema does not contain.
"use strict";

// Lists longer than this are one text, not a control for each item.
const LONG = 12;
const NUMBER = "[+-]?(?:[0-9]+\\.?[0-9]*|\\.[0-9]+)(?:[eE][+-]?[0-9]+)?";
const A_NUMBER = new RegExp(`^${NUMBER}$`);
const A_WHOLE = /^[+-]?[0-9]+$/;
const A_QUANTITY = new RegExp(`^\\s*(${NUMBER})\\s*(\\S.*?)\\s*$`);
const SHORT_NAMES = new Set(["eis", "ocv", "soc", "rc"]);
// Suffix of a key whose value is a bare number of this unit.
const UNITS_OF_KEYS = new Map([["v", "V"], ["a", "A"], ["s", "s"]]);

// The content of a control is invalid for its field; `code` states why.
class Wrong extends Error {
  constructor(code) {
    super(code);
    this.code = code;
  }
}

// ---- schema -------------------------------------------------------------------------------------

// The keys of a part take precedence over those of the part that it refers to.
function resolve(root, part) {
  if (!part.$ref) return part;
  return { ...root.$defs[part.$ref.slice("#/$defs/".length)], ...part };
}

const SCALARS = { boolean: "switch", integer: "whole", number: "number", string: "words" };

function kindOf(root, part) {
  if (part.oneOf) return part.oneOf.every((one) => typeof one.const === "string") ? "choice" : "anything";
  if (part["x-units"]) return "quantity";
  if (part.type === "object") return part.properties ? "table" : "anything";
  if (part.type !== "array") return SCALARS[part.type] || "anything";
  const of = kindOf(root, resolve(root, part.items || {}));
  if (of === "table") return "tables";
  if (of === "number" || of === "whole") return "list";
  return of === "anything" || of === "tables" || of === "list" || of === "rows" ? "anything" : "rows";
}

const isTable = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

const FITS = {
  table: isTable,
  switch: (value) => typeof value === "boolean",
  whole: Number.isInteger,
  number: Number.isFinite,
  words: (value) => typeof value === "string",
  choice: (value) => typeof value === "string",
  quantity: (value) => typeof value === "string",
  anything: () => true,
};

const fits = (kind, of, value) =>
  FITS[kind] ? FITS[kind](value) : Array.isArray(value) && value.every((one) => FITS[of](one));

// By which kind of control a value is shown; a value of another kind than is wanted as JSON.
function shownAs(root, part, value) {
  const kind = kindOf(root, part);
  const items = part.type === "array" ? resolve(root, part.items || {}) : null;
  const of = items && kindOf(root, items);
  if (value === undefined) return { kind, of, items };
  if (!fits(kind, of, value)) return { kind: "anything", odd: true };
  if (kind !== "rows" || value.length <= LONG) return { kind, of, items };
  const apart = of === "quantity" && value.every((one) => one.trim() && !/[,;\n]/.test(one));
  return apart ? { kind: "list", of, items } : { kind: "anything" };
}

// Returns one of each unit with identical appearance: Ω has two code points, and µ, too.
function unitsOf(part) {
  const seen = new Set();
  return (part["x-units"] || []).filter((unit) => {
    const looks = unit.normalize("NFKC");
    return !seen.has(looks) && seen.add(looks);
  });
}

// Returns a key as text: `soc_reset` is "SOC reset", `voltage_v` is "Voltage (V)".
export function labelOf(key) {
  const [first, ...rest] = key.split("_").map((word) => (SHORT_NAMES.has(word) ? word.toUpperCase() : word));
  const unit = UNITS_OF_KEYS.get(rest[rest.length - 1]);
  if (unit) rest[rest.length - 1] = `(${unit})`;
  return [first.charAt(0).toUpperCase() + first.slice(1), ...rest].join(" ");
}

// Splits a description; every second piece is a name that was in backticks. Links become text.
export function piecesOf(description) {
  return description.replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").split("`");
}

// ---- schema and value to model ------------------------------------------------------------------

// Splits a text into number and unit, if the unit is known.
export function split(text, units) {
  const found = A_QUANTITY.exec(text);
  return found && units.includes(found[2]) ? { number: found[1], unit: found[2] } : null;
}

const TEXTS = {
  switch: String,
  whole: String,
  number: String,
  list: (value) => value.map(String).join(", "),
  anything: (value) => JSON.stringify(value, null, 2),
};

function textOf(kind, value) {
  if (value === undefined) return "";
  return TEXTS[kind] ? TEXTS[kind](value) : value;
}

// The unit that is offered first: of the default, otherwise of the example.
function firstUnit(part) {
  const known = part["x-units"];
  const given = [part.default, ...(part.examples || [])].map((text) => text && split(text, known));
  return (given.find(Boolean) || { unit: known[0] }).unit;
}

function quantity(node, part, value) {
  node.known = part["x-units"];
  const parts = value === undefined ? { number: "", unit: firstUnit(part) } : split(value, node.known);
  // A text that is not a number with a unit is shown as typed, with no unit selected.
  node.text = parts ? parts.number : value;
  node.unit = parts ? parts.unit : "";
  node.units = unitsOf(part);
  if (node.unit && !node.units.includes(node.unit)) node.units.push(node.unit);
}

function leaf(node, part, value) {
  node.raw = value;
  node.fallback = part.default;
  if (node.kind === "choice")
    node.choices = part.oneOf.map((one) => ({ value: one.const, help: one.description || "" }));
  if (node.kind === "list") node.known = node.of === "quantity" ? node.items["x-units"] : null;
  if (node.kind === "quantity") quantity(node, part, value);
  else node.text = textOf(node.kind, value);
  node.start = { text: node.text, unit: node.unit };
  return node;
}

// The keys of a table in the order of the form: present keys, required keys, the rest.
function keysOf(part, value) {
  const there = Object.keys(value || {}).filter((key) => Object.hasOwn(part.properties, key));
  return [...new Set([...there, ...(part.required || []), ...Object.keys(part.properties)])];
}

function table(root, node, part, value) {
  node.on = value !== undefined;
  node.order = Object.keys(value || {});
  const required = part.required || [];
  const own = (key) => (value && Object.hasOwn(value, key) ? value[key] : undefined);
  node.fields = keysOf(part, value).map((key) =>
    build(root, part.properties[key], key, own(key), required.includes(key)),
  );
  for (const key of node.order)
    if (!Object.hasOwn(part.properties, key)) node.fields.push(unknown(key, value[key]));
  return node;
}

const unknown = (key, value) =>
  leaf({ kind: "anything", key, label: key, help: "", needed: false, had: true, unknown: true }, {}, value);

function several(root, node, part, value) {
  node.raw = value;
  node.fallback = part.default;
  const fixed = part.minItems !== undefined && part.minItems === part.maxItems;
  node.size = node.kind === "rows" && fixed ? part.minItems : null;
  node.make = (one) => build(root, part.items, "", one, false);
  node.items = (value || []).map(node.make);
  while (node.items.length < (node.size || 0)) node.items.push(node.make(undefined));
  return node;
}

function build(root, unresolved, key, value, needed) {
  const part = resolve(root, unresolved);
  const node = {
    ...shownAs(root, part, value),
    key,
    label: labelOf(key),
    help: part.description || "",
    needed,
    had: value !== undefined,
  };
  if (node.kind === "table") return table(root, node, part, value);
  if (node.kind === "tables" || node.kind === "rows") return several(root, node, part, value);
  return leaf(node, part, value);
}

export function modelOf(schema, value) {
  return build(schema, schema, "", value, true);
}

// ---- changes of the structure -------------------------------------------------------------------

// A section that is switched on has the sections that it must have.
export function switchTo(node, on) {
  node.on = on;
  const must = node.fields.filter((field) => field.kind === "table" && field.needed);
  if (on) must.forEach((field) => switchTo(field, on));
}

export function add(node) {
  const item = node.make(undefined);
  if (item.kind === "table") switchTo(item, true);
  node.items.push(item);
  return item;
}

export function move(node, from, to) {
  node.items.splice(to, 0, ...node.items.splice(from, 1));
}

// Applies text typed into the box of a number, which may include a unit.
export function type(node, text) {
  const parts = node.kind === "quantity" ? split(text, node.known) : null;
  node.text = parts ? parts.number : text;
  if (!parts) return;
  node.unit = parts.unit;
  if (!node.units.includes(parts.unit)) node.units.push(parts.unit);
}

// ---- model to value -----------------------------------------------------------------------------

function number(text) {
  if (!A_NUMBER.test(text) || !Number.isFinite(Number(text))) throw new Wrong("number");
  return Number(text);
}

function whole(text) {
  if (!A_WHOLE.test(text)) throw new Wrong("whole");
  if (!Number.isSafeInteger(Number(text))) throw new Wrong("large");
  return Number(text);
}

// A file has no null, and no number that JSON has not.
function sayable(value) {
  if (value === null) throw new Wrong("null");
  if (typeof value === "number" && !Number.isFinite(value)) throw new Wrong("number");
  if (typeof value === "object") Object.values(value).forEach(sayable);
  return value;
}

function anything(text) {
  let value;
  try {
    value = JSON.parse(text);
  } catch {
    throw new Wrong("json");
  }
  return sayable(value);
}

function list(node) {
  const apart = node.of === "quantity" ? /[,;\n]+/ : /[\s,;]+/;
  const read = { number, whole, quantity: (text) => text }[node.of];
  const parts = node.text.split(apart).map((part) => part.trim());
  return parts.filter(Boolean).map(read);
}

const READ = {
  words: (node) => node.text,
  choice: (node) => node.text,
  quantity: (node) => (node.unit ? `${node.text.trim()} ${node.unit}` : node.text),
  switch: (node) => node.text === "true",
  number: (node) => number(node.text.trim()),
  whole: (node) => whole(node.text.trim()),
  anything: (node) => anything(node.text),
  list,
};

export const changed = (node) => node.text !== node.start.text || node.unit !== node.start.unit;

// Returns the value of a field with one control; undefined if it is left out.
function leafValue(node) {
  if (!changed(node)) return node.raw;
  if (node.kind === "words" || node.kind === "choice" ? node.text === "" : node.text.trim() === "") return undefined;
  return READ[node.kind](node);
}

function tableValue(node, path, context) {
  if (!node.on && !context.all) return undefined;
  const byKey = new Map(node.fields.map((field) => [field.key, field]));
  const keys = new Set([...node.order, ...byKey.keys()]);
  const found = [...keys].map((key) => [key, nodeValue(byKey.get(key), [...path, key], context)]);
  const there = found.filter(([, value]) => value !== undefined);
  // A section that is off and empty is omitted even with `all`.
  return node.on || there.length ? Object.fromEntries(there) : undefined;
}

function severalValue(node, path, context) {
  const values = node.items.map((item, place) => nodeValue(item, [...path, String(place + 1)], context));
  const there = values.filter((value) => value !== undefined);
  // In a list of fixed length all items or none must exist, because otherwise later items would move up.
  if (node.size && there.length)
    node.items.forEach((item, place) => {
      const missing = values[place] === undefined && !context.wrong.some((one) => one.node === item);
      if (missing) context.wrong.push({ node: item, path: [...path, String(place + 1)].join("."), code: "missing" });
    });
  // An empty list is written if there was one, or if the list is required and was present.
  const empty = node.had && Array.isArray(node.raw) && (node.needed || !node.raw.length);
  return there.length || empty ? there : undefined;
}

function nodeValue(node, path, context) {
  if (node.kind === "table") return tableValue(node, path, context);
  if (node.kind === "tables" || node.kind === "rows") return severalValue(node, path, context);
  try {
    return leafValue(node);
  } catch (error) {
    if (!(error instanceof Wrong)) throw error;
    context.wrong.push({ node, path: path.join("."), code: error.code });
    return undefined;
  }
}

// Returns the value of a form, and invalid fields: `{value, wrong: [{node, path, code}]}`. With `all`, sections that
// are switched off are included.
export function valueOf(model, all = false) {
  const context = { all, wrong: [] };
  const value = nodeValue(model, [], context);
  return { value, wrong: context.wrong };
}

// Returns whether an integer has more digits than JavaScript can represent: it was parsed inexactly, and must not be
// sent back.
export function tooLarge(node) {
  if (node.fields) return node.fields.some(tooLarge);
  if (node.kind === "tables") return node.items.some(tooLarge);
  const values = node.kind === "list" ? node.raw || [] : [node.raw];
  const large = (one) => Math.abs(one) > Number.MAX_SAFE_INTEGER;
  return (node.kind === "whole" || node.of === "whole") && values.some(large);
}

// ---- the path of a field to its place -----------------------------------------------------------

// An item is named by its number from 1, as the line of the file is found, or by its own name.
function child(node, name) {
  if (node.fields) return node.fields.find((field) => field.key === name);
  const named = node.items.find((item) => nameOf(item) === name);
  if (named) return named;
  const counted = node.items.filter((item) => item.kind === "table" || item.text !== "");
  return /^[0-9]+$/.test(name) ? counted[Number(name) - 1] : undefined;
}

export function nameOf(item) {
  const name = item.fields && item.fields.find((field) => field.key === "name");
  return name && name.kind === "words" ? name.text : "";
}

// The place in the form of `eis.amplitude` or `traces.block.repeat`: the node, and whether it is the
// field itself or the nearest section around it. A section that is off shows no field.
export function placeOf(model, path) {
  let node = model;
  for (const name of path.split(".")) {
    const holds = node.kind === "table" || node.kind === "tables" || node.kind === "rows";
    // A part with one control uses that control for everything within it.
    if (!holds) return { node, exact: true };
    const next = node.kind === "table" && !node.on ? undefined : child(node, name);
    if (!next) return { node, exact: false };
    node = next;
  }
  return { node, exact: node !== model };
}

// ---- a draft that is put aside ------------------------------------------------------------------

function stateOf(node) {
  const { on, order } = node;
  if (node.fields) return { on, order, fields: node.fields.map((field) => [field.key, stateOf(field)]) };
  if (node.kind === "tables" || node.kind === "rows") return { items: node.items.map(stateOf) };
  return { text: node.text, unit: node.unit };
}

function restoreTable(node, state) {
  node.on = state.on;
  node.order = state.order;
  for (const [key, inner] of state.fields) {
    let field = node.fields.find((one) => one.key === key);
    if (!field) node.fields.push((field = unknown(key, undefined)));
    restore(field, inner);
  }
}

function restore(node, state) {
  if (node.fields && state.fields) return restoreTable(node, state);
  if (node.make && state.items) {
    while (node.items.length < state.items.length) node.items.push(node.make(undefined));
    state.items.forEach((inner, place) => restore(node.items[place], inner));
  } else if (state.text !== undefined && node.text !== undefined) {
    node.text = state.text;
    node.unit = state.unit;
    // A partial number does not appear in the value, but the user has started to type it.
    node.had ||= node.text !== "";
    if (node.unit && !node.units.includes(node.unit)) node.units.push(node.unit);
  }
  return undefined;
}

// All that a person typed, half a number and the sections that are switched off too.
export const putAside = (model) => ({ value: valueOf(model, true).value, state: stateOf(model) });

export function takeUp(schema, aside) {
  const model = modelOf(schema, aside.value);
  restore(model, aside.state);
  return model;
}

// ---- a change within a text ---------------------------------------------------------------------

// A value in the syntax of a file, as far as it is simple.
const VALUE = /^(?:"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|\[[^[\]#]*\]|[^\s#,[{"']+)/;
const HEAD = /^\s*(\[\[?)\s*([^[\]]+?)\s*\]\]?\s*(?:#.*)?$/;
const PLAIN_KEY = /^[\w-]+$/;

const sorted = (_, value) =>
  isTable(value) ? Object.fromEntries(Object.entries(value).sort(([a], [b]) => (a < b ? -1 : 1))) : value;

// Returns whether two values are equal, regardless of the order of their keys.
export const equal = (a, b) => JSON.stringify(a, sorted) === JSON.stringify(b, sorted);

const isPlain = (value) => (Array.isArray(value) ? value.every(isPlain) : !isTable(value));

function changesOf(was, now, path) {
  return [...new Set([...Object.keys(was), ...Object.keys(now)])].flatMap((key) => {
    const [old, next] = [was, now].map((table) => (Object.hasOwn(table, key) ? table[key] : undefined));
    if (equal(old, next)) return [];
    if (isTable(old) && isTable(next)) return changesOf(old, next, [...path, key]);
    return [{ path, key, old, next }];
  });
}

// The tables of a text: their paths, and their lines without the head.
function tablesOf(all) {
  const found = [{ path: "", from: 0 }];
  all.forEach((line, at) => {
    const head = HEAD.exec(line);
    if (head) found.push({ path: head[2], from: at + 1, many: head[1] === "[[" });
  });
  return found.map((one, place) => ({ ...one, to: place + 1 < found.length ? found[place + 1].from - 1 : all.length }));
}

// Returns the index of the last line with content: comments after it belong to the following section.
const lastSaid = (body) => body.findLastIndex((line) => line.trim() && !line.trim().startsWith("#"));

// Writes a key anew within the lines of its table, takes it out, or puts it behind the last one.
function changeKey(body, key, next) {
  const written = next === undefined ? null : `${key} = ${JSON.stringify(next)}`;
  const text = body.join("\n");
  const found = new RegExp(`^[ \\t]*${key}[ \\t]*=[ \\t]*`, "m").exec(text);
  if (!found) {
    const last = lastSaid(body);
    return written === null ? null : [...body.slice(0, last + 1), written, ...body.slice(last + 1)];
  }
  const from = found.index + found[0].length;
  const value = VALUE.exec(text.slice(from));
  if (!value) return null;
  const rest = text.slice(from + value[0].length);
  if (written !== null) return `${text.slice(0, from)}${JSON.stringify(next)}${rest}`.split("\n");
  return `${text.slice(0, found.index)}${rest.replace(/^[^\n]*\n?/, "")}`.split("\n");
}

function newTable(path, table) {
  const entries = Object.entries(table);
  if (!entries.every(([key]) => PLAIN_KEY.test(key))) return null;
  const plain = entries.filter(([, value]) => isPlain(value));
  const inner = entries.filter(([, value]) => isTable(value)).map(([key, value]) => newTable(`${path}.${key}`, value));
  if (inner.includes(null) || plain.length + inner.length < entries.length) return null;
  const own = plain.map(([key, value]) => `${key} = ${JSON.stringify(value)}`);
  return ["", `[${path}]`, ...own, ...inner.flat()];
}

function changeOne(all, { path, key, old, next }) {
  const name = [...path, key].join(".");
  if (![...path, key].every((part) => PLAIN_KEY.test(part))) return null;
  if (old === undefined && isTable(next)) {
    const made = newTable(name, next);
    return made && [...all.join("\n").trimEnd().split("\n"), ...made, ""];
  }
  if (isTable(old) && next === undefined) {
    const gone = tablesOf(all).filter((one) => one.path === name || one.path.startsWith(`${name}.`));
    const ends = gone.map(({ from, to }) => [from - 1, from + lastSaid(all.slice(from, to))]);
    return gone.length ? all.filter((_, at) => !ends.some(([first, last]) => at >= first && at <= last)) : null;
  }
  if (![old, next].every((value) => value === undefined || isPlain(value))) return null;
  const table = tablesOf(all).find((one) => one.path === path.join(".") && !one.many);
  const body = table && changeKey(all.slice(table.from, table.to), key, next);
  return body ? [...all.slice(0, table.from), ...body, ...all.slice(table.to)] : null;
}

// Returns a text in which only the differences are rewritten, so that its comments stay, or null if that is not simple.
// The caller must parse the result and check that it has the intended content.
export function patch(text, was, now) {
  let all = text.split("\n");
  for (const change of changesOf(was, now, [])) {
    all = changeOne(all, change);
    if (!all) return null;
  }
  return all.join("\n");
}

// ---- lines of two texts -------------------------------------------------------------------------

// Beyond this many pairs of lines, the difference is reported as a whole.
const MOST_PAIRS = 4e6;

// Longest common run of lines, by rows of the table of lengths from the end.
function middle(old, now) {
  if (old.length * now.length > MOST_PAIRS)
    return [...old.map((line) => ["-", line]), ...now.map((line) => ["+", line])];
  const lengths = Array.from({ length: old.length + 1 }, () => new Uint32Array(now.length + 1));
  for (let i = old.length - 1; i >= 0; i -= 1)
    for (let j = now.length - 1; j >= 0; j -= 1)
      lengths[i][j] =
        old[i] === now[j] ? lengths[i + 1][j + 1] + 1 : Math.max(lengths[i + 1][j], lengths[i][j + 1]);
  const found = [];
  let [i, j] = [0, 0];
  while (i < old.length || j < now.length) {
    if (i < old.length && j < now.length && old[i] === now[j]) {
      found.push([" ", old[i]]);
      [i, j] = [i + 1, j + 1];
    } else if (i < old.length && (j === now.length || lengths[i + 1][j] >= lengths[i][j + 1])) {
      found.push(["-", old[i]]);
      i += 1;
    } else {
      found.push(["+", now[j]]);
      j += 1;
    }
  }
  return found;
}

// Returns the difference of lines: `[[" " | "-" | "+", line]]`.
export function lines(oldText, newText) {
  const [old, now] = [oldText.split("\n"), newText.split("\n")];
  let first = 0;
  while (first < old.length && first < now.length && old[first] === now[first]) first += 1;
  let last = 0;
  const least = Math.min(old.length, now.length) - first;
  while (last < least && old[old.length - 1 - last] === now[now.length - 1 - last]) last += 1;
  const same = (line) => [" ", line];
  return [
    ...old.slice(0, first).map(same),
    ...middle(old.slice(first, old.length - last), now.slice(first, now.length - last)),
    ...old.slice(old.length - last).map(same),
  ];
}
