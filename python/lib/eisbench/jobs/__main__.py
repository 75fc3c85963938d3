"""``python -m eisbench.jobs fit STORE --out FOLDER``."""

from __future__ import annotations

import argparse
import sys
from typing import Any, Optional, Union

from .._eisbench import EisError
from . import diagnose, fit, kk, replay, run
from ._engine import ENGINES
from ._folder import AnyTask
from ._shard import ROWS


def _order(text: str) -> Union[int, str]:
    return text if text == "auto" else int(text)


def _slope(text: str) -> Union[float, str]:
    return text if text in ("fit", "none") else float(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m eisbench.jobs",
        description="Works on very many spectra or runs. A call that was killed is made again: what is done "
        "stays done.",
    )
    tasks = parser.add_subparsers(dest="task", required=True)
    fits = tasks.add_parser("fit", help="fit a model to each spectrum")
    model = fits.add_mutually_exclusive_group()
    model.add_argument("--rc", type=_order, default=4, help="number of RC pairs, or auto")
    model.add_argument("--circuit", help="a circuit in the place of RC pairs")
    fits.add_argument("--objective", default="complex", help="complex, modulus or sum-abs")
    fits.add_argument("--ocv-slope", type=_slope, help="fit, none, or a slope in V/C")
    fits.add_argument("--seed", type=int, default=0)
    fits.add_argument("--starts", type=int, help="number of starts of the search")
    judge = tasks.add_parser("kk", help="Kramers–Kronig test and Z-HIT of each spectrum")
    judge.add_argument("--drt", action="store_true", help="relaxation times too")
    again = tasks.add_parser("replay", help="send captures of runs through the present analysis")
    causes = tasks.add_parser("diagnose", help="diagnose runs against their own models")
    causes.add_argument("--rc", type=int, default=4, help="RC pairs of the model of the run")
    causes.add_argument("--base-only", action="store_true", help="look for no effect")
    for one in (fits, judge, again, causes):
        _common(one)
    return parser


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("spectra", help="a store, a folder or file in long form, or a catalogue")
    parser.add_argument("--out", required=True, help="folder of the job")
    parser.add_argument("--engine", choices=sorted(ENGINES), default="local")
    parser.add_argument("--workers", type=int, help="shards at once [default: all cores]")
    parser.add_argument("--rows", type=int, default=ROWS, help="rows of a shard")


def _task(options: Any) -> AnyTask:
    if options.task == "replay":
        return replay()
    if options.task == "diagnose":
        return diagnose(options.rc, base_only=options.base_only)
    if options.task == "kk":
        return kk(drt=options.drt)
    words = {"objective": options.objective, "ocv_slope": options.ocv_slope}
    return fit(options.rc, circuit=options.circuit, seed=options.seed, starts=options.starts, **words)


def _progress(done: int, of: int) -> None:
    ending = "\n" if done == of else ""
    sys.stderr.write(f"\r{done} of {of} shards{ending}")
    sys.stderr.flush()


def _session(engine: str) -> None:
    """A Spark session of this process, where one is wanted: that which ``spark-submit`` sets up."""
    if engine == "spark":
        from .._optional import optional

        optional("pyspark.sql", "pyspark").SparkSession.builder.getOrCreate()


def main(words: Optional[list[str]] = None) -> int:
    """Plays a command line; gives its exit code."""
    options = _parser().parse_args(words)
    shown = _progress if sys.stderr.isatty() else None
    try:
        _session(options.engine)
        how = {"engine": options.engine, "workers": options.workers, "rows": options.rows}
        done = run(_task(options), options.spectra, options.out, progress=shown, **how)
    except (EisError, ImportError) as error:
        sys.stderr.write(f"eisbench.jobs: {error}\n")
        return 1
    sys.stdout.write(f"{done.file}: {done.rows} rows, {done.errors} without a result\n")
    sys.stdout.write(f"sha256 {done.sha256}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
