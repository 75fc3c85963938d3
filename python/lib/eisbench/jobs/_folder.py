"""The folder of a job: the task, a file for each shard that is done, and the table of them all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any, Union, cast

from .._eisbench import EisError
from .._optional import arrow, parquet
from ._place import Place
from ._shard import Shard
from ._runs import RunTask
from ._task import Task

JOB = "job.json"
TABLE = "results.parquet"
MANIFEST = "results.json"
#: A task on spectra or on runs.
AnyTask = Union[Task, RunTask]

_FORMAT = "eisbench job"
_VERSION = 1
#: Rows of a group of the table of results.
_GROUP = 50_000


class JobFolder:
    """Results of one task, whatever engine works on them.

    * ``job.json``: the task
    * ``shards/NAME.parquet``: the results of a shard; its name follows from task and input
    * ``results.parquet``: all rows, by ``spectrum_id`` or ``row_id``; ``results.json`` states their origin
    """

    def __init__(self, place: Place, task: AnyTask) -> None:
        self.place = place
        self.task = task

    def begin(self) -> None:
        """Writes the task, or holds it against the one that is there.

        Raises EisError for the folder of another task, and for one of something else.
        """
        record = {
            "format": _FORMAT,
            "version": _VERSION,
            "task": self.task.kind,
            "program": self.task.program,
            "parameters": json.loads(self.task.parameters),
            "task_sha256": self.task.sha256,
        }
        if not self.place.has(JOB):
            self._json(JOB, record)
            return
        known = job_of(self.place)
        if known["task_sha256"] != self.task.sha256:
            text = "{task} by version {program} with {parameters}"
            met, expected = text.format(**known), text.format(**record)
            raise EisError(f"{self.place.at(JOB)}: expected {expected}, met {met}")

    def has(self, shard: Shard) -> bool:
        """Whether a shard is done."""
        return self.place.has(_file(shard))

    def missing(self, shards: Sequence[Shard]) -> list[Shard]:
        """The shards that are not done, in their order."""
        done = set(self.place.names("shards", ".parquet"))
        return [shard for shard in shards if _file(shard) not in done]

    def keep(self, shard: Shard, table: Any) -> None:
        """Keeps the results of a shard. Who does a shard again writes the same bytes."""
        self.place.put(_file(shard), lambda stream: _write(table, stream))

    def assemble(self, shards: Sequence[Shard]) -> dict[str, Any]:
        """Writes the table of all results, by its key, and its manifest, which it gives."""
        pa = arrow()
        parts = [self._part(shard) for shard in shards]
        table = pa.concat_tables([self.task.schema().empty_table(), *parts])
        table = table.sort_by(self.task.key).combine_chunks()
        _refuse_twice(table[self.task.key], self.task.key)
        self.place.put(TABLE, lambda stream: _write(table, stream))
        manifest = {
            "format": "eisbench results",
            "version": _VERSION,
            "task_sha256": self.task.sha256,
            "rows": table.num_rows,
            "errors": table.num_rows - int(table["error"].null_count),
            "sha256": self._sha256(TABLE),
            "shards": [
                {**shard.as_dict(), "rows": part.num_rows} for shard, part in zip(shards, parts)
            ],
        }
        self._json(MANIFEST, manifest)
        return manifest

    def _part(self, shard: Shard) -> Any:
        """The results of a shard."""
        with self.place.open(_file(shard)) as stream:
            try:
                return parquet().read_table(stream)
            except Exception as error:
                where = self.place.at(_file(shard))
                raise EisError(
                    f"{where}: expected the results of a shard: {error}; "
                    "without this file the job does the shard again"
                ) from None

    def _json(self, name: str, content: Any) -> None:
        text = json.dumps(content, indent=1, sort_keys=True) + "\n"
        self.place.put(name, lambda stream: stream.write(text.encode()))

    def _sha256(self, name: str) -> str:
        digest = hashlib.sha256()
        with self.place.open(name) as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
        return digest.hexdigest()


def job_of(place: Place) -> dict[str, Any]:
    """The task of a job's folder.

    Raises EisError for the folder of something else.
    """
    where = place.at(JOB)
    try:
        record: Any = json.loads(place.read(JOB))
    except ValueError as error:
        raise EisError(f"{where}: expected JSON: {error}") from None
    known = cast("dict[str, Any]", record) if isinstance(record, dict) else {}
    if known.get("format") != _FORMAT or known.get("version") != _VERSION:
        met = f"{known.get('format')!r}, version {known.get('version')!r}"
        raise EisError(f"{where}: expected {_FORMAT!r}, version {_VERSION}, met {met}")
    return known


def _file(shard: Shard) -> str:
    return f"shards/{shard.name}.parquet"


def _write(table: Any, stream: Any) -> None:
    """Writes a table. The same table gives the same bytes with the same version of pyarrow."""
    parquet().write_table(table, stream, compression="zstd", row_group_size=_GROUP)


def _refuse_twice(ids: Any, key: str) -> None:
    names: list[str] = ids.to_pylist()
    for before, name in zip(names, names[1:]):
        if before == name:
            raise EisError(f"expected each {key} once, met {name!r} in two files")
