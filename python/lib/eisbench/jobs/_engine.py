"""Engines: the cores of this machine, Ray, Spark. All of them call :func:`do`."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, Optional

from .._eisbench import EisError
from .._optional import arrow, optional
from ._folder import AnyTask, JobFolder
from ._place import Place
from ._shard import Shard

#: Receives the number of finished shards and the number of all shards.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Job:
    """All that a worker must know, wherever it runs."""

    task: AnyTask
    source: Place
    out: Place

    def do(self, shard: Shard) -> int:
        """Does one shard and keeps its results; the number of its rows. One that is done already
        is not done again."""
        folder = JobFolder(self.out, self.task)
        if folder.has(shard):
            return 0
        table = self.task.results(self.source, shard)
        folder.keep(shard, table)
        return int(table.num_rows)

    def do_json(self, text: str) -> dict[str, Any]:
        """Does the shard of a JSON text; gives what was done as a row."""
        shard = Shard.read(json.loads(text))
        try:
            return {"shard": shard.name, "error": None, "rows": self.do(shard)}
        except EisError as error:
            # An engine would do it again, with the same end.
            return {"shard": shard.name, "error": str(error), "rows": 0}


class _Count:
    """Counts shards that are done, and keeps the reasons of those that cannot be done."""

    def __init__(self, all_of_them: int, progress: Optional[Progress]) -> None:
        self._all = all_of_them
        self._progress = progress
        self._done = 0
        self._errors: list[str] = []

    def add(self, error: Optional[str]) -> None:
        """One more shard."""
        self._done += 1
        if error is not None:
            self._errors.append(error)
        if self._progress is not None:
            self._progress(self._done, self._all)

    def end(self) -> None:
        """Raises EisError where a shard could not be done."""
        if self._errors:
            reasons = "; ".join(self._errors[:3])
            raise EisError(f"{len(self._errors)} of {self._all} shards cannot be done: {reasons}")


def local(
    job: Job, todo: Sequence[Shard], workers: Optional[int], progress: Optional[Progress]
) -> None:
    """Does shards on threads of this process; the half in Rust works without the interpreter's
    lock."""
    count, waiting = _Count(len(todo), progress), iter(todo)
    threads = workers or len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(max_workers=threads) as pool:
        going: set[Future[dict[str, Any]]] = set()
        try:
            while True:
                # No more than a few wait in the pool: Ctrl-C ends the job after those in work.
                while len(going) < 2 * threads and (shard := next(waiting, None)) is not None:
                    going.add(pool.submit(job.do_json, json.dumps(shard.as_dict())))
                if not going:
                    break
                done, going = wait(going, return_when=FIRST_COMPLETED)
                for one in done:
                    count.add(one.result()["error"])
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    count.end()


def ray(
    job: Job, todo: Sequence[Shard], workers: Optional[int], progress: Optional[Progress]
) -> None:
    """Does shards as rows of a Ray data set, one core each. Ray does those again whose worker or
    node has died."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    cluster, sets = optional("ray", "'ray[data]'"), optional("ray.data", "'ray[data]'")
    if not cluster.is_initialized():
        cluster.init(include_dashboard=False, log_to_driver=False)
    if not todo:
        return
    count = _Count(len(todo), progress)
    rows = [{"text": json.dumps(shard.as_dict())} for shard in todo]
    given = sets.from_items(rows, override_num_blocks=len(rows))

    def do(row: dict[str, str]) -> dict[str, Any]:
        return job.do_json(row["text"])

    done = given.map(do, num_cpus=1, concurrency=workers)
    for row in done.iter_rows():
        count.add(row["error"])
    count.end()


def spark(
    job: Job, todo: Sequence[Shard], workers: Optional[int], progress: Optional[Progress]
) -> None:
    """Does shards as rows of a Spark data frame by ``mapInArrow``, in the session that is active."""
    session = optional("pyspark.sql", "pyspark").SparkSession.getActiveSession()
    if session is None:
        raise EisError("spark: expected an active SparkSession, met none")
    if not todo:
        return
    count = _Count(len(todo), progress)
    rows = [(json.dumps(shard.as_dict()),) for shard in todo]
    parallel = session.sparkContext.parallelize(rows, workers or len(rows))
    given = session.createDataFrame(parallel, "text string")
    done = given.mapInArrow(batches_of(job), "shard string, error string, rows bigint")
    for row in done.collect():
        count.add(row["error"])
    count.end()


def batches_of(job: Job) -> Callable[[Iterator[Any]], Iterator[Any]]:
    """The work of a job as ``mapInArrow`` calls it: batches of shards to batches of what was done."""

    def do(batches: Iterator[Any]) -> Iterator[Any]:
        pa = arrow()
        kinds = {"shard": pa.string(), "error": pa.string(), "rows": pa.int64()}
        for batch in batches:
            rows = [job.do_json(text) for text in batch.column(0).to_pylist()]
            yield pa.RecordBatch.from_pylist(rows, schema=pa.schema(kinds))

    return do


ENGINES = {"local": local, "ray": ray, "spark": spark}
