// The question of a run to the person at the bench: what to change in the jig, and the button that says that it is
// done. It is drawn anew only when another question waits, so that nothing typed or ticked is lost.
"use strict";

import { $, el, fill } from "./bench.js";

const WORDS = {
  title: (bench) => `${bench} waits for you`,
  safe: "Every output is off. An output that is off is no open switch: mind the terminals.",
  terminal: "It is asked on the terminal where the run was begun: answer there.",
  serial: (serial) => `Serial number on the cell, typed or scanned (asked for: ${serial})`,
  optional: "Left empty, nobody has checked it.",
  done: "It is so: I have changed the fixture as asked, and nobody's hands are in the jig.",
  go: "Go on: current may flow",
  first: "First tick that it is done.",
};

// Draws the question of a bench into `#question`; `send(question, serial)` answers it, `lacks` says why one may not.
export function drawQuestion(live, send, lacks) {
  const place = $("question");
  const question = live.question;
  place.hidden = !question;
  const key = question ? `${live.bench} ${live.run && live.run.run} ${question.number} ${lacks}` : "";
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  if (!question) {
    fill(place);
    return;
  }
  const heading = el("h2", {}, WORDS.title(live.bench));
  const text = el("p", {}, el("b", {}, question.text));
  if (question.on_terminal) {
    fill(place, heading, text, el("p", {}, WORDS.terminal));
    return;
  }
  fill(place, heading, text, el("p", {}, WORDS.safe), answer(question, send, lacks));
}

function answer(question, send, lacks) {
  const off = Boolean(lacks);
  const done = el("input", { id: "question-done", type: "checkbox", disabled: off });
  const serial = el("input", {
    id: "question-serial",
    autocomplete: "off",
    spellcheck: false,
    maxlength: 100,
    disabled: off,
    "aria-describedby": "question-optional",
  });
  const said = el("p", { role: "alert" }, lacks);
  const onsubmit = (event) => {
    event.preventDefault();
    said.textContent = done.checked ? "" : WORDS.first;
    if (done.checked) send(question, serial.value.trim() || null);
    else done.focus();
  };
  const named = [
    el("label", { for: "question-serial" }, WORDS.serial(question.serial)),
    serial,
    el("p", { id: "question-optional", class: "quiet" }, WORDS.optional),
  ];
  return el(
    "form",
    { onsubmit },
    ...(question.serial ? named : []),
    el("p", {}, el("label", {}, done, ` ${WORDS.done}`)),
    el("div", { class: "acts" }, el("button", { type: "submit", disabled: off }, WORDS.go)),
    said,
  );
}
