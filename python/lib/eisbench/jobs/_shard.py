"""Tables of spectra in long form, cut into shards: the same input gives the same shards."""

from __future__ import annotations

import hashlib
import os
import urllib.parse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import accumulate
from typing import Any, Optional, Protocol

import numpy as np

from .._api import POINT_COLUMNS
from .._eisbench import EisError
from .._optional import arrow, parquet
from ._place import Place
from ._columns import CARRIED, canonical

#: Rows of a shard: some 1000 spectra of 25 points, a few seconds of work.
ROWS = 25_000
_BLOCK = 1 << 20
#: Name that Hive gives the partition of a value that is not known.
_UNKNOWN = "__HIVE_DEFAULT_PARTITION__"


@dataclass(frozen=True)
class Piece:
    """Rows of a file: the spectra whose first row is from ``start`` on and before ``stop``."""

    file: str
    sha256: str
    start: int
    stop: int


class HasHash(Protocol):
    """A task, as far as its shards must know it."""

    @property
    def sha256(self) -> str:
        """SHA-256 of the task."""
        ...


@dataclass(frozen=True)
class Shard:
    """What one worker does at once. Its name follows from the task and the bytes of its files."""

    name: str
    pieces: tuple[Piece, ...]

    @staticmethod
    def of(task: HasHash, pieces: tuple[Piece, ...]) -> Shard:
        """The shard of some pieces."""
        identity = {"task_sha256": task.sha256, "pieces": [asdict(piece) for piece in pieces]}
        return Shard(hashlib.sha256(canonical(identity).encode()).hexdigest(), pieces)

    def as_dict(self) -> dict[str, Any]:
        """The shard as JSON."""
        return {"shard": self.name, "pieces": [asdict(piece) for piece in self.pieces]}

    @staticmethod
    def read(record: dict[str, Any]) -> Shard:
        """The shard from the JSON of :meth:`as_dict`."""
        return Shard(record["shard"], tuple(Piece(**piece) for piece in record["pieces"]))


def shards(place: Place, files: list[str], task: HasHash, rows: int = ROWS) -> list[Shard]:
    """The shards of a table in some Parquet files, in the order of their names.

    A file of more than ``rows`` rows is cut into pieces of as many; smaller ones stand together,
    those of one folder only. So a new file in the folder of a new day changes no shard of another
    day.
    """
    if rows < 1:
        raise EisError(f"rows: expected 1 or more, met {rows}")
    with ThreadPoolExecutor(max_workers=4) as pool:
        wholes = list(pool.map(partial(_whole, place), files))
    found: list[Shard] = []
    together: list[Piece] = []

    def close() -> None:
        if together:
            found.append(Shard.of(task, tuple(together)))
            together.clear()

    for whole in wholes:
        folder = os.path.dirname(whole.file)
        if whole.stop > rows:
            close()
            found.extend(Shard.of(task, (piece,)) for piece in _cut(whole, rows))
            continue
        known = sum(piece.stop for piece in together)
        if together and (os.path.dirname(together[0].file) != folder or known + whole.stop > rows):
            close()
        if whole.stop > 0:
            together.append(whole)
    close()
    return found


def _whole(place: Place, file: str) -> Piece:
    """All rows of a file, which must have the columns of a table in long form."""

    sha256 = hashlib.sha256()
    with place.open(file) as stream:
        while block := stream.read(_BLOCK):
            sha256.update(block)
        stream.seek(0)
        try:
            head = parquet().ParquetFile(stream)
            names, rows = head.schema_arrow.names, int(head.metadata.num_rows)
        except Exception as error:
            raise EisError(f"{place.at(file)}: expected a Parquet file: {error}") from None
    for needed in ("spectrum_id", *POINT_COLUMNS[:3]):
        if needed not in names:
            listed = ", ".join(names)
            raise EisError(f"{place.at(file)}: expected a column {needed}, met {listed}")
    return Piece(file, sha256.hexdigest(), 0, rows)


def _cut(whole: Piece, rows: int) -> Iterator[Piece]:
    for start in range(0, whole.stop, rows):
        yield Piece(whole.file, whole.sha256, start, min(start + rows, whole.stop))


def read(place: Place, shard: Shard) -> Any:
    """The spectra of a shard, whole, as an Arrow table with those columns that work needs."""
    pa = arrow()
    parts = [_read(place, piece) for piece in shard.pieces]
    table = pa.concat_tables(parts, promote_options="permissive")
    _refuse_pieces(shard, table["spectrum_id"].combine_chunks().dictionary_encode())
    return table


def _refuse_pieces(shard: Shard, ids: Any) -> None:
    """Refuses rows of a spectrum that stand in two places: they may be of two spectra."""
    codes = ids.indices.to_numpy()
    begins = np.flatnonzero(np.diff(codes, prepend=-1))
    again = np.flatnonzero(np.diff(codes[begins], prepend=-1) < 0)
    if len(again):
        name = ids.dictionary[int(codes[begins[again[0]]])].as_py()
        files = ", ".join(piece.file for piece in shard.pieces)
        expected = "expected the rows of each spectrum one after another"
        raise EisError(f"{files}: {expected}, met spectrum_id {name!r} again")


def _read(place: Place, piece: Piece) -> Any:
    pa = arrow()
    wanted = ("spectrum_id", *POINT_COLUMNS, *CARRIED)
    with place.open(piece.file) as stream:
        file = parquet().ParquetFile(stream)
        names = [name for name in wanted if name in file.schema_arrow.names]
        table = _Rows(pa, file, names).spectra(piece.start, piece.stop)
    for index, name in enumerate(table.column_names):
        kind = pa.string() if CARRIED.get(name) == "text" or name == "spectrum_id" else pa.float64()
        table = table.set_column(index, name, table[name].cast(kind))
    for name, value in partition(piece.file).items():
        if name in CARRIED and name not in names:
            table = table.append_column(name, pa.array([value] * table.num_rows, pa.string()))
    return table


def partition(file: str) -> dict[str, Optional[str]]:
    """Columns that stand in the path, percent-encoded: ``site=north/bench=b1/…``; none where the
    path says that the value is not known."""
    parts = [part.partition("=") for part in file.split("/")[:-1]]
    values = {name: urllib.parse.unquote(value) for name, sign, value in parts if sign}
    return {name: None if value == _UNKNOWN else value for name, value in values.items()}


class _Rows:
    """Rows of a Parquet file, read by groups."""

    def __init__(self, pa: Any, file: Any, names: list[str]) -> None:
        self._pa = pa
        self._file = file
        self._names = names
        meta = file.metadata
        sizes = [int(meta.row_group(k).num_rows) for k in range(meta.num_row_groups)]
        self._ends = list(accumulate(sizes))

    def _groups(self, start: int, stop: int) -> list[int]:
        """Groups with rows from ``start`` on and before ``stop``."""
        begins = [0, *self._ends]
        return [k for k, end in enumerate(self._ends) if end > start and begins[k] < stop]

    def spectra(self, start: int, stop: int) -> Any:
        """The whole spectra whose first row is from ``start`` on and before ``stop``."""
        groups = self._groups(max(start - 1, 0), stop)
        table = self._file.read_row_groups(groups, columns=self._names)
        base = [0, *self._ends][groups[0]]
        ids, begin, end = table["spectrum_id"], start - base, stop - base
        if start > 0:
            before = ids[begin - 1]
            while begin < end and ids[begin] == before:
                begin += 1
        if begin == end:
            return table.slice(0, 0)
        last, following = ids[end - 1], groups[-1] + 1
        while end < len(ids) or following < len(self._ends):
            if end == len(ids):
                more = self._file.read_row_groups([following], columns=self._names)
                table, following = self._pa.concat_tables([table, more]), following + 1
                ids = table["spectrum_id"]
                continue
            if ids[end] != last:
                break
            end += 1
        return table.slice(begin, end - begin)
