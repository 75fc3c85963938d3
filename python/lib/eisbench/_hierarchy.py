"""Hierarchical fits of results: cells within batches, benches beside them, and what stands out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any, Optional, Union, cast

import numpy as np
from numpy.typing import NDArray

from . import _eisbench
from ._eisbench import EisError
from ._table import columns_of, frame, names_of, numbers

Floats = NDArray[np.float64]
Levels = NDArray[np.int64]

#: Rounds of fits in which spectra that stand out are taken out; few tables need three.
_ROUNDS = 10
#: Maximum share of outlying cells in a table; with more, the other cells are not a reference.
_MOST_CELLS = 0.2
#: The same as a number: each costs a fit.
_MOST_STEPS = 10
_DAY_S = 86_400.0


@dataclass
class _Rows:
    """Rows of one quantity, as the half in Rust takes them, and their names."""

    values: Floats
    variances: Optional[Floats]
    covariates: list[Floats]
    factors: list[str]
    levels: list[Levels]
    names: dict[str, list[str]]
    ids: list[str]
    notes: list[str] = field(default_factory=list[str])

    def only(self, kept: NDArray[np.bool_]) -> _Rows:
        """Some of the rows; every level keeps its number."""
        variances = None if self.variances is None else self.variances[kept]
        columns = [np.ascontiguousarray(one[kept]) for one in self.covariates]
        levels = [np.ascontiguousarray(one[kept]) for one in self.levels]
        ids = [one for one, is_kept in zip(self.ids, kept) if is_kept]
        parts = (self.values[kept], variances, columns, self.factors, levels)
        return _Rows(*parts, self.names, ids, self.notes)

    def level(self, factor: str) -> Optional[Levels]:
        """The level of each row of a factor; None where it is none."""
        return self.levels[self.factors.index(factor)] if factor in self.factors else None


class Hierarchy:
    """Quantities of many spectra, with what cells and batches share, and what stands out.

    ``components``, ``fixed``, ``cells``, ``outliers`` are data frames where pandas is installed,
    each with the column ``parameter``.
    """

    def __init__(self, parts: Sequence[_Part], limits: Mapping[str, float]) -> None:
        self._parts = list(parts)
        #: Standard deviations beyond which something stands out: ``cell`` of a normal
        #: distribution (of Student's where cells are few), and ``spectrum``.
        self.limits = dict(limits)
        self.notes = [note for part in parts for note in part.notes]
        self.components = _stacked([part.components for part in parts])
        self.fixed = _stacked([part.fixed for part in parts])
        self.cells = _stacked([part.cells for part in parts])
        self.outliers = _stacked([part.outliers for part in parts])

    def __repr__(self) -> str:
        return f"<Hierarchy of {', '.join(part.name for part in self._parts)}>"

    def __str__(self) -> str:
        texts = [f"{name}:\n{getattr(self, name)}" for name in ("components", "fixed", "outliers")]
        return "\n\n".join([*texts, *self.notes])


def hierarchy(
    table: Any,
    values: Union[str, Sequence[str]],
    *,
    covariates: Sequence[str] = (),
    cell: str = "cell",
    batch: Optional[str] = "batch",
    bench: Optional[str] = "bench",
    log: bool = True,
    sigma: bool = True,
    false_alarms: float = 0.05,
) -> Hierarchy:
    """Fits ``value = constant + covariates + batch + cell within batch + bench + rest`` to columns of
    a table of results, by restricted maximum likelihood, and names what stands out.

    ``values`` are columns such as ``r_ohm``, ``dc_resistance_ohm`` or ``tau1_s``; with ``log`` their
    logarithms are fitted, so that standard deviations are parts of the value. ``covariates`` are
    columns of conditions, such as ``temperature_c`` or ``ocv_v``; ``age_d`` is the time since the
    first spectrum of the cell, in days. A factor with one level alone is left out. With ``sigma``
    the stated uncertainty of each value (``r_sigma_ohm``) is known beforehand and not counted as
    scatter.

    ``false_alarms`` is the probability that anything at all of a table without outliers is named:
    it is shared between cells and spectra, and divided by the number of cells or spectra and of
    ``values`` that are looked at. Spectra that stand out are not in the fit; cells are.

    Rows without a number are left out and counted in ``notes``. Raises EisError where a column is
    missing or the rows do not suffice.
    """
    names = [values] if isinstance(values, str) else list(values)
    if not names:
        raise EisError("values: expected at least one column, met none")
    if not 0 < false_alarms < 1:
        raise EisError(f"false_alarms: expected more than 0 and less than 1, met {false_alarms}")
    table = _as_columns(table)
    factors = _Factors(cell, batch, bench)
    share = 0.5 * false_alarms / len(names)
    parts: list[_Part] = []
    for name in names:
        rows = _rows(table, name, list(covariates), factors, log, sigma)
        parts.append(_part(name, rows, ["constant", *covariates], share))
    limits = {"cell": _limit(share, parts[0].count), "spectrum": _limit(share, parts[0].spectra)}
    return Hierarchy(parts, limits)


@dataclass(frozen=True)
class _Factors:
    cell: str
    batch: Optional[str]
    bench: Optional[str]


@dataclass
class _Part:
    """What was found of one quantity."""

    name: str
    components: dict[str, Any]
    fixed: dict[str, Any]
    cells: dict[str, Any]
    outliers: dict[str, Any]
    notes: list[str]
    count: int
    spectra: int


def _limit(share: float, number: int) -> float:
    """Two-sided limit of a normal distribution where the share is divided by a number."""
    return NormalDist().inv_cdf(1 - 0.5 * share / max(number, 1))


def _as_columns(table: Any) -> Any:
    """Columns by name, of a table in any shape."""
    names = getattr(table, "column_names", None)
    return table if names is None else {name: table[name] for name in names}


def _rows(
    table: Any, name: str, covariates: list[str], of: _Factors, log: bool, sigma: bool
) -> _Rows:
    """The rows of one quantity that have all that is needed."""
    values = _numbers(table, name)
    notes: list[str] = []
    usable = np.isfinite(values) & ((values > 0) | (not log))
    columns = [_covariate(table, one, of.cell) for one in covariates]
    for column in columns:
        usable &= np.isfinite(column)
    levels, names = _levels(table, of, usable, notes)
    variances = _variances(table, name, values, log) if sigma else None
    left_out = int((~usable).sum())
    if left_out:
        notes.append(f"{name}: {left_out} of {len(values)} rows lack a number and are left out")
    if variances is not None:
        unknown = usable & ~np.isfinite(variances)
        if unknown.any():
            notes.append(f"{name}: {int(unknown.sum())} rows state no uncertainty; it counts as 0")
        variances = np.nan_to_num(variances, posinf=0.0)
    ids = _texts(table, "spectrum_id") or [str(k + 1) for k in range(len(values))]
    fitted = np.log(np.where(values > 0, values, 1.0)) if log else values
    whole = _Rows(fitted, variances, columns, list(levels), list(levels.values()), names, ids, notes)
    _tell_confounded(name, whole, usable)
    rows = whole.only(usable)
    _refuse_dependent(rows, covariates)
    return rows


def _refuse_dependent(rows: _Rows, covariates: list[str]) -> None:
    """Refuses covariates of which one follows from the others, or does not differ at all."""
    centred = [column - column.mean() for column in rows.covariates if len(column)]
    scales = [float(np.abs(column).max()) or 1.0 for column in centred]
    scaled = [column / scale for column, scale in zip(centred, scales)]
    if scaled and int(np.linalg.matrix_rank(np.column_stack(scaled), tol=1e-9)) < len(scaled):
        met = ", ".join(covariates)
        raise EisError(f"covariates: expected columns that do not depend on each other, met {met}")


def _numbers(table: Any, name: str) -> Floats:
    found = columns_of(table, [name])
    if name not in found:
        raise EisError(f"table: expected a column {name}, met none")
    return numbers(name, found[name])


def _texts(table: Any, name: str) -> Optional[list[str]]:
    """A column of texts, empty where missing; None if the table has no such column."""
    found = columns_of(table, [name])
    if name not in found:
        return None
    column: Any = found[name]
    values: Any = column.to_pylist() if hasattr(column, "to_pylist") else list(column)
    return ["" if one is None or one != one else str(one) for one in cast("list[Any]", values)]


def _covariate(table: Any, name: str, cell: str) -> Floats:
    if name != "age_d":
        return _numbers(table, name)
    began = _numbers(table, "started_unix_s")
    first: dict[str, float] = {}
    cells = _texts(table, cell) or [""] * len(began)
    for one, time in zip(cells, began.tolist()):
        first[one] = min(first.get(one, np.inf), time)
    return (began - np.array([first[one] for one in cells])) / _DAY_S


def _sigma_name(name: str) -> str:
    """The column of the standard uncertainty of another: ``r_sigma_ohm`` of ``r_ohm``."""
    stem, _, unit = name.rpartition("_")
    return f"{stem}_sigma_{unit}" if stem else f"{name}_sigma"


def _variances(table: Any, name: str, values: Floats, log: bool) -> Optional[Floats]:
    """Known variances, where the table states uncertainties."""
    sigma_name = _sigma_name(name)
    found = columns_of(table, [sigma_name])
    if sigma_name not in found:
        return None
    sigma = numbers(sigma_name, found[sigma_name])
    return (sigma / values) ** 2 if log else sigma**2


def _levels(
    table: Any, of: _Factors, usable: NDArray[np.bool_], notes: list[str]
) -> tuple[dict[str, Levels], dict[str, list[str]]]:
    """The factors that have several levels: the level of each row, and the names of the levels.
    Rows without a name of a factor are taken out of ``usable``."""
    wanted = {"batch": of.batch, "cell": of.cell, "bench": of.bench}
    columns = {name: _texts(table, column) for name, column in wanted.items() if column is not None}
    known = {name: texts for name, texts in columns.items() if texts is not None and any(texts)}
    if "cell" not in known:
        raise EisError(f"table: expected a column {of.cell} with the names of cells, met none")
    for texts in known.values():
        usable &= np.array([bool(text) for text in texts])
    sites = _texts(table, "site")
    if "bench" in known and sites is not None and any(sites):
        # Benches of one name at two sites are two benches.
        known["bench"] = [f"{s}/{b}" if b else b for s, b in zip(sites, known["bench"])]
    if "batch" in known:
        # Cells of one name in two batches are two cells.
        known["cell"] = [f"{b}/{c}" for b, c in zip(known["batch"], known["cell"])]
    levels: dict[str, Levels] = {}
    names: dict[str, list[str]] = {}
    for name, texts in known.items():
        here, index = np.unique(names_of(np.array(texts)[usable]), return_inverse=True)
        if len(here) < 2:
            notes.append(f"{name}: one level alone, which the constant holds")
            continue
        column = np.zeros(len(usable), dtype=np.int64)
        column[usable] = index
        levels[name], names[name] = column, [str(one) for one in here]
    return levels, names


def _tell_confounded(name: str, rows: _Rows, usable: NDArray[np.bool_]) -> None:
    """Notes factors that the table cannot separate: every level of one is one of the other."""
    for k, one in enumerate(rows.factors):
        for j in range(k):
            left, right = rows.levels[k][usable], rows.levels[j][usable]
            pairs = len(set(zip(left.tolist(), right.tolist())))
            if pairs == len(set(left.tolist())) == len(set(right.tolist())):
                finding = f"{name}: {rows.factors[j]} and {one} go together in every row"
                rows.notes.append(f"{finding}: the table cannot separate their shares")


def _part(name: str, rows: _Rows, fixed: list[str], share: float) -> _Part:
    spectra = len(rows.values)
    limit = _limit(share, spectra)
    kept, scores = _clean(rows, limit)
    clean = rows.only(kept)
    found = _eisbench.mixed(clean, True)
    count = len(rows.names.get("cell", []))
    cells = _cells(name, clean, found)
    alone = _odd_cells(clean, cells, share)
    outliers = _Outliers(name)
    for level, (score, of) in alone.items():
        outliers.add("cell", rows.names["cell"][level], rows.names["cell"][level], score, of)
    of_cell = rows.level("cell")
    for row in np.flatnonzero(~kept).tolist():
        cell = "" if of_cell is None else rows.names["cell"][int(of_cell[row])]
        outliers.add("spectrum", rows.ids[row], cell, float(scores[row]), limit)
    tables = (_components(name, found), _fixed(name, fixed, found), cells, outliers.columns())
    return _Part(name, *tables, rows.notes, count, spectra)


def _clean(rows: _Rows, limit: float) -> tuple[NDArray[np.bool_], Floats]:
    """Which rows stay in the fit, and how far each is from what the fit expects, in standard
    deviations. What stands out is taken out and judged again by the fit without it."""
    kept = np.ones(len(rows.values), dtype=np.bool_)
    scores = np.zeros(len(rows.values))
    for _ in range(_ROUNDS):
        scores = _scores(rows, kept, _eisbench.mixed(rows.only(kept), False))
        now = np.abs(scores) <= limit
        if (now == kept).all():
            break
        kept = now
    return kept, scores


def _scores(rows: _Rows, kept: NDArray[np.bool_], found: Mapping[str, Any]) -> Floats:
    """Each row less its prediction, in standard deviations. A row of the fit has drawn its cell
    towards itself by a known part; one that was taken out has not."""
    fixed = np.array([value for value, _ in found["fixed"]])
    expected = np.full(len(rows.values), fixed[0])
    for coefficient, column in zip(fixed[1:], rows.covariates):
        expected += coefficient * column
    sds = {name: sd for name, sd, _, _, _ in found["components"]}
    own = np.full(len(rows.values), sds["residual"] ** 2)
    own += 0.0 if rows.variances is None else rows.variances
    drawn = np.zeros(len(rows.values))
    for name, levels, (value, _, _) in zip(rows.factors, rows.levels, found["levels"]):
        padded = np.zeros(len(rows.names[name]))
        padded[: len(value)] = value
        expected += padded[levels]
        if name == "cell":
            weights = np.bincount(levels, np.where(kept, 1 / own, 0.0), len(rows.names[name]))
            variance = sds[name] ** 2
            drawn = (variance / (1 + variance * weights))[levels]
    spread = np.where(kept, np.maximum(own - drawn, 1e-3 * own), own + drawn)
    return (rows.values - expected) / np.sqrt(spread)


def _components(name: str, found: Mapping[str, Any]) -> dict[str, Any]:
    components: list[Any] = found["components"]
    columns = list(zip(*components))
    return {
        "parameter": [name] * len(components),
        "component": [str(one) for one in columns[0]],
        "sd": np.array(columns[1]),
        "low": np.array(columns[2]),
        "high": np.array(columns[3]),
        "levels": np.array(columns[4], dtype=np.int64),
    }


def _fixed(name: str, fixed: list[str], found: Mapping[str, Any]) -> dict[str, Any]:
    terms: list[Any] = found["fixed"]
    return {
        "parameter": [name] * len(terms),
        "term": list(fixed),
        "value": np.array([value for value, _ in terms]),
        "sigma": np.array([sigma for _, sigma in terms]),
    }


def _cells(name: str, rows: _Rows, found: Mapping[str, Any]) -> dict[str, Any]:
    """The estimate of each cell, drawn towards its batch by what is known of it."""
    cells, levels = rows.names.get("cell", []), rows.level("cell")
    if levels is None:
        none = np.zeros(0)
        numbers_of_it = {"spectra": none.astype(np.int64), "effect": none, "sigma": none, "z": none}
        return {"parameter": list[str](), "cell": list[str](), **numbers_of_it}
    value, sigma, z = found["levels"][rows.factors.index("cell")]
    # A cell whose spectra all stand out has no level: nothing is known of it.
    pad = len(cells) - len(value)
    return {
        "parameter": [name] * len(cells),
        "cell": list(cells),
        "spectra": np.bincount(levels, minlength=len(cells)),
        "effect": np.pad(value, (0, pad), constant_values=np.nan),
        "sigma": np.pad(sigma, (0, pad), constant_values=np.nan),
        "z": np.pad(z, (0, pad), constant_values=np.nan),
    }


def _odd_cells(
    rows: _Rows, cells: Mapping[str, Any], share: float
) -> dict[int, tuple[float, float]]:
    """Cells that stand out, each with its distance and the limit, in standard deviations.

    The farthest cell is given a value of its own, and the rest is fitted without it; so on with the
    next (generalised extreme Studentised deviates; Rosner, 1983). The last one beyond its limit and
    all before it stand out: two that hide each other are found.
    """
    levels, count = rows.level("cell"), len(rows.names.get("cell", []))
    if levels is None or count < 4:
        return {}
    batches = len(rows.names.get("batch", [""]))
    beyond = 0
    met: list[tuple[int, float, float]] = []
    left: _Rows = rows
    z = np.nan_to_num(np.asarray(cells["z"]))
    for step in range(min(max(1, int(_MOST_CELLS * count)), _MOST_STEPS)):
        suspect = int(np.argmax(np.abs(z)))
        freedom = count - step - batches - len(rows.covariates) - 1
        if z[suspect] == 0.0 or freedom < 1:
            break
        mark = (rows.level("cell") == suspect).astype(np.float64)
        left = _with(left, mark)
        try:
            found = _eisbench.mixed(left, False)
        except EisError:
            break
        value, sigma = found["fixed"][-1]
        limit = _eisbench.t_factor(1 - share / (count - step), freedom)
        met.append((suspect, value / sigma, limit))
        beyond = len(met) if abs(value / sigma) > limit else beyond
        cell_z = found["levels"][rows.factors.index("cell")][2]
        z = np.pad(np.nan_to_num(cell_z), (0, count - len(cell_z)))
        for known, _, _ in met:
            z[known] = 0.0
    return {level: (score, limit) for level, score, limit in met[:beyond]}


def _with(rows: _Rows, column: Floats) -> _Rows:
    """The rows with one more covariate."""
    columns = [*rows.covariates, column]
    parts = (rows.values, rows.variances, columns, rows.factors, rows.levels)
    return _Rows(*parts, rows.names, rows.ids, rows.notes)


class _Outliers:
    """Rows of what stands out."""

    def __init__(self, parameter: str) -> None:
        self._parameter = parameter
        self._rows: list[tuple[str, str, str, float, float]] = []

    def add(self, kind: str, name: str, cell: str, sigmas: float, limit: float) -> None:
        self._rows.append((kind, name, cell, sigmas, limit))

    def columns(self) -> dict[str, Any]:
        rows = sorted(self._rows, key=lambda row: (row[0], -abs(row[3]), row[1]))
        return {
            "parameter": [self._parameter] * len(rows),
            "kind": [row[0] for row in rows],
            "name": [row[1] for row in rows],
            "cell": [row[2] for row in rows],
            "sigmas": np.array([row[3] for row in rows], dtype=np.float64),
            "limit": np.array([row[4] for row in rows], dtype=np.float64),
        }


def _stacked(parts: list[dict[str, Any]]) -> Any:
    """Columns of several parts, one below the other."""
    columns: dict[str, Any] = {}
    for name, first in parts[0].items():
        of = [part[name] for part in parts]
        texts = isinstance(first, list)
        columns[name] = [text for part in of for text in part] if texts else np.concatenate(of)
    return frame(columns)
