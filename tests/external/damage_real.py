"""Damage done to measured records, as fixtures/study/src/forensics.rs does it to simulated ones: is
each kind reported as what it is?

Usage: damage_real.py [--bench PATH] [--out FILE] [--misses]
  --bench   the program [default: target/debug/eis-bench of this repository]
  --out     also write the table to this file
  --misses  list every try that was not reported as what it is

Every kind of damage is done at ten strengths to a copy of each data set; then `diagnose --findings`
tells what it finds. What it finds in the undamaged copy is taken off. An entry of the table is
`right / right and more / other / not found`, followed by what else was reported.
"""

import argparse
import bisect
import concurrent.futures
import copy
import csv
import json
import math
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[2]
SETS = ["panasonic_50soc", "p45b_pulses", "a123_lfp"]
STRENGTHS = 10
# Columns of all records.
T, I, V = range(3)


class DoesNotApply(Exception):
    """Why a kind of damage makes no sense for a data set."""


class Run:
    """A run of a data set; of a record, the rows of its window."""

    def __init__(self, keys, folder):
        self.keys = dict(keys)
        self.name = keys["name"]
        self.is_time = keys["kind"] == "time"
        self.is_held_out = keys.get("role") == "held_out"
        self.file = (folder / keys["file"]).resolve()
        # Lines of a damaged file of spectra.
        self.lines = None
        self.rows = []
        self.code_a = 0.0
        if self.is_time:
            self.read()

    def read(self):
        with open(self.file, newline="") as file:
            self.head, *lines = csv.reader(file)
        # What follows the voltage, a temperature, stays as it is written.
        rows = [[float(x) for x in line[:3]] + line[3:] for line in lines]
        levels = sorted({row[I] for row in rows})
        steps = [b - a for a, b in zip(levels, levels[1:]) if b - a > 1e-9]
        self.code_a = min(steps) if steps else 0.0
        low = self.keys.get("from_s", -math.inf)
        high = self.keys.get("to_s", math.inf)
        self.rows = [row for row in rows if low <= row[T] <= high]

    def column(self, k):
        return [row[k] for row in self.rows]

    def put(self, k, values):
        for row, value in zip(self.rows, values, strict=True):
            row[k] = value

    def interval_s(self):
        return statistics.median(b[T] - a[T] for a, b in zip(self.rows, self.rows[1:]))

    def largest_a(self):
        return max(abs(row[I]) for row in self.rows)

    def begin_s(self):
        """Where the comparison begins."""
        return self.keys.get("compare_from_s", self.keys["from_s"])

    def first_compared(self):
        return bisect.bisect_left(self.column(T), self.begin_s())

    def write(self, path):
        with open(path, "w", newline="") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(self.head)
            out.writerows([cell if isinstance(cell, str) else repr(cell) for cell in row]
                          for row in self.rows)


class Scene:
    """A data set that is damaged, and its model."""

    def __init__(self, name):
        self.name = name
        self.folder = ROOT / "configs" / "datasets" / name
        self.text = (self.folder / "dataset.toml").read_text()
        keys = tomllib.loads(self.text)
        self.ocv = (self.folder / keys["ocv"]).resolve()
        self.model = json.loads((self.folder / keys["model"]).read_text())
        self.runs = [Run(run, self.folder) for run in keys["runs"]]
        # Which of the tries this is: the runs that are damaged alone take turns.
        self.turn = 0
        self.acted_on = "all"

    def records(self):
        return [run for run in self.runs if run.is_time]

    def any(self, fits=lambda run: True):
        """One of the training records."""
        trained = [run for run in self.records() if not run.is_held_out and fits(run)]
        run = trained[self.turn % len(trained)]
        self.acted_on = run.name
        return run

    def pair(self):
        """A training record, and a held-out one after it of the nearest number of rows."""
        records = self.records()
        pairs = [(abs(len(a.rows) - len(b.rows)), j - k, k, j)
                 for k, a in enumerate(records) if not a.is_held_out
                 for j, b in enumerate(records) if b.is_held_out and j > k]
        *_, k, j = min(pairs)
        self.acted_on = f"{records[k].name} to {records[j].name}"
        return records[k], records[j]

    def finest_s(self):
        """Distance of the rows in the record that is sampled fastest."""
        return min(run.interval_s() for run in self.records())

    def write(self, folder):
        """Writes the data set, each record as a file of its own."""
        folder.mkdir()
        (folder / "model.json").write_text(json.dumps(self.model))
        runs = {run.name: run for run in self.runs}
        run, lines = None, []
        for line in self.text.splitlines():
            key, _, value = (part.strip() for part in line.partition("="))
            if line.strip() == "[[runs]]":
                run = "next"
            elif key == "name" and run == "next":
                run = runs[value.strip('"')]
            elif key == "model" and run is None:
                line = f"model = {json.dumps(str(folder / 'model.json'))}"
            elif key == "ocv" and run is None:
                line = f"ocv = {json.dumps(str(self.ocv))}"
            elif key == "file" and isinstance(run, Run):
                path = run.file
                if run.is_time:
                    path = folder / f"{run.name}.bdf.csv"
                    run.write(path)
                elif run.lines is not None:
                    path = folder / f"{run.name}.csv"
                    path.write_text("".join(run.lines))
                line = f"file = {json.dumps(str(path))}"
            elif isinstance(run, Run) and key in ("from_s", "to_s", "compare_from_s"):
                line = f"{key} = {run.keys[key]!r}"
            lines.append(line)
        (folder / "dataset.toml").write_text("\n".join(lines) + "\n")


def rounded(value, step):
    """To the nearest multiple, halves away from zero as Rust does, in the digits of a file."""
    count = math.floor(abs(value) / step + 0.5) if step else 0
    return round(math.copysign(count * step, value), 9) if step else value


# Filters. Between two rows the current goes along a straight line, as these data sets state it.


def plain(time_s, current_a, tau_s, off_a=0.0):
    shown = [current_a[0]]
    for k in range(1, len(time_s)):
        if abs(current_a[k]) < off_a:
            shown.append(current_a[k])
            continue
        step_s = time_s[k] - time_s[k - 1]
        behind_a = (current_a[k] - current_a[k - 1]) / step_s * tau_s
        state_a = shown[-1] - current_a[k - 1] + behind_a
        shown.append(current_a[k] - behind_a + math.exp(-step_s / tau_s) * state_a)
    return shown


def restarting(time_s, current_a, tau_s):
    """It starts anew where no current flows: below 2 % of the record's largest."""
    return plain(time_s, current_a, tau_s, 0.02 * max(abs(a) for a in current_a))


def moving_mean(time_s, current_a, length_s):
    """Mean over the last seconds, at the row."""
    charge_c = [0.0]
    for k in range(1, len(time_s)):
        middle_a = 0.5 * (current_a[k - 1] + current_a[k])
        charge_c.append(charge_c[-1] + middle_a * (time_s[k] - time_s[k - 1]))

    def charge(at_s):
        if at_s <= time_s[0]:
            return (at_s - time_s[0]) * current_a[0]
        k = min(bisect.bisect_right(time_s, at_s), len(time_s) - 1)
        span_s, since_s = time_s[k] - time_s[k - 1], at_s - time_s[k - 1]
        slope = (current_a[k] - current_a[k - 1]) / span_s
        return charge_c[k - 1] + since_s * (current_a[k - 1] + 0.5 * slope * since_s)

    return [(q - charge(t - length_s)) / length_s for t, q in zip(time_s, charge_c)]


def through_channel(run, tau_s, through):
    """The current through a filter and the codes of its channel, the least step in the file."""
    shown = through(run.column(T), run.column(I), tau_s)
    run.put(I, [rounded(a, run.code_a) for a in shown])


def filter_all(through, lowest_s=0.3):
    def act(scene, tau_s):
        if through is restarting and not any(
            abs(a) < 0.02 * run.largest_a() for run in scene.records() for a in run.column(I)
        ):
            raise DoesNotApply("its current is never switched off")
        # A filter shorter than the distance of the rows of the fastest record is seen in no row
        # but the first of an edge: the shortest is that distance, and all others are longer by
        # the same factor.
        tau_s *= max(1.0, scene.finest_s() / lowest_s)
        for run in scene.records():
            through_channel(run, tau_s, through)

    return act


def filter_one(scene, tau_s):
    # One record of pulses or a profile, as in the study; scaled as above, by its own rows. Rows a
    # minute apart show the filter of no channel.
    run = scene.any(lambda run: run.interval_s() < 10.0)
    through_channel(run, tau_s * max(1.0, run.interval_s() / 0.5), plain)


# Copies.


def copy_part(source, target, part):
    """Rows in the middle of the compared ones become those of another run; stamps stay."""
    a, b = source.rows[source.first_compared():], target.rows[target.first_compared():]
    rows = min(len(a), len(b))
    count = math.ceil(part * rows)
    first = (rows - count) // 2
    for k in range(first, first + count):
        b[k][I], b[k][V] = a[k][I], a[k][V]


def held_out_copied(scene, part):
    copy_part(*scene.pair(), part)


def held_out_rounded(scene, step_v):
    # A copy of a whole run has the stamps of the run too, from its own start on. Where the windows
    # are of other lengths (they begin at one start and are played through), that of the compared
    # rows.
    source, target = scene.pair()
    of = lambda run: (run.keys["to_s"] - run.keys["from_s"], run.begin_s() - run.keys["from_s"])
    if all(abs(x - y) < 1.0 for x, y in zip(of(source), of(target))):
        kept, copied = [], source.rows
        later_s = target.keys["from_s"] - source.keys["from_s"]
    else:
        kept = target.rows[:target.first_compared()]
        copied = source.rows[source.first_compared():]
        later_s = target.begin_s() - source.begin_s()
    target.rows = kept + [[round(t + later_s, 7), a, rounded(v, step_v), *more]
                          for t, a, v, *more in copied]


def repeat_copied(scene, part):
    groups = {}
    for run in scene.runs:
        groups.setdefault(run.keys.get("repeat_group", run.name), []).append(run)
    repeats = [runs for runs in groups.values() if len(runs) > 1]
    if not repeats:
        raise DoesNotApply("it holds no repeats")
    source, target = repeats[0][:2]
    scene.acted_on = f"{source.name} to {target.name}"
    if source.is_time:
        copy_part(source, target, part)
        return
    # Spectra of one file: points in the place of rows.
    lines = target.file.read_text().splitlines(keepends=True)
    head = lines[0].strip().split(",")
    at = [head.index(name) for name in ("z_abs_ohm", "z_phase_rad")]
    points = lambda run: [k for k, line in enumerate(lines)
                          if line.startswith(re.sub(r"(\d+)_", r",\1,", run.keys["spectrum"], 1))]
    a, b = points(source), points(target)
    rows = min(len(a), len(b))
    count = math.ceil(part * rows)
    first = (rows - count) // 2
    for k in range(first, first + count):
        own, theirs = lines[b[k]].strip().split(","), lines[a[k]].strip().split(",")
        for column in at:
            own[column] = theirs[column]
        lines[b[k]] = ",".join(own) + "\n"
    target.lines = lines


# Voltage and rows.


def rest_off(scene, off_v):
    run = scene.any()
    run.put(V, [v + off_v for v in run.column(V)])


def other_curve(scene, off_v):
    for run in scene.records():
        run.put(V, [v - off_v for v in run.column(V)])


def rows_missing(scene, count):
    run = scene.any()
    first = len(run.rows) // 3
    del run.rows[first:first + int(count)]


def stands_still(scene, count):
    run = scene.any()
    first = len(run.rows) // 3
    for row in run.rows[first:first + int(count)]:
        row[I], row[V] = run.rows[first][I], run.rows[first][V]


def stamps_rounded(scene, quantum_s):
    nearest = lambda of, to: min(of, key=lambda q: abs(math.log(q / to)))
    for run in scene.records():
        # The study's rows are 1.86 s apart. Rows much farther apart are rounded to as much more, to
        # what a logger would round to.
        own_s, interval_s = nearest([0.2, 0.5, 1.0], quantum_s), run.interval_s()
        if interval_s > 10.0:
            own_s = nearest([5.0, 10.0, 30.0], own_s * interval_s / 1.86)
        # Rows 1.1 s and 1.1 quanta apart or more, as in the study: rows closer than the quantum
        # would have equal stamps, which is another damage.
        kept, last_s = [], -math.inf
        for row in run.rows:
            if row[T] >= last_s + 1.1 * max(1.0, own_s):
                kept.append(row)
                last_s = row[T]
        run.rows = kept
        interval_s = run.interval_s()
        # Rows at whole quanta have nothing to be rounded: as in the study they are taken as 0.93
        # of that apart, with the window.
        quanta = interval_s / own_s
        stretch = 0.93 if abs(quanta - round(quanta)) < 1e-3 else 1.0
        start_s = run.keys["from_s"]
        moved = lambda t: start_s + stretch * (t - start_s)
        for row in run.rows:
            row[T] = round(rounded(moved(row[T]), own_s), 6)
        # A window still holds the rows that were in it.
        for key, more_s in (("to_s", own_s), ("compare_from_s", 0.0)):
            if key in run.keys:
                run.keys[key] = round(moved(run.keys[key]) + more_s, 6)
        run.keys["from_s"] = round(start_s - own_s, 6)


def coarse(column):
    def act(scene, step):
        for run in scene.records():
            run.put(column, [rounded(x, step) for x in run.column(column)])

    return act


def other_model(scene, factor):
    erm = scene.model["fit"]["erm"]
    erm["r_ohm"] *= factor
    for branch in erm["branches"]:
        branch["r_ohm"] *= factor
        branch["c_f"] /= factor


def other_gain(scene, factor):
    for run in scene.records():
        run.put(I, [a / factor for a in run.column(I)])


def milliamperes(scene, factor):
    run = scene.any()
    run.put(I, [a * factor for a in run.column(I)])


def sign(scene, _):
    run = scene.any()
    run.put(I, [-a for a in run.column(I)])


def clipped(scene, part):
    run = scene.any()
    v = run.column(V)
    floor_v = min(v) + part * (max(v) - min(v))
    run.put(V, [max(x, floor_v) for x in v])


def cut_off(scene, part):
    # Of the compared rows: where none is left, the program refuses the window.
    run = scene.any()
    first = run.first_compared()
    del run.rows[first + int(part * (len(run.rows) - first)):]


def no_number(scene, count):
    # As loggers write it: in turn no digits, and `nan`.
    run = scene.any()
    first = len(run.rows) // 3
    for row in run.rows[first:first + int(count)]:
        row[V] = "" if scene.turn % 2 == 0 else "nan"


# Kind, what it must be reported as, weakest and strongest, unit, what it does. A file knows more than
# the study's records, which are in memory: its window tells a record that was cut off from one
# without repeats, and its reader tells a row without a number.
DAMAGES = [
    ("held-out run copied from training", ["leakage"], 0.1, 1.0, "of its rows", held_out_copied),
    ("the same, rounded", ["leakage"], 1e-5, 1e-3, "V", held_out_rounded),
    ("repeat copied", ["copy"], 0.1, 1.0, "of its rows", repeat_copied),
    ("rest voltage of one run off", ["rest_voltage", "repeats"], 0.05, 0.5, "V", rest_off),
    ("curve of another cell", ["rest_voltage"], 0.05, 0.5, "V", other_curve),
    ("rows missing", ["rows_missing"], 10, 150, "rows", rows_missing),
    ("logger stands still", ["rows_repeated"], 10, 150, "rows", stands_still),
    ("stamps rounded", ["stamps_rounded"], 0.2, 1.0, "s", stamps_rounded),
    ("coarse codes of the voltage", ["resolution"], 4e-3, 40e-3, "V", coarse(V)),
    ("coarse codes of the current", ["resolution"], 0.4, 4.0, "A", coarse(I)),
    ("model of another cell", ["scale"], 1.3, 4.0, "", other_model),
    ("current with another gain", ["scale"], 1.3, 4.0, "", other_gain),
    ("filter of all currents", ["current_filter"], 0.3, 3.0, "s", filter_all(plain)),
    ("filter that starts anew", ["current_filter"], 0.3, 3.0, "s", filter_all(restarting)),
    ("moving mean of all currents", ["current_filter"], 0.3, 3.0, "s", filter_all(moving_mean)),
    ("filter of one current", ["current_lags"], 0.5, 3.0, "s", filter_one),
    ("milliamperes", ["unit"], 1e3, 1e3, "", milliamperes),
    ("sign of the current", ["sign"], 1.0, 1.0, "", sign),
    ("clipped voltage", ["clipped"], 0.1, 0.8, "of its range", clipped),
    ("cut off", ["truncated", "ends_early"], 0.3, 0.8, "of its rows", cut_off),
    ("a number that is none", ["not_finite", "rows_not_measured"], 1, 20, "rows", no_number),
]


def list_findings(bench, folder):
    """Checks that refuse the data set and kinds of its findings, and their texts."""
    command = [str(bench), "diagnose", str(folder), "--findings", "--json"]
    end = subprocess.run(command, capture_output=True, text=True, timeout=300)
    try:
        met = json.loads(end.stdout)
    except json.JSONDecodeError:
        return {"failed"}, [(end.stderr.strip().splitlines() or ["no output"])[-1]]
    reasons = [(reason["check"], reason["text"]) for reason in met["invalid"]]
    reasons += [(one["kind"], one["text"]) for one in met["findings"]]
    return {kind for kind, _ in reasons}, [text for _, text in reasons]


def attempt(bench, folder, base, damage, turn):
    """One damage of one strength; what is reported of it, or why it does not apply."""
    _, _, low, high, unit, act = damage
    scene = copy.deepcopy(base)
    scene.turn = turn
    strength = low * (high / low) ** (turn / (STRENGTHS - 1))
    try:
        act(scene, strength)
    except DoesNotApply as why:
        return str(why)
    scene.write(folder)
    return list_findings(bench, folder), f"{strength:.3g} {unit}".strip(), scene.acted_on


def entry(ends, expected_kinds, known):
    """Counts of one kind in one data set, what else was reported, and the tries that missed."""
    if isinstance(ends[0], str):
        return f"does not apply: {ends[0]}", []
    counts, other, misses = [0] * 4, {}, []
    for (kinds, texts), strength, acted_on in ends:
        kinds = kinds - known
        others = kinds - set(expected_kinds)
        is_right = kinds != others
        counts[(0 if not others else 1) if is_right else (2 if others else 3)] += 1
        for kind in others:
            other[kind] = other.get(kind, 0) + 1
        if not is_right:
            misses.append(f"{strength}, {acted_on}: {'; '.join(texts) or 'nothing'}")
    words = ", ".join(f"{kind} {count}" for kind, count in sorted(other.items()))
    return " / ".join(map(str, counts)) + (f" ({words})" if words else ""), misses


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--bench", default=ROOT / "target/debug/eis-bench", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path)
    parser.add_argument("--misses", action="store_true")
    options = parser.parse_args()
    bases = [Scene(name) for name in SETS]
    lines, missed = [], []
    with (tempfile.TemporaryDirectory() as folder,
          concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool):
        folder, known = pathlib.Path(folder), []
        for base in bases:
            base.write(folder / base.name)
            kinds, texts = list_findings(options.bench, folder / base.name)
            if "failed" in kinds:
                sys.exit(f"{base.name}, undamaged: {texts[0]}")
            known.append(kinds)
            lines.append(f"undamaged {base.name}: {'; '.join(texts) or 'nothing'}")
        tries = [[[pool.submit(attempt, options.bench, folder / f"{d}_{k}_{turn}", base, damage,
                               turn) for turn in range(STRENGTHS)]
                  for k, base in enumerate(bases)] for d, damage in enumerate(DAMAGES)]
        lines.append(f"| damage | from | to | {' | '.join(SETS)} |")
        lines.append("|---" * (3 + len(SETS)) + "|")
        for damage, of_damage in zip(DAMAGES, tries):
            name, expected_kinds, low, high, unit, _ = damage
            entries = []
            for base, kinds, ends in zip(bases, known, of_damage):
                text, misses = entry([end.result() for end in ends], expected_kinds, kinds)
                entries.append(text)
                missed += [f"{name}, {base.name}, {miss}" for miss in misses]
            lines.append(f"| {name} | {low:g} {unit} | {high:g} {unit} | {' | '.join(entries)} |")
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.misses:
        print("\n".join(missed))
    if options.out:
        options.out.write_text(text)


if __name__ == "__main__":
    main()
