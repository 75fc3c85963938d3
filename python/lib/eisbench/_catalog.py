"""Questions across runs: a catalogue in a file, or that of a daemon."""

from __future__ import annotations

import json
import os
import tempfile
import urllib.parse
from collections.abc import Callable, Iterable, Iterator
from datetime import date, datetime, timezone
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np

from . import _eisbench
from ._client import Client
from ._eisbench import EisError
from ._table import Table, frame

PathLike = Union[str, "os.PathLike[str]"]
Time = Union[str, float, int, date, datetime]

# The longest answer that a daemon gives at once.
PAGE = 1000
# Spectra whose files are read at once.
FILES = 256

# Columns in their order, each with its kind; what a newer daemon adds follows behind them.
_RUN = {
    "run": "text",
    "name": "text",
    "cells": "text",
    "serials": "text",
    "scanned_serials": "text",
    "models": "text",
    "batches": "text",
    "barcodes": "text",
    "makers": "text",
    "chemistries": "text",
    "terms": "text",
    "bench": "text",
    "experiment": "text",
    "operator": "text",
    "started_unix_s": "number",
    "time_source": "text",
    "bench_time_s": "number",
    "verdict": "text",
    "how": "text",
    "trip": "text",
    "resumed": "count",
    "spectra": "count",
    "refused_points": "count",
    "fits": "count",
    "map_soc_low": "number",
    "map_soc_high": "number",
    "map_temperature_low_c": "number",
    "map_temperature_high_c": "number",
    "map_left_out_mv": "number",
    "simulated": "flag",
    "missing": "flag",
    "version": "text",
    "config_sha256": "text",
    "content_sha256": "text",
    "damage": "text",
    "folder": "text",
}
_SPECTRUM = {
    "run": "text",
    "name": "text",
    "file": "text",
    "bench": "text",
    "cell": "text",
    "serial": "text",
    "batch": "text",
    "chemistry": "text",
    "repeat": "count",
    "started_unix_s": "number",
    "time_source": "text",
    "amplitude_a": "number",
    "bias_a": "number",
    "ocv_v": "number",
    "temperature_c": "number",
    "points": "count",
    "refused_points": "count",
    "low_hz": "number",
    "high_hz": "number",
    "r_high_ohm": "number",
    "r_high_hz": "number",
    "r_high_sigma_ohm": "number",
    "r_low_ohm": "number",
    "r_low_sigma_ohm": "number",
}
_CELL = {
    "cell": "text",
    "serial": "text",
    "batch": "text",
    "chemistry": "text",
    "runs": "count",
    "first_unix_s": "number",
    "last_unix_s": "number",
}
_FIT = {
    "run": "text",
    "name": "text",
    "file": "text",
    "cell": "text",
    "serial": "text",
    "batch": "text",
    "cells": "count",
    "bench": "text",
    "started_unix_s": "number",
    "time_source": "text",
    "temperature_c": "number",
    "ocv_v": "number",
    "rc": "count",
    "r_ohm": "number",
    "r_sigma_ohm": "number",
    "dc_resistance_ohm": "number",
    "dc_resistance_sigma_ohm": "number",
    "slow_r_ohm": "number",
    "slow_r_sigma_ohm": "number",
    "slow_tau_s": "number",
    "slow_tau_sigma_s": "number",
    "rms_ohm": "number",
    "reduced_chi2": "number",
    "points": "count",
}
_AGEING = {name: kind for name, kind in _FIT.items() if name != "cells"}
_DIAGNOSIS = {
    "run": "text",
    "folder": "text",
    "cell": "text",
    "data_set": "text",
    "model": "text",
    "verdict": "text",
    "summary": "text",
    "effects": "text",
    "parameters": "text",
    "damage": "text",
}
_DIFFUSION = {
    "run": "text",
    "started_unix_s": "number",
    "effect": "text",
    "name": "text",
    "unit": "text",
    "value": "number",
    "sigma": "number",
}
#: Circumstances of a spectrum that stand beside each of its points.
_BESIDE = {
    "run": "text",
    "name": "text",
    "cell": "text",
    "serial": "text",
    "batch": "text",
    "chemistry": "text",
    "bench": "text",
    "started_unix_s": "number",
    "time_source": "text",
    "ocv_v": "number",
    "temperature_c": "number",
}
_POINTS = (
    "freq_hz",
    "z_re_ohm",
    "z_im_ohm",
    "sigma_re_ohm",
    "sigma_im_ohm",
    "cov_re_im_ohm2",
    "amplitude_a",
)
_OF_CELL = ("cell", "serial", "batch")
_OF_RUN = ("bench", "experiment")
_CONDITIONS = (*_OF_CELL, *_OF_RUN, "from_", "to", "verdict", "trip", "map", "text")
# Names of a cell's own columns where a run has several cells.
_OF_CELLS = {
    "name": "cells",
    "serial": "serials",
    "scanned_serial": "scanned_serials",
    "model": "models",
    "batch": "batches",
    "chemistry": "chemistries",
    "barcode": "barcodes",
    "maker": "makers",
    "term": "terms",
}


def unix_s(name: str, time: Optional[Time]) -> Optional[float]:
    """A time in s since 1970; a time without a zone, and a date, are in UTC."""
    if time is None or isinstance(time, (int, float)):
        return None if time is None else float(time)
    try:
        if isinstance(time, str):
            time = datetime.fromisoformat(time.replace("Z", "+00:00"))
        if not isinstance(time, datetime):
            time = datetime(time.year, time.month, time.day)
    except ValueError:
        raise EisError(
            f"{name}: expected a time as 2026-11-28 or 2026-11-28T12:00:00Z, met {time!r}"
        ) from None
    known = time if time.tzinfo is not None else time.replace(tzinfo=timezone.utc)
    return known.timestamp()


class _Wanted:
    """Conditions, as the half in Rust takes them."""

    def __init__(self, **conditions: Any) -> None:
        self.cell: Optional[str] = conditions.get("cell")
        self.serial: Optional[str] = conditions.get("serial")
        self.batch: Optional[str] = conditions.get("batch")
        self.bench: Optional[str] = conditions.get("bench")
        self.experiment: Optional[str] = conditions.get("experiment")
        self.from_s = unix_s("from_", conditions.get("from_"))
        self.to_s = unix_s("to", conditions.get("to"))
        self.verdict: Optional[str] = conditions.get("verdict")
        self.trip = bool(conditions.get("trip"))
        self.map = bool(conditions.get("map"))
        self.text: Optional[str] = conditions.get("text")
        self.after: Optional[str] = None
        self.most = PAGE

    def query(self, *names: str) -> str:
        """The conditions of these names as the query of an address."""
        values = {name: getattr(self, name) for name in names}
        said = {k: str(v).lower() if isinstance(v, bool) else v for k, v in values.items()}
        return urllib.parse.urlencode({k: v for k, v in said.items() if v is not None})


class _OfFile:
    """A catalogue in a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def page(self, what: str, wanted: _Wanted) -> dict[str, Any]:
        return json.loads(getattr(_eisbench.Catalog(self.path), what)(wanted))

    def ageing(self, wanted: _Wanted, rc: Optional[int]) -> dict[str, Any]:
        return json.loads(_eisbench.Catalog(self.path).ageing(wanted, rc))

    def show(self, run: str) -> dict[str, Any]:
        return json.loads(_eisbench.Catalog(self.path).show(run))

    def files(self, rows: list[dict[str, Any]], _aside: Path) -> list[Path]:
        """The files of spectra."""
        runs = list({str(row["run"]): None for row in rows})
        folders = dict(zip(runs, _eisbench.Catalog(self.path).folders(runs)))
        return [Path(folders[row["run"]]) / row["file"] for row in rows]


class _OfServer:
    """The catalogue of a daemon."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def page(self, what: str, wanted: _Wanted) -> dict[str, Any]:
        times = ("from_s", "to_s")
        more = [name for name in ("trip", "map") if getattr(wanted, name)]
        query = wanted.query(
            *_OF_CELL, *_OF_RUN, *times, "verdict", "text", "after", "most", *more
        )
        return self.client._json("GET", f"/catalog/{what}?{query}")

    def ageing(self, wanted: _Wanted, rc: Optional[int]) -> dict[str, Any]:
        more = "" if rc is None else f"&rc={rc}"
        query = wanted.query("cell", "serial", "from_s", "to_s")
        return self.client._json("GET", f"/catalog/ageing?{query}{more}")

    def show(self, run: str) -> dict[str, Any]:
        return self.client._json("GET", f"/catalog/runs/{urllib.parse.quote(run, safe='')}")

    def files(self, rows: list[dict[str, Any]], aside: Path) -> list[Path]:
        """The files of spectra, fetched into a folder."""
        found: list[Path] = []
        for number, row in enumerate(rows):
            into = aside / str(number)
            found.append(self.client.fetch_file(row["name"], row["file"], into))
        return found


class Catalog:
    """A catalogue of runs: ``Catalog("runs.sqlite")``, or ``Catalog("http://127.0.0.1:7420")`` for
    that of a daemon (``docs/catalog.md``). Both give the same answers, as pandas data frames where
    pandas is installed, else as :class:`Table`.

    Conditions of a query, all of which must hold: ``cell`` (name or serial number), ``serial``,
    ``batch``, ``bench``, ``experiment``, ``from_`` and ``to`` (a date in UTC, a time, or s since
    1970), ``verdict`` (``good``, ``doubtful``, ``stopped``, ``failed``, ``unfinished``, ``damaged``),
    ``trip`` (runs that the interlock has ended), ``map`` (runs that have fitted a map), ``text`` (words
    of the run), ``most`` (maximum number of answers; all of them if it is left out).

    ``started_unix_s`` is the time in s since 1970; a data frame has ``started`` too, in UTC.
    """

    def __init__(
        self,
        place: PathLike,
        token: Optional[str] = None,
        *,
        ca: Optional[PathLike] = None,
        timeout_s: float = 30.0,
    ) -> None:
        address = os.fspath(place)
        self._source: Union[_OfFile, _OfServer]
        if "://" in address:
            self._source = _OfServer(Client(address, token, ca=ca, timeout_s=timeout_s))
        elif token is not None or ca is not None:
            raise EisError(f"token, ca: expected none for a file, met one for {address}")
        else:
            self._source = _OfFile(Path(address))

    def __repr__(self) -> str:
        if isinstance(self._source, _OfFile):
            return f"<Catalog: {self._source.path}>"
        return f"<Catalog of {self._source.client!r}>"

    def scan(self, *roots: PathLike) -> dict[str, Any]:
        """Reads the run folders below each root into the file, which is created if it does not
        exist; without a root, those of earlier scans. Returns how many were read. A daemon scans its
        own folders.

        Raises EisError for a missing folder and for a file of another program.
        """
        if not isinstance(self._source, _OfFile):
            raise EisError("scan: expected a catalogue in a file; a daemon scans its own")
        paths = [Path(root) for root in roots]
        return json.loads(_eisbench.Catalog.scan(self._source.path, paths))

    def runs(self, *, most: Optional[int] = None, **conditions: Any) -> Any:
        """Runs, the latest first; several cells of a run stand in one field with ``; ``."""
        return _answer(_RUN, [_run_row(run) for run in self._all("runs", most, conditions)])

    def spectra(self, *, most: Optional[int] = None, **conditions: Any) -> Any:
        """Corrected spectra of cells, the latest first, with their circumstances and the resistances
        at both ends; :meth:`points` gives their points."""
        return _answer(_SPECTRUM, self._all("spectra", most, conditions))

    def cells(self, *, most: Optional[int] = None, **conditions: Any) -> Any:
        """Cells of the runs that meet the conditions, by name, with the number of these runs."""
        return _answer(_CELL, self._all("cells", most, conditions))

    def fits(self, *, most: Optional[int] = None, **conditions: Any) -> Any:
        """Fitted models, the latest first; ``cells`` is the number of cells that one is of."""
        return _answer(_FIT, self._all("fits", most, conditions))

    def diagnoses(self, *, most: Optional[int] = None, **conditions: Any) -> Any:
        """Diagnoses of runs, those of the latest run first; effects stand in one field with ``; ``,
        their parameters as JSON."""
        rows = self._all("diagnoses", most, conditions)
        return _answer(_DIAGNOSIS, [_diagnosis_row(one) for one in rows])

    def show(self, run: str) -> dict[str, Any]:
        """All that is known of a run, by its name or identity, as ``eis-bench catalog show --json``
        prints it: ``run``, ``instruments``, ``spectra``, ``fits``, ``events``, ``diagnoses``."""
        return self._source.show(run)

    def points(self, *, most: Optional[int] = None, **conditions: Any) -> Any:
        """The points of spectra in long form, one row for each, with the circumstances beside it:
        what :func:`fit_table`, :func:`kk_table` and :func:`spectra_of_table` take. ``most`` counts
        spectra. The files of the runs are read now.

        Raises EisError where one cannot be read.
        """
        parts = list(self.parts(most=most, **conditions))
        names = ["spectrum_id", *_POINTS, *_BESIDE]
        return frame({name: _joined([part[name] for part in parts], name) for name in names})

    def parts(self, *, most: Optional[int] = None, **conditions: Any) -> Iterator[Table]:
        """The same in parts of some hundred spectra, for more than fit into memory."""
        for rows in self._pages("spectra", most, conditions):
            for k in range(0, len(rows), FILES):
                yield Table(self._points(rows[k : k + FILES]))

    def ageing(
        self,
        cell: str,
        rc: Optional[int] = None,
        *,
        serial: Optional[str] = None,
        from_: Optional[Time] = None,
        to: Optional[Time] = None,
    ) -> Ageing:
        """A cell over its runs: series resistance, DC resistance and diffusion over time, each with
        its standard uncertainty. ``cell`` is its name or serial number. All models have the same
        number of RC pairs: ``rc``, else the greatest that every run of the cell has. Models of
        several cells together are left out.

        Raises EisError where several cells have this name and no ``serial`` chooses one.
        """
        wanted = _Wanted(cell=cell, serial=serial, from_=from_, to=to)
        raw = self._source.ageing(wanted, rc)
        if serial is None and len(raw["serials"]) > 1:
            named = ", ".join(raw["serials"])
            reason = f"for these cells have the same name {cell!r}, met none"
            raise EisError(f"serial: expected one of {named}, {reason}")
        return Ageing(raw)

    def _all(
        self, what: str, most: Optional[int], conditions: dict[str, Any]
    ) -> list[dict[str, Any]]:
        return [row for page in self._pages(what, most, conditions) for row in page]

    def _pages(
        self, what: str, most: Optional[int], conditions: dict[str, Any]
    ) -> Iterator[list[dict[str, Any]]]:
        """The answers, page by page, up to ``most``."""
        for name in conditions:
            if name not in _CONDITIONS:
                raise TypeError(f"{what}() got an unexpected keyword argument {name!r}")
        if most is not None and most < 1:
            raise EisError(f"most: expected 1 or more, met {most}")
        wanted, left = _Wanted(**conditions), most
        while left != 0:
            wanted.most = PAGE if left is None else min(PAGE, left)
            answer = self._source.page(what, wanted)
            yield answer[what]
            left = None if left is None else left - len(answer[what])
            wanted.after = answer["after"]
            if wanted.after is None:
                return

    def _points(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        """Columns of the points of some spectra."""
        with tempfile.TemporaryDirectory() as aside:
            files = self._source.files(rows, Path(aside))
            columns, results = _eisbench.points_of_files(files)
        for _, reason in results:
            if reason is not None:
                raise EisError(reason)
        counts = [count for count, _ in results]
        ids = [f"{row['run']}/{row['file'].removesuffix('.csv')}" for row in rows]
        made: dict[str, Any] = {"spectrum_id": _repeated("text", ids, counts), **columns}
        for name, kind in _BESIDE.items():
            made[name] = _repeated(kind, [row[name] for row in rows], counts)
        return made


def _run_row(run: dict[str, Any]) -> dict[str, Any]:
    """A run with its cells and damages in one field each."""
    row = dict(run)
    cells: list[dict[str, Any]] = row.pop("cells")
    for name in {name: None for cell in cells for name in cell}:
        texts = [str(cell[name]) for cell in cells if cell.get(name) is not None]
        row[_OF_CELLS.get(name, name)] = "; ".join(texts) or None
    row["damage"] = "; ".join(row["damage"]) or None
    fitted: dict[str, Any] = row.pop("map", None) or {}
    row.update({f"map_{name}": value for name, value in fitted.items()})
    if "tags" in row:
        row["tags"] = "; ".join(row["tags"])
    return row


def _diagnosis_row(one: dict[str, Any]) -> dict[str, Any]:
    """A diagnosis with its effects and parameters in one field each."""
    effects = {parameter["effect"]: None for parameter in one["parameters"]}
    text = json.dumps(one["parameters"], ensure_ascii=False)
    return {**one, "effects": "; ".join(effects) or None, "parameters": text}


def _repeated(kind: str, values: list[Any], counts: list[int]) -> Any:
    if kind == "text":
        return [value for value, count in zip(values, counts) for _ in range(count)]
    return np.repeat(_column(kind, values), counts)


def _joined(parts: list[Any], name: str) -> Any:
    if not parts:
        return [] if _BESIDE.get(name, "number") == "text" else np.zeros(0)
    if isinstance(parts[0], list):
        return [value for part in parts for value in part]
    return np.concatenate(parts)


def _column(kind: str, values: list[Any]) -> Any:
    if kind == "text":
        return [None if value is None else str(value) for value in values]
    if kind == "number":
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
    return np.array(values, dtype=np.int64 if kind == "count" else np.bool_)


def _kind_of(values: list[Any]) -> str:
    """Kind of a column that this version does not know."""
    known = [value for value in values if value is not None]
    is_number: Callable[[Any], bool] = lambda v: isinstance(v, (int, float))
    return "number" if known and all(is_number(value) for value in known) else "text"


def _answer(kinds: dict[str, str], rows: Iterable[dict[str, Any]]) -> Any:
    """Rows as a data frame, with the columns that are known first."""
    rows = list(rows)
    hidden = ("fixture", "corrected", "seed", "time", "time_constants_s", "diffusion")
    names = {name: None for row in rows for name in row}
    more = [name for name in names if name not in kinds and name not in hidden]
    columns: dict[str, Any] = {}
    for name in [*kinds, *more]:
        values = [row.get(name) for row in rows]
        columns[name] = _column(kinds.get(name) or _kind_of(values), values)
    return frame(columns)


class Ageing:
    """A cell over its runs, in the order of time."""

    def __init__(self, raw: dict[str, Any]) -> None:
        #: Everything, as ``eis-bench catalog ageing --json`` prints it.
        self.raw = raw
        self.cell = str(raw["cell"])
        self.rc: Optional[int] = raw["rc"]
        self.orders: list[int] = raw["orders"]

    @property
    def table(self) -> Any:
        """One row for each run: resistances in Ω and time constants in s, with their standard
        uncertainties, temperature and voltage at rest. A data frame where pandas is installed."""
        return _answer(_AGEING, self.raw["points"])

    @property
    def diffusion(self) -> Any:
        """Parameters of diffusion that diagnoses of the runs name, each with its uncertainty."""
        rows = [
            {**one, "run": point["run"], "started_unix_s": point["started_unix_s"]}
            for point in self.raw["points"]
            for one in point["diffusion"]
        ]
        return _answer(_DIFFUSION, rows)

    def plot(self, axes: Any = None) -> Any:
        """Draws each quantity over time, with bars of one standard uncertainty; gives matplotlib
        axes, one for each quantity. ``axes`` are as many of them."""
        from . import _plot

        return _plot.ageing(self, axes)

    def __len__(self) -> int:
        return len(self.raw["points"])

    def __repr__(self) -> str:
        return f"<Ageing of {self.cell}: {len(self)} runs, {self.rc} RC pairs>"

    def _repr_html_(self) -> str:
        table = self.table
        return table._repr_html_() if isinstance(table, Table) else table.to_html()
