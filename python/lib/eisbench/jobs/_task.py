"""One function from whole spectra to results. Every engine calls it unchanged."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from .. import _eisbench
from .._api import POINT_COLUMNS, FitWishes, Given, points_of, spectra_of_groups
from .._eisbench import EisError
from .._optional import arrow
from . import _shard
from ._columns import CARRIED, MADE, canonical
from ._place import Place
from ._shard import Shard

@dataclass(frozen=True)
class Task:
    """Work on each spectrum by itself: its kind and its parameters, as canonical JSON.

    :func:`fit` and :func:`kk` make one.
    """

    kind: str
    parameters: str
    program: str = _eisbench.__version__

    #: The column that names a row.
    key = "spectrum_id"

    def __post_init__(self) -> None:
        # A parameter that cannot be is refused here, and not by a worker an hour later.
        self.columns([])

    @property
    def sha256(self) -> str:
        """SHA-256 of kind, parameters and version of the program: results of two tasks with the
        same one compare."""
        identity = {"task": self.kind, "program": self.program, "parameters": self.parameters}
        return hashlib.sha256(canonical(identity).encode()).hexdigest()

    def columns(self, given: Sequence[Any]) -> dict[str, tuple[str, Any]]:
        """Kind and values of each column of results, on this thread."""
        parameters: dict[str, Any] = json.loads(self.parameters)
        if self.kind == "fit":
            return FitWishes(**parameters).columns(given, alone=True)
        if self.kind == "kk":
            return _eisbench.validity_rows(given, bool(parameters["drt"]), True)
        raise EisError(f"task: expected fit or kk, met {self.kind!r}")

    def shards(self, place: Place, files: list[str], rows: int) -> list[Shard]:
        """The shards of a table in some files."""
        return _shard.shards(place, files, self, rows)

    def results(self, place: Place, shard: Shard) -> Any:
        """The results of the spectra of a shard."""
        return work(self, _shard.read(place, shard))

    def schema(self) -> Any:
        """The Arrow schema of the results."""
        pa = arrow()
        none = pa.array([], pa.float64())
        empty = {"spectrum_id": pa.array([], pa.string())}
        return work(self, pa.table({**empty, **{name: none for name in POINT_COLUMNS}})).schema


def fit(
    rc: Union[int, str] = 4,
    *,
    circuit: Optional[str] = None,
    objective: str = "complex",
    ocv_slope: Union[str, float, None] = None,
    seed: int = 0,
    starts: Optional[int] = None,
) -> Task:
    """A fit of each spectrum, with the arguments of :func:`eisbench.fit_table`."""
    parameters = {
        "rc": 0 if circuit is not None else rc if isinstance(rc, str) else int(rc),
        "circuit": circuit,
        "objective": objective,
        "ocv_slope": ocv_slope,
        "seed": int(seed),
        "starts": None if starts is None else int(starts),
    }
    return Task("fit", canonical(parameters))


def kk(*, drt: bool = False) -> Task:
    """Kramers–Kronig test and Z-HIT of each spectrum, as :func:`eisbench.kk_table`."""
    return Task("kk", canonical({"drt": drt}))


def work(task: Task, table: Any) -> Any:
    """The results of an Arrow table of whole spectra in long form: an Arrow table with one row for
    each spectrum, in the order of their first rows.

    It depends on its arguments alone: no file, no clock, no random number without a seed, one
    thread. The columns are those of the task, then the circumstances of the spectrum, then
    ``task``, ``program``, ``parameters``, ``task_sha256``, and ``input_sha256`` of its points.
    """
    if task.program != _eisbench.__version__:
        expected = f"expected version {task.program} of eisbench, as where the job began"
        raise EisError(f"task: {expected}, met {_eisbench.__version__}")
    pa = arrow()
    points, groups = points_of(table), _Groups(pa, table)
    given = [Given(*one) for one in spectra_of_groups(points, groups.names, groups.rank)]
    columns: dict[str, Any] = {}
    for name, (kind, values) in task.columns(given).items():
        columns[name] = _array(pa, kind, values)
    for name, kind in CARRIED.items():
        columns[name] = _carried(pa, table, name, kind, groups.first)
    made = [task.kind, task.program, task.parameters, task.sha256]
    for name, text in zip(MADE, made):
        columns[name] = pa.array([text] * len(given), pa.string())
    columns["input_sha256"] = pa.array(_hashes(points, groups), pa.string())
    return pa.table(columns)


class _Groups:
    """The rows of each spectrum of an Arrow table, in the order of their first rows."""

    def __init__(self, pa: Any, table: Any) -> None:
        if "spectrum_id" not in table.column_names:
            raise EisError("table: expected a column spectrum_id, met none")
        ids = table["spectrum_id"].cast(pa.string()).combine_chunks()
        if ids.null_count:
            raise EisError("table: expected a spectrum_id in every row, met none")
        coded = ids.dictionary_encode()
        self.names: list[str] = coded.dictionary.to_pylist()
        self.rank: NDArray[np.int64] = coded.indices.to_numpy().astype(np.int64)
        _, self.first = np.unique(self.rank, return_index=True)
        self.order = np.argsort(self.rank, kind="stable")
        self.ends = np.cumsum(np.bincount(self.rank, minlength=len(self.names)))


def _array(pa: Any, kind: str, values: Any) -> Any:
    if kind == "text":
        return pa.array(values, pa.string())
    floats: NDArray[np.float64] = np.asarray(values, dtype=np.float64)
    numbers_of_it = pa.array(floats, pa.float64(), from_pandas=True)
    return numbers_of_it if kind == "number" else numbers_of_it.cast(pa.int64())


def _carried(pa: Any, table: Any, name: str, kind: str, first: NDArray[np.int64]) -> Any:
    wanted = pa.string() if kind == "text" else pa.float64()
    if name not in table.column_names:
        return pa.nulls(len(first), wanted)
    values: Any = table[name].take(pa.array(first))
    values = values.combine_chunks() if hasattr(values, "combine_chunks") else values
    return values.cast(wanted)


def _hashes(points: Mapping[str, NDArray[np.float64]], groups: _Groups) -> list[str]:
    """SHA-256 of each spectrum: its name, a zero, and its rows of the columns of points in their
    order, as little-endian numbers; not a number where the input does not have one."""
    none = np.full(len(groups.rank), np.nan)
    columns = [points.get(name, none) for name in POINT_COLUMNS]
    rows = np.column_stack(columns).astype("<f8")[groups.order]
    rows[np.isnan(rows)] = np.nan
    found: list[str] = []
    start = 0
    for name, end in zip(groups.names, groups.ends.tolist()):
        content = name.encode() + b"\0" + rows[start:end].tobytes()
        found.append(hashlib.sha256(content).hexdigest())
        start = end
    return found
