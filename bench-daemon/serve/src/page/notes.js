// Notes on a run or on a cell, with author and time, and a form to add one. The form is never redrawn, so that text in
// it survives any event from the server.
"use strict";

import { el, person, text, when } from "./bench.js";
import { keyed, lack } from "./find.js";

const WORDS = {
  title: "Notes",
  none: "No note yet.",
  field: "New note",
  add: "Add the note",
  added: "The note is added.",
  empty: "Write something first.",
  long: (n, most) => `${n} characters are too many: ${most} at most.`,
};

const MOST = 4000;

// A section of notes within `parent` for `path`; `take(notes)` shows them, `refresh()` requests and shows them.
export function notes(parent, path, ctx) {
  const list = el("ol", { class: "fd-notes" });
  const none = el("p", { class: "quiet" }, WORDS.none);
  const why = lack(ctx, "operate");
  const said = el("p", { id: "fd-notesaid", class: "quiet fd-line", role: "status" }, why || "");
  const field = el("textarea", { id: "fd-note", rows: 3, "aria-describedby": "fd-notesaid", disabled: Boolean(why) });
  const button = el("button", { disabled: Boolean(why), "aria-describedby": why ? "fd-notesaid" : null }, WORDS.add);

  const take = (all) => {
    none.hidden = Boolean(all.length);
    const inOrder = [...all].sort((a, b) => a.unix_s - b.unix_s);
    keyed(list, inOrder, (_, place) => String(place), note);
  };
  const refresh = async () => take(await ctx.get(path));

  const send = async (event) => {
    event.preventDefault();
    const written = field.value.trim();
    const mistake = wrong(written);
    field.setAttribute("aria-invalid", String(Boolean(mistake)));
    text(said, mistake);
    if (mistake) return field.focus();
    if (!(await ctx.attempt(() => ctx.post(path, { text: written })))) return undefined;
    // Text that was typed in the meantime is kept.
    if (field.value.trim() === written) field.value = "";
    text(said, WORDS.added);
    return ctx.attempt(refresh);
  };

  parent.append(
    el("h3", {}, WORDS.title),
    none,
    list,
    el(
      "form",
      { class: "fd-noteform", onsubmit: send },
      el("label", { for: "fd-note" }, WORDS.field),
      field,
      el("div", { class: "acts" }, button),
      said,
    ),
  );
  return { take, refresh };
}

// Returns what is wrong with a note, or "" if it is valid.
function wrong(written) {
  const count = [...written].length;
  if (!count) return WORDS.empty;
  return count > MOST ? WORDS.long(count, MOST) : "";
}

const note = (one) =>
  el(
    "li",
    {},
    el("span", { class: "quiet" }, `${person(one.by)}, ${when(one.unix_s)}`),
    el("p", { class: "fd-text" }, one.text),
  );
