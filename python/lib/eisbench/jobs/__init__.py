"""Work on very many spectra: on the cores of this machine, on Ray, or on Spark (``docs/jobs.md``).

>>> from eisbench import jobs
>>> done = jobs.run(jobs.fit(rc=4), "store", "fits")  # doctest: +SKIP
>>> done.table()  # doctest: +SKIP

Every engine calls the same function, :func:`work`, on the same shards. So the table of results is the
same to the last bit, whatever engine made it, with how many workers, and however often it was killed.
"""

from __future__ import annotations

from typing import Any, Optional, Union

from .._catalog import Catalog
from .._eisbench import EisError
from .._optional import parquet
from ._engine import ENGINES, Job, Progress
from ._folder import TABLE, AnyTask, JobFolder
from ._place import PathLike, Place
from ._runs import RunTask, diagnose, replay
from ._shard import ROWS
from ._source import Source, runs, source
from ._task import Task, fit, kk, work

__all__ = ["Done", "RunTask", "Task", "diagnose", "fit", "kk", "replay", "run", "work"]


class Done:
    """A job that is done."""

    def __init__(self, out: Place, manifest: dict[str, Any]) -> None:
        self._out = out
        #: Origin of the table, from ``results.json``.
        self.manifest = manifest

    @property
    def rows(self) -> int:
        """Number of rows: of spectra, or of runs."""
        return int(self.manifest["rows"])

    @property
    def errors(self) -> int:
        """Number of rows without a result; the column ``error`` states the reason."""
        return int(self.manifest["errors"])

    @property
    def sha256(self) -> str:
        """SHA-256 of the file of the table."""
        return str(self.manifest["sha256"])

    @property
    def file(self) -> str:
        """The file of the table."""
        return self._out.at(TABLE)

    def table(self, columns: Optional[list[str]] = None) -> Any:
        """The table, or some of its columns, as an Arrow table."""
        with self._out.open(TABLE) as stream:
            return parquet().read_table(stream, columns=columns)

    def __repr__(self) -> str:
        return f"<Done: {self.rows} rows, {self.errors} without a result, {self.file}>"


def run(
    task: AnyTask,
    spectra: Union[PathLike, Catalog, Any],
    out: PathLike,
    *,
    engine: str = "local",
    workers: Optional[int] = None,
    rows: int = ROWS,
    progress: Optional[Progress] = None,
) -> Done:
    """Does a task on every spectrum or run, and writes one table of results, by ``spectrum_id`` or
    ``row_id``.

    ``spectra`` is a store, a folder of Parquet files in long form, a file of such a table, a
    catalogue, or a table in memory; for :func:`replay` and :func:`diagnose` a store. ``out`` is the
    folder of the job. Both may be addresses of an object store. ``engine`` is ``local`` (threads on
    all cores), ``ray`` (the cluster that ``ray.init`` has joined) or ``spark`` (the active session);
    workers on other machines must see ``spectra`` and ``out`` under the same names. ``rows`` are those of a shard.

    A call that was killed is made again: what is done stays done. So it is with spectra that came
    later. A spectrum without a result has the reason in ``error``.

    Raises EisError for a folder of another task and for input that cannot be read.
    """
    if engine not in ENGINES:
        raise EisError(f"engine: expected one of {', '.join(ENGINES)}, met {engine!r}")
    if workers is not None and workers < 1:
        raise EisError(f"workers: expected 1 or more, met {workers}")
    into = Place(out)
    folder = JobFolder(into, task)
    folder.begin()
    given: Source = runs(spectra) if isinstance(task, RunTask) else source(spectra, into)
    every = task.shards(given.place, given.files, rows)
    ENGINES[engine](Job(task, given.place, into), folder.missing(every), workers, progress)
    return Done(into, folder.assemble(every))
