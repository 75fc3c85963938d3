"""A store as Delta tables, which Spark, Trino, DuckDB, polars and others read."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Optional

from ._eisbench import EisError
from ._optional import arrow, optional, parquet
from .jobs._place import PathLike, Place
from .jobs._shard import partition
from .jobs._source import check_store, rows_of

#: Tables of a store.
TABLES = ("runs", "spectra", "fits", "diagnoses")
#: Name under which a Delta table counts what was written into it.
_WRITER = "eisbench"
_PARTITIONS = ("site", "bench", "date")
#: Rows of one commit, beyond which another follows.
_ROWS = 1_000_000
#: Attempts where others write too.
_ATTEMPTS = 20


@dataclass(frozen=True)
class Written:
    """Runs whose rows were written into a Delta table, and whose rows were removed from it."""

    new: int = 0
    removed: int = 0


def to_delta(
    store: PathLike,
    table: PathLike,
    *,
    tables: Sequence[str] = TABLES,
    storage_options: Optional[Mapping[str, str]] = None,
) -> dict[str, Written]:
    """Updates the Delta tables below an address from the tables of a store: ``table/runs``,
    ``table/spectra``, …, each by ``site``, ``bench`` and ``date``. Returns the changes of each.

    Runs in the table, known by their ``run_sha256``, are not written again; if the store has
    replaced a run, one commit deletes its old rows and adds the new ones. Each commit counts itself
    in the table, so that of two concurrent writers one starts again: the table has every run once,
    and an interrupted call can be repeated. ``storage_options`` are those of ``deltalake``.

    Raises EisError for a folder that is not a store, and if the store has no rows but the table has.
    """
    place = Place(store)
    check_store(place)
    text = os.fspath(table)
    base = text.rstrip("/") if "://" in text else os.path.abspath(text)
    options = None if storage_options is None else dict(storage_options)
    return {name: _Delta(place, f"{base}/{name}", options).write(name) for name in tables}


class _Delta:
    """One Delta table, made of one table of a store."""

    def __init__(self, place: Place, address: str, options: Optional[dict[str, str]]) -> None:
        self._place = place
        self._address = address
        self._options = options
        self._delta = optional("deltalake", "'eisbench[delta]'")

    def write(self, name: str) -> Written:
        """Writes the runs that are not there yet, and removes those that the store has no more."""
        files = {_run_of(file): file for file in rows_of(self._place, f"tables/{name}")}
        done, attempts = Written(), _ATTEMPTS
        while True:
            there = self._there()
            # What a commit holds is asked of the table before each one.
            known = set[str]() if there is None else self._runs(there)
            if known and not files:
                raise EisError(f"{self._address}: expected rows of {name} in the store, met none")
            table, runs = self._batch([file for run, file in files.items() if run not in known])
            gone = sorted(known - set(files))
            if not runs and not gone:
                return done
            try:
                if there is None:
                    # Of two that make it the second would add its rows behind those of the first.
                    self._make(table)
                    continue
                self._commit(there, table, runs, gone)
                done = Written(done.new + len(runs), done.removed + len(gone))
                attempts = _ATTEMPTS
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
        """The rows of some files, whole files only, and the runs of those that have rows."""
        parts: list[Any] = []
        runs: list[str] = []
        rows = 0
        for file in files:
            part = self._part(file)
            if part.num_rows > 0:
                parts.append(part)
                runs.append(_run_of(file))
                rows += part.num_rows
            if rows >= _ROWS:
                break
        if not parts:
            return None, []
        return arrow().concat_tables(parts, promote_options="permissive"), runs

    def _part(self, file: str) -> Any:
        """The rows of one run, with the columns that stand in the path."""
        pa = arrow()
        with self._place.open(file) as stream:
            part = parquet().ParquetFile(stream).read()
        has = "run_sha256" in part.column_names
        runs: list[str] = part["run_sha256"].unique().to_pylist() if has else list[str]()
        if part.num_rows > 0 and runs != [_run_of(file)]:
            raise EisError(f"{file}: expected rows of this run_sha256 alone, met {runs}")
        for name, value in partition(file).items():
            if name not in part.column_names:
                part = part.append_column(name, pa.array([value] * part.num_rows, pa.string()))
        return part

    def _make(self, table: Any) -> None:
        """Makes a table without rows."""
        by = [name for name in _PARTITIONS if name in table.column_names]
        how: dict[str, Any] = {"partition_by": by, "storage_options": self._options}
        self._delta.DeltaTable.create(self._address, table.schema, mode="ignore", **how)

    def _commit(self, there: Any, table: Any, runs: list[str], gone: list[str]) -> None:
        """One commit: new rows in, old ones out, and the number of this commit among those of this
        writer."""
        before = there.transaction_version(_WRITER)
        mark = self._delta.Transaction(_WRITER, (before or 0) + 1)
        marked = {"commit_properties": self._delta.CommitProperties(app_transactions=[mark])}
        if table is None:
            there.delete(_among(gone), **marked)
            return
        how: dict[str, Any] = {"mode": "append", "schema_mode": "merge"}
        if gone:
            how |= {"mode": "overwrite", "predicate": _among([*gone, *runs])}
        self._delta.write_deltalake(there, table, **how, **marked)


def _run_of(file: str) -> str:
    """The run whose rows a file has, by its name."""
    run = PurePosixPath(file).stem
    if len(run) != 64 or set(run) - set("0123456789abcdef"):
        raise EisError(f"{file}: expected a file named by a run_sha256 of 64 digits")
    return run


def _among(runs: list[str]) -> str:
    """The condition that a row is of one of these runs."""
    return f"run_sha256 IN ({', '.join(repr(run) for run in runs)})"
