"""The highest jump from random starts, with and without the tangent: share solved, heights, seconds on one core.

python python/tests/motion_starts.py --starts 50
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import eisbench as eb
from eisbench import motion

CELL = Path(__file__).parents[2] / "fixtures/data/cells/p45b_25C"


def main():
    words = argparse.ArgumentParser()
    words.add_argument("--starts", type=int, default=50)
    words.add_argument("--first", type=int, default=0, help="first seed")
    words.add_argument("--soc", type=float, default=0.2)
    words.add_argument("--reach-w", type=float, nargs="*", default=[100.0, 1000.0])
    words.add_argument("--mesh", type=int, nargs=3, default=[4, 2, 3])
    words.add_argument(
        "--tangent", choices=["with", "without"], nargs="*", default=["with", "without"]
    )
    asked = words.parse_args()
    model = eb.Model.read(CELL / "model_4rc.json").with_ocv(eb.Ocv.read(CELL / "ocv.json"))
    pack = motion.Pack(model, series=16, parallel=3, soc=asked.soc, interconnect_ohm=0.03)
    for reach_w in asked.reach_w:
        for tangent in asked.tangent:
            solved, heights_m, ends = [], [], {}
            for seed in range(asked.first, asked.first + asked.starts):
                law = motion.Transient(pack, tangent=tangent == "with")
                began_s = time.process_time()
                try:
                    options = motion.Options(
                        *asked.mesh, seed=seed, reach_w=reach_w, max_iterations=1000
                    )
                    found = motion.jump(motion.Robot(), law, options)
                except eb.EisError as error:
                    end = str(error).split(", ")[1].split(" after")[0]
                    ends[end] = ends.get(end, 0) + 1
                    print(seed, end, file=sys.stderr, flush=True)
                    continue
                solved.append((time.process_time() - began_s, found.iterations))
                print(seed, *solved[-1], found, file=sys.stderr, flush=True)
                heights_m.append(found.height_m)
            print(
                f"powers of a cell up to {reach_w:g} W, {tangent} tangent: {len(solved)} of {asked.starts}, {ends}"
            )
            if solved:
                for name, column in zip(("CPU s", "iterations"), np.array(solved).T):
                    print(
                        f"  {name}: median {np.median(column):.1f}, 90 % {np.quantile(column, 0.9):.1f}"
                    )
                low, middle, high = np.quantile(heights_m, [0, 0.5, 1])
                best = np.mean(np.array(heights_m) > high - 0.01)
                print(
                    f"  height: {low:.3f}, {middle:.3f}, {high:.3f} m; within 10 mm of the best: {best:.0%}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
