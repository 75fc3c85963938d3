"""Checks that print a line each, on files that eis-bench writes."""

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("PYBAMM_DISABLE_TELEMETRY", "true")

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = Path(sys.argv[1]).resolve()
OUT = Path(tempfile.mkdtemp(prefix="eis-bench-formats-"))
results = []


def check(name):
    def run(function):
        try:
            summary = function()
            results.append(True)
            print(f"ok      {name}: {summary}")
        except Exception as error:  # noqa: BLE001 - whatever it is, it is printed
            results.append(False)
            print(f"FAILED  {name}: {type(error).__name__}: {error}")
        return function

    return run


def eis_bench(*words):
    done = subprocess.run([str(PROGRAM), *map(str, words)], capture_output=True, text=True, cwd=OUT)
    if done.returncode != 0:
        raise RuntimeError(f"{words}: {done.stderr.strip()}")
    return done.stdout


def module(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def end():
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    sys.exit(0 if all(results) else 1)
