"""A store as Delta tables, which Spark, Trino, DuckDB, polars and others read."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Optional

from ._eisbench import EisError
from ._optional import arrow, optional, parquet
from .jobs._place import PathLike, Place
from .jobs._shard import partition
from .jobs._source import check_store

#: Tables of a store.
TABLES = ("runs", "spectra", "fits", "diagnoses")
#: Name under which a Delta table counts what was written into it.
_WRITER = "eisbench"
_PARTITIONS = ("site", "bench", "date")
#: Rows of one commit, beyond which another follows.
_ROWS = 1_000_000
#: Attempts where others write too.
_ATTEMPTS = 20


def to_delta(
    store: PathLike,
    table: PathLike,
    *,
    tables: Sequence[str] = TABLES,
    storage_options: Optional[Mapping[str, str]] = None,
) -> dict[str, int]:
    """Writes the tables of a store as Delta tables below an address: ``table/runs``,
    ``table/spectra``, …, each by ``site``, ``bench`` and ``date``. Gives the number of runs that
    were new in each.

    Runs that are there are not written again, by their ``run_sha256``. Each commit counts itself in
    the table, so that of two writers at once one begins again: every run is there once, and a call
    that was killed is made again. ``storage_options`` are those of ``deltalake``.

    Raises EisError for a folder that is no store.
    """
    place = Place(store)
    check_store(place)
    told = os.fspath(table)
    base = told.rstrip("/") if "://" in told else os.path.abspath(told)
    options = None if storage_options is None else dict(storage_options)
    return {name: _Delta(place, f"{base}/{name}", options).write(name) for name in tables}


class _Delta:
    """One Delta table, made of one table of a store."""

    def __init__(self, place: Place, address: str, options: Optional[dict[str, str]]) -> None:
        self._place = place
        self._address = address
        self._options = options
        self._delta = optional("deltalake", "'eisbench[delta]'")

    def write(self, name: str) -> int:
        """Writes the runs that are not there yet; their number."""
        files = self._place.names(f"tables/{name}", ".parquet")
        written, attempts = 0, _ATTEMPTS
        while True:
            there = self._there()
            known = set[str]() if there is None else self._runs(there)
            new = [file for file in files if PurePosixPath(file).stem not in known]
            table, files_of_it = self._batch(new)
            if not files_of_it:
                return written
            try:
                self._append(there, table)
                # What a commit holds is asked of the table before the next one.
                written, attempts = written + len(files_of_it), _ATTEMPTS
            except self._delta.exceptions.DeltaError as error:
                attempts -= 1
                if attempts == 0 or not self._by_others(error, there):
                    expected = "expected to be able to commit beside other writers"
                    raise EisError(f"{self._address}: {expected}: {error}") from None

    def _there(self) -> Any:
        """The table as it is now; None where there is none."""
        try:
            return self._delta.DeltaTable(self._address, storage_options=self._options)
        except self._delta.exceptions.TableNotFoundError:
            return None

    def _by_others(self, error: Exception, before: Any) -> bool:
        """Whether another writer was the first: with its commit, or with making the table."""
        if isinstance(error, self._delta.exceptions.CommitFailedError):
            return True
        return before is None and self._there() is not None

    def _runs(self, there: Any) -> set[str]:
        runs: set[str] = set()
        for batch in there.to_pyarrow_dataset().to_batches(columns=["run_sha256"]):
            runs.update(batch.column(0).unique().to_pylist())
        return runs

    def _batch(self, files: list[str]) -> tuple[Any, list[str]]:
        """The rows of some files, whole files only, and those that have rows."""
        parts: list[Any] = []
        taken: list[str] = []
        rows = 0
        for file, part in self._parts(files):
            if part.num_rows > 0:
                parts.append(part)
                taken.append(file)
                rows += part.num_rows
            if rows >= _ROWS:
                break
        if not parts:
            return None, []
        return arrow().concat_tables(parts, promote_options="permissive"), taken

    def _parts(self, files: list[str]) -> Iterator[tuple[str, Any]]:
        for file in files:
            with self._place.open(file) as stream:
                part = parquet().ParquetFile(stream).read()
            if "run_sha256" not in part.column_names:
                told = ", ".join(part.column_names)
                raise EisError(f"{file}: expected a column run_sha256, met {told}")
            yield file, _partitioned(part, file)

    def _append(self, there: Any, table: Any) -> None:
        """One commit: rows, and the number of this commit among those of this writer."""
        before = None if there is None else there.transaction_version(_WRITER)
        mark = self._delta.Transaction(_WRITER, (before or 0) + 1)
        self._delta.write_deltalake(
            self._address if there is None else there,
            table,
            mode="error" if there is None else "append",
            schema_mode=None if there is None else "merge",
            partition_by=[name for name in _PARTITIONS if name in table.column_names],
            storage_options=self._options if there is None else None,
            commit_properties=self._delta.CommitProperties(app_transactions=[mark]),
        )


def _partitioned(part: Any, file: str) -> Any:
    """A table with the columns that stand in its path."""
    pa = arrow()
    for name, value in partition(file).items():
        if name not in part.column_names:
            part = part.append_column(name, pa.array([value] * part.num_rows, pa.string()))
    return part
