"""Does a law of the battery matter? Jumps planned from bench data of hidden cells, replayed on the true cells.

python python/tests/motion_trial.py --cells 60 --seed 1 --out trial

It needs ``eis-study`` (``cargo build -p study``) and writes a row of ``rows.jsonl`` per cell, charge and
temperature; a call that was interrupted continues there. The rules: docs/blind-jump.md.
"""

import argparse
import json
import math
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import eisbench as eb
from eisbench import motion

ROOT = Path(__file__).parents[2]
INTERCONNECT_OHM = 0.03
ROBOT = motion.Robot()
MESH = {"flat": 8, "toe": 4, "flight": 6}
#: Power of the packs by E²/4R: as 16S3P and as 16S1P of P45B.
PACKS_W = (12e3, 4e3)
#: A cell outside its window by no more than this counts as within: a plan has its limits at points only.
TOLERANCE_V = 5e-3
#: The motors miss voltage if the bus has less than they need by this share.
MISSING = 0.01
#: Plans of the oracle beside that of the map, and the difference of planned and true voltage at which it
#: has converged, V.
ORACLE_PLANS, ORACLE_V = 4, 3e-3
#: Standard deviations of the band: Scheffé's for the four errors of a map.
SIGMAS = 3.08
LAWS = ("none", "power limit", "simple IR", "one point", "map", "map, lower edge", "oracle")


def conditions(cells, first):
    """Seed, power of the pack, charge and temperature of each cell: all 18 combinations in 24 cells, half
    of them at 20 %."""
    for k in range(cells):
        soc, degc = (0.2, 0.5, 0.2, 0.9)[k // 2 % 4], (10.0, 25.0, 40.0)[k % 3]
        yield first + 1_000_003 * k, PACKS_W[k % 2], soc, degc


class Trial:
    """A cell at a charge and a temperature: what a planner knows of it, and replays on its truth."""

    def __init__(self, study, out, seed, pack_w, soc, degc):
        self.study, self.soc, self.degc = study, soc, degc
        self.folder = out / f"{seed}"
        if not (self.folder / "truth.json").exists():
            words = ["cell", "--seed", seed, "--pack-w", pack_w, "--out", self.folder]
            subprocess.run([study, *map(str, words)], check=True)
        self.case = json.loads((self.folder / "case.json").read_text())
        self.window_v = tuple(self.case["window_v"])
        self.models = {
            name: eb.Model.read(self.folder / f"{name}.json") for name in ("map", "point")
        }

    def pack(self, name):
        size = {key: self.case[key] for key in ("series", "parallel")}
        place = {"soc": self.soc, "ambient_degc": self.degc, "window_v": self.window_v}
        return motion.Pack(self.models[name], **size, **place, interconnect_ohm=INTERCONNECT_OHM)

    def ocv_v(self, soc):
        run = self.models["point"].simulate([0.0, 1.0], current_a=[0.0, 0.0], soc=soc)
        return float(run["ocv_v"][0])

    def laws(self):
        """The laws without the oracle, from what a bench knows."""
        series, point = self.case["series"], self.models["point"]
        half_v, low_v = self.ocv_v(0.5), self.window_v[0]
        outside_ohm = INTERCONNECT_OHM * self.case["parallel"] / series
        # The power at the lowest voltage of a cell by the resistance at half charge and 25 °C.
        most_a = (half_v - low_v) / point.dc_resistance_ohm
        cell_w = (low_v - outside_ohm * most_a) * most_a
        yield "none", motion.Free(series * self.ocv_v(self.soc))
        limit_w = cell_w * series * self.case["parallel"]
        yield "power limit", motion.PowerLimit(limit_w, series * half_v)
        names = self.models["map"]._module("casadi")
        surfaces = range(1 + len(names["TAU_S"]))
        r_ohm = sum(float(names["resistance_ohm"](self.soc, self.degc, k)) for k in surfaces)
        yield "simple IR", motion.SimpleIR(self.pack("point"), r_ohm)
        yield "one point", motion.Transient(self.pack("point"))
        yield "map", motion.Transient(self.pack("map"))
        yield "map, lower edge", motion.Transient(self.pack("map"), sigmas=SIGMAS)

    def replay(self, found):
        """True voltages of a cell and of the bus at the points of a motion, not a number where the pack
        cannot give the power; and the lowest and highest voltage of a cell."""
        profile = self.folder / f"{os.getpid()}.csv"
        found.write_profile(profile)
        place = ["--soc", self.soc, "--ambient-degc", self.degc]
        words = ["replay", "--cell", self.folder, "--profile", profile, *place]
        words += ["--interconnect-ohm", INTERCONNECT_OHM]
        done = subprocess.run([self.study, *map(str, words)], check=True, capture_output=True)
        profile.unlink()
        lines = done.stdout.decode().split()[1:]
        rows = np.array([[float(n) for n in line.split(",")] for line in lines])
        time_s = found.profile()[0]
        if not rows.size:
            rows = np.full((1, 5), math.nan)
        # The file rounds times, and ends before a power that the pack cannot give.
        voltages = np.full((2, time_s.size), math.nan)
        voltages[:, : len(rows)] = rows[:, 1:3].T
        at = [np.interp(found.time_s, time_s, column) for column in voltages]
        return *at, float(np.nanmin(rows[:, 3])), float(np.nanmax(rows[:, 4]))

    def score(self, found):
        cell_v, bus_v, low_v, high_v = self.replay(found)
        motors = ROBOT.functions()["motors"].map(found.time_s.size)
        speed, torque = found.v.T, found.torque_nm.T
        needed_v = np.abs(np.asarray(motors(speed, torque)[1])).max(axis=0)
        short = bool(np.isnan(bus_v).any())
        outside_v = max(self.window_v[0] - low_v, high_v - self.window_v[1])
        return cell_v, {
            "height_m": found.height_m,
            "peak_w": float(found.bus_w.max()),
            "seconds": found.build_s + found.solve_s,
            "no_power": short,
            "outside_v": outside_v,
            "leaves": short or outside_v > TOLERANCE_V,
            "motors_short": short or bool((bus_v < (1 - MISSING) * needed_v).any()),
        }

    def play(self):
        out = {}
        start = max(
            (plan for seed in (None, 0) if (plan := attempt(motion.Free(60.0), None, seed))),
            key=lambda plan: plan.height_m,
        )
        found = None
        for name, law in self.laws():
            found = attempt(law, start)
            if found is None:
                out[name] = None
                continue
            out[name] = self.score(found)[1]
            if name == "map":
                planned = found
        out["oracle"] = self.oracle(planned) if out["map"] else None
        return out

    def oracle(self, found):
        """Plans with the true voltage of the plan before, until both agree within the limits."""
        correction_v = np.zeros(found.time_s.size)
        for _ in range(ORACLE_PLANS):
            cell_v, _ = self.score(found)
            missed_v = cell_v - (found.margin_low_v + self.window_v[0])
            missed_v[np.isnan(missed_v)] = -0.05
            correction_v = correction_v + missed_v
            law = motion.Transient(self.pack("map"), correction_v=correction_v)
            found = attempt(law, found)
            if found is None:
                return None
            cell_v, score = self.score(found)
            missed_v = np.abs(cell_v - (found.margin_low_v + self.window_v[0])).max()
            if missed_v < ORACLE_V and not score["leaves"] and not score["motors_short"]:
                return score
        return None


def attempt(law, start, seed=None):
    """The highest jump of a law, from a start, else from random ones; None if none is found."""
    for seed in (seed, 1, 2):
        try:
            return motion.jump(ROBOT, law, motion.Options(**MESH, start=start, seed=seed))
        except eb.EisError as error:
            print(law.name, error, file=sys.stderr, flush=True)
    return None


def play(study, out, conditions):
    """The scores of the laws at the conditions of a cell, which share its measurement."""
    return [
        {"condition": list(condition), "laws": Trial(study, out, *condition).play()}
        for condition in conditions
    ]


def wilson(count, of):
    z2 = 1.959964**2
    share = count / of
    half = math.sqrt(z2 * (share * (1 - share) / of + z2 / (4 * of * of)))
    return [(share + z2 / (2 * of) + sign * half) / (1 + z2 / of) for sign in (-1, 1)]


def share(rows, *keys):
    count = sum(any(row[key] for key in keys) for row in rows)
    low, high = wilson(count, len(rows))
    return f"{count:3d} of {len(rows):3d} ({100 * max(low, 0):.0f}–{100 * high:.0f} %)"


def table(rows):
    groups = {"all": rows}
    for soc in (0.2, 0.5, 0.9):
        groups[f"{soc:.0%} charge"] = [r for r in rows if r["condition"][2] == soc]
    for pack_w in PACKS_W:
        groups[f"{pack_w / 1e3:.0f} kW"] = [r for r in rows if r["condition"][1] == pack_w]
    for name, own in groups.items():
        if not own:
            continue
        print(f"\n{name}: {len(own)} conditions")
        print(
            f"{'law':16} {'not solved':>10} {'leaves the window':>24} {'motors lack voltage':>24}"
            f" {'one or the other':>24} {'deepest':>8}"
            f" {'height lost: median':>20} {'10 %':>7} {'90 %':>7} {'of':>3} {'s':>5}"
        )
        for law in LAWS:
            print(f"{law:16} {line(own, law)}")


def line(own, law):
    """What a law reaches under conditions."""
    done = [row["laws"][law] for row in own if row["laws"][law]]
    if not done:
        return f"{len(own):10d}"
    both = [row["laws"] for row in own if row["laws"][law] and row["laws"]["oracle"]]
    lost = [100 * (1 - laws[law]["height_m"] / laws["oracle"]["height_m"]) for laws in both]
    low, middle, high = np.quantile(lost, [0.1, 0.5, 0.9]) if lost else [math.nan] * 3
    seconds = np.median([row["seconds"] for row in done])
    deepest_mv = 1e3 * max(row["outside_v"] for row in done)
    shares = [share(done, *keys) for keys in (["leaves"], ["motors_short"], ["leaves", "motors_short"])]
    return (
        f"{len(own) - len(done):10d} {' '.join(f'{each:>24}' for each in shares)} {deepest_mv:5.0f} mV"
        f" {middle:18.1f} % {low:5.1f} % {high:5.1f} % {len(lost):3d} {seconds:5.1f}"
    )


def main():
    words = argparse.ArgumentParser()
    words.add_argument("--cells", type=int, default=60)
    words.add_argument("--seed", type=int, default=1, help="first seed")
    words.add_argument("--out", type=Path, required=True)
    words.add_argument("--study", type=Path, default=ROOT / "target/debug/eis-study")
    words.add_argument("--cores", type=int, default=2)
    asked = words.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    file = asked.out / "rows.jsonl"
    rows = [json.loads(row) for row in file.read_text().splitlines()] if file.exists() else []
    done = {tuple(row["condition"]) for row in rows}
    left: dict[int, list] = {}
    for condition in conditions(asked.cells, asked.seed):
        if condition not in done:
            left.setdefault(condition[0], []).append(condition)
    with ProcessPoolExecutor(asked.cores) as pool, file.open("a") as store:
        jobs = [pool.submit(play, asked.study, asked.out, own) for own in left.values()]
        for job in as_completed(jobs):
            try:
                found = job.result()
            except subprocess.CalledProcessError as error:
                if "cell" not in error.cmd:
                    raise
                print(f"a cell is left out: {error}", file=sys.stderr, flush=True)
                continue
            for row in found:
                rows.append(row)
                store.write(json.dumps(row) + "\n")
                store.flush()
                print(row["condition"], file=sys.stderr, flush=True)
    table(rows)


if __name__ == "__main__":
    main()
