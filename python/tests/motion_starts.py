"""Every task from random starts, with and without the tangent: share solved, costs, seconds on one core.

python python/tests/motion_starts.py --starts 50
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import eisbench as eb
from eisbench import motion

CELL = Path(__file__).parents[2] / "fixtures/data/cells/p45b_25C"
ROBOT = motion.Robot()
MESH = motion.Options(flat=4, toe=2, flight=3, landing=4, max_iterations=1000)


def rise_s(found):
    """Time from the start to the highest point."""
    row = found.take_off
    return float(found.time_s[row] + found.com_m_s[row, 1] / ROBOT.gravity_m_s2)


#: Of each task its call with a law and options, the name of its cost, and the cost of a motion.
TASKS = {
    "jump": (lambda *a: motion.jump(ROBOT, *a), "-height / m", lambda found: -found.height_m),
    "jump_to": (lambda law, o: motion.jump_to(ROBOT, law, 0.5, o), "rise / s", rise_s),
    "gap": (lambda law, o: motion.gap(ROBOT, law, 1.0, o), "energy / J", lambda found: found.energy_j),
    "walk": (
        lambda law, o: motion.walk(ROBOT, law, 0.8, o),
        "J/m",
        lambda found: found.energy_j / found.step_m,
    ),
}


def play(task, law, asked, reach_w):
    """Solves a task from all starts and prints a line."""
    plan, name, cost = TASKS[task]
    solved, ends = [], {}
    for seed in range(asked.first, asked.first + asked.starts):
        began_s = time.process_time()
        try:
            found = plan(law, replace(MESH, seed=seed, reach_w=reach_w))
        except eb.EisError as error:
            end = str(error).split("not solved, ")[-1].split(" after")[0]
            ends[end] = ends.get(end, 0) + 1
            print(task, seed, end, file=sys.stderr, flush=True)
            continue
        solved.append((time.process_time() - began_s, found.iterations, cost(found)))
        print(task, seed, *solved[-1], found, file=sys.stderr, flush=True)
    tangent = "with" if law.tangent else "without"
    begin = f"{task:8} {reach_w:6g} W, {tangent:7} tangent: {len(solved):3d} of {asked.starts} solved"
    if not solved:
        print(f"{begin}, {ends}", flush=True)
        return
    seconds, iterations, costs = np.array(solved).T
    ranges = [
        f"{np.median(column):.4g}, {np.quantile(column, 0.9):.4g}" for column in (seconds, iterations)
    ]
    low, middle, high = np.quantile(costs, [0, 0.5, 1])
    near = np.mean(costs < low + 0.02 * abs(low))
    print(
        f"{begin}; s {ranges[0]}; iterations {ranges[1]}; {name} {low:.4g}, {middle:.4g}, {high:.4g}, "
        f"{near:.0%} within 2 % of the least {ends or ''}",
        flush=True,
    )


def main():
    words = argparse.ArgumentParser()
    words.add_argument("--starts", type=int, default=50)
    words.add_argument("--first", type=int, default=0, help="first seed")
    words.add_argument("--soc", type=float, default=0.2)
    words.add_argument("--task", choices=TASKS, nargs="*", default=list(TASKS))
    words.add_argument("--reach-w", type=float, nargs="*", default=[100.0, 1000.0])
    words.add_argument(
        "--tangent", choices=["with", "without"], nargs="*", default=["with", "without"]
    )
    asked = words.parse_args()
    model = eb.Model.read(CELL / "model_4rc.json").with_ocv(eb.Ocv.read(CELL / "ocv.json"))
    pack = motion.Pack(model, series=16, parallel=3, soc=asked.soc, interconnect_ohm=0.03)
    for task in asked.task:
        for reach_w in asked.reach_w:
            for tangent in asked.tangent:
                play(task, motion.Transient(pack, tangent=tangent == "with"), asked, reach_w)


if __name__ == "__main__":
    main()
