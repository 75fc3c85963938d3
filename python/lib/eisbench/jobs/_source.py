"""Where the spectra of a job are."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, cast

from .._catalog import Catalog
from .._eisbench import EisError
from .._optional import arrow, optional, parquet
from ._place import Place

#: Table of spectra in a store.
SPECTRA = "tables/spectra"
_CATALOG = b"SQLite format 3\0"


@dataclass(frozen=True)
class Source:
    """Parquet files in long form: a folder, and their names in it."""

    place: Place
    files: list[str]


def source(spectra: Any, out: Place) -> Source:
    """The files of spectra. Other inputs are first written as Parquet into the job's folder."""
    if isinstance(spectra, Catalog):
        return _written(spectra.parts(), out)
    if not isinstance(spectra, (str, os.PathLike)):
        return _written(iter([spectra]), out)
    place = Place(cast("str", spectra))
    if place.info().is_file:
        return _file(place, out)
    is_store = place.has("store.json")
    if is_store:
        check_store(place)
    below = SPECTRA if is_store else ""
    files = rows_of(place, below) if is_store else place.names("", ".parquet")
    if not files:
        raise EisError(f"{place.at(below)}: expected Parquet files of spectra, met none")
    return Source(place, files)


def runs(store: Any) -> Source:
    """The lists of the runs of a store whose rows are in its tables: those that no other run has
    replaced."""
    if not isinstance(store, (str, os.PathLike)):
        raise EisError(f"expected a store, for its runs; met {type(store).__name__}")
    place = Place(cast("str", store))
    check_store(place)
    there = {PurePosixPath(name).stem for name in rows_of(place, "tables/runs")}
    lists = [name for name in place.names("runs", ".json") if PurePosixPath(name).stem in there]
    if not lists:
        raise EisError(f"{place.at('runs')}: expected lists of runs with rows, met none")
    return Source(place, lists)


def rows_of(place: Place, table: str) -> list[str]:
    """The files of a table of a store: of those runs alone whose list is there, which is written
    last."""
    there = {PurePosixPath(name).stem for name in place.names("runs", ".json")}
    return [name for name in place.names(table, ".parquet") if PurePosixPath(name).stem in there]


def check_store(place: Place) -> None:
    """Refuses a folder that is not a store of runs, and one of another version."""
    where = place.at("store.json")
    try:
        record: Any = json.loads(place.read("store.json"))
        known = (record["format"], record["version"])
    except (ValueError, KeyError, TypeError) as error:
        raise EisError(f"{where}: expected format and version of a store: {error!r}") from None
    if known != ("eis-bench store", 1):
        raise EisError(f"{where}: expected 'eis-bench store', version 1, met {known}")


def _file(place: Place, out: Place) -> Source:
    """The source of one file: Parquet, a catalogue, or CSV."""
    folder, name = place.beside()
    if name.endswith(".parquet"):
        return Source(folder, [name])
    with place.open("") as stream:
        head = bytes(stream.read(len(_CATALOG)))
    if head == _CATALOG and place.is_local:
        return _written(Catalog(place.path).parts(), out)
    reader = optional("pyarrow.csv", "'eisbench[jobs]'")
    with place.open("") as stream:
        try:
            table = reader.read_csv(stream)
        except Exception as error:
            expected = "expected Parquet, a catalogue, or CSV in long form"
            raise EisError(f"{place.path}: {expected}: {error}") from None
    return _written(iter([table]), out)


def _written(tables: Iterator[Any], out: Place) -> Source:
    """The source of tables, which are written into ``input`` of the job's folder under the hash of
    their bytes."""
    pa = arrow()
    names: list[str] = []
    for table in tables:
        whole = table if isinstance(table, pa.Table) else _arrow_of(pa, table)
        buffer = io.BytesIO()
        parquet().write_table(whole, buffer, compression="zstd")
        data = buffer.getvalue()
        names.append(f"input/{hashlib.sha256(data).hexdigest()}.parquet")
        if not out.has(names[-1]):
            out.put(names[-1], lambda stream, data=data: stream.write(data))
    if not names:
        raise EisError("spectra: expected at least one, met none")
    return Source(out, sorted(names))


def _arrow_of(pa: Any, table: Any) -> Any:
    """A data frame, a mapping of columns, or anything that hands Arrow over, as an Arrow table."""
    if isinstance(table, Mapping):
        return pa.table(dict(cast("Mapping[str, Any]", table)))
    if hasattr(table, "__arrow_c_stream__"):
        return pa.table(table)
    if hasattr(table, "to_dict") and hasattr(table, "columns"):
        return pa.Table.from_pandas(table, preserve_index=False)
    raise EisError(f"spectra: expected a place or a table, met {type(table).__name__}")
