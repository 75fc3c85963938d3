"""Functions of the package."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Optional, TypeVar, Union, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _eisbench
from ._eisbench import EisError, Spectrum
from ._results import Assessment, CircuitFit, Drt, ErmFit, Fits, Spectra
from ._table import Table, columns_of, names_of, numbers

F = TypeVar("F")
Path = Union[str, "os.PathLike[str]"]


def read_spectra(path: Union[Path, Iterable[Path], Any]) -> Spectra:
    """Reads the spectra of a file, of several files, or of a data frame in long form.

    Formats: those of ``docs/formats.md``, detected from the file. A data frame has the columns of
    :func:`spectra_of_table`.

    Raises FileError, which names file, line and field.
    """
    if hasattr(path, "columns") or hasattr(path, "__arrow_c_stream__"):
        return spectra_of_table(path)
    is_one = isinstance(path, (str, os.PathLike))
    all_of_them = Spectra()
    for file in [cast(Path, path)] if is_one else cast("Iterable[Path]", path):
        found, notes = _eisbench.read_spectra(file)
        all_of_them.extend(found)
        all_of_them.notes.extend(notes)
    return all_of_them


def spectra_of_table(table: Any) -> Spectra:
    """Spectra of a table in long form: a data frame or a mapping of columns.

    Columns: ``freq_hz``, ``z_re_ohm``, ``z_im_ohm``; ``spectrum_id`` where there are several
    spectra; ``sigma_ohm``, standard deviation of either part, or ``sigma_re_ohm``,
    ``sigma_im_ohm`` and perhaps ``cov_re_im_ohm2``, where they are known; ``amplitude_a``. Spectra
    stand in the order of their first row.

    Raises EisError for a missing column and for what cannot be a measurement.
    """
    found = Spectra()
    for name, spectrum, reason in grouped(table):
        if spectrum is None:
            raise EisError(f"spectrum {name!r}: {reason}")
        found.append(spectrum)
    return found


_NEEDED = ("freq_hz", "z_re_ohm", "z_im_ohm")
_OPTIONAL = ("sigma_ohm", "sigma_re_ohm", "sigma_im_ohm", "cov_re_im_ohm2", "amplitude_a")
POINT_COLUMNS = (*_NEEDED, *_OPTIONAL)


class _Points:
    """Columns of points, as the half in Rust takes them."""

    def __init__(self, columns: Mapping[str, NDArray[np.float64]], order: NDArray[np.int64]) -> None:
        def column(name: str) -> Optional[NDArray[np.float64]]:
            given = columns.get(name)
            return None if given is None else np.ascontiguousarray(given[order])

        self.freq_hz = column("freq_hz")
        self.z_ohm = (columns["z_re_ohm"] + 1j * columns["z_im_ohm"])[order]
        self.sigma_ohm = column("sigma_ohm")
        self.sigma_re_ohm = column("sigma_re_ohm")
        self.sigma_im_ohm = column("sigma_im_ohm")
        self.cov_re_im_ohm2 = column("cov_re_im_ohm2")
        self.amplitude_a = column("amplitude_a")


def grouped(table: Any) -> list[tuple[str, Optional[Spectrum], Optional[str]]]:
    """Name and spectrum of each, or the reason why it is none, in the order of their first row."""
    columns, given = points_of(table), columns_of(table, ["spectrum_id"])
    named, rows = "spectrum_id" in given, len(columns["freq_hz"])
    ids = names_of(given["spectrum_id"]) if named else np.zeros(rows, dtype=np.int64)
    if {len(column) for column in (ids, *columns.values())} != {rows}:
        raise EisError("table: expected columns of one length, met several")
    if rows == 0:
        return []
    _, first, group = np.unique(ids, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))[group]
    names = [str(name) for name in ids[np.sort(first)]] if named else ["table"]
    return spectra_of_groups(columns, names, rank)


def points_of(table: Any) -> dict[str, NDArray[np.float64]]:
    """The columns of points that a table has."""
    given = columns_of(table, ("spectrum_id", *POINT_COLUMNS))
    for needed in _NEEDED:
        if needed not in given:
            names = ", ".join(given) or "none of those that are known"
            raise EisError(f"table: expected a column {needed}, met {names}")
    return {name: numbers(name, given[name]) for name in POINT_COLUMNS if name in given}


def spectra_of_groups(
    columns: Mapping[str, NDArray[np.float64]], names: list[str], rank: NDArray[np.int64]
) -> list[tuple[str, Optional[Spectrum], Optional[str]]]:
    """The same of columns of points, where ``rank`` is the place of each row's name in ``names``."""
    order = np.argsort(rank, kind="stable")
    ends = np.cumsum(np.bincount(rank, minlength=len(names))).tolist()
    made = _eisbench.spectra_of_columns(names, ends, _Points(columns, order))
    return [(name, spectrum, reason) for name, (spectrum, reason) in zip(names, made)]


def _texts(results: list[tuple[Optional[str], Optional[str]]]) -> list[str]:
    """The results; the first reason why there is none is raised."""
    for _, reason in results:
        if reason is not None:
            raise EisError(reason)
    return [text for text, _ in results if text is not None]


def _fits(
    kind: Callable[[str, list[Spectrum]], F],
    results: list[tuple[Optional[str], Optional[str]]],
    cells: list[Spectrum],
    pool: bool,
) -> Fits[F]:
    groups = [cells] if pool else [[cell] for cell in cells]
    return Fits([kind(text, group) for text, group in zip(_texts(results), groups)])


def _whole(name: str, value: Union[int, np.integer[Any]]) -> int:
    if value < 0:
        raise EisError(f"{name}: expected 0 or more, met {value}")
    return int(value)


def _cells(spectra: Union[Spectrum, Iterable[Spectrum]]) -> tuple[list[Spectrum], bool]:
    """Spectra of cells without direct current, without points that their gate has refused, as the
    program fits them; and whether one spectrum alone was given."""
    if isinstance(spectra, Spectrum):
        return [spectra.without_flagged()], True
    given = list(spectra)
    cells = [spectrum.without_flagged() for spectrum in given if spectrum.is_unbiased_cell]
    others = [spectrum.name for spectrum in given if not spectrum.is_unbiased_cell]
    if others:
        names = ", ".join(others)
        text = f"not fitted, because they are controls or carry a direct current: {names}"
        warnings.warn(text, stacklevel=3)
    if not cells:
        raise EisError("expected at least one spectrum of a cell without direct current, met none")
    return cells, False


@overload
def fit_erm(
    spectra: Spectrum,
    rc: Union[int, str] = ...,
    *,
    pool: bool = ...,
    objective: str = ...,
    ocv_slope: Union[str, float, None] = ...,
    seed: int = ...,
    starts: int = ...,
) -> ErmFit: ...
@overload
def fit_erm(
    spectra: Iterable[Spectrum],
    rc: Union[int, str] = ...,
    *,
    pool: bool = ...,
    objective: str = ...,
    ocv_slope: Union[str, float, None] = ...,
    seed: int = ...,
    starts: int = ...,
) -> Union[ErmFit, Fits[ErmFit]]: ...
def fit_erm(
    spectra: Union[Spectrum, Iterable[Spectrum]],
    rc: Union[int, str] = "auto",
    *,
    pool: bool = False,
    objective: str = "complex",
    ocv_slope: Union[str, float, None] = None,
    seed: int = 0,
    starts: int = 0,
) -> Union[ErmFit, Fits[ErmFit]]:
    """Fits the extended Randles model: a resistance and ``rc`` RC branches in series.

    ``rc`` is a number of branches, or ``"auto"``: the data choose. With ``pool`` one model is
    fitted to all spectra together, else one to each. ``objective`` is ``complex`` (least squares,
    weighted by the covariances where every point has one), ``modulus`` or ``sum-abs`` (the
    thesis'). ``ocv_slope`` controls the impedance of the charge that the cell stores, −j·(dU/dQ)/ω:
    ``fit`` estimates the slope with a weak prior and removes it, ``none`` leaves it in, a number is
    the slope in V/C; None is ``fit`` for ``complex``, otherwise ``none``. No start values are
    needed: the search is global, and the same ``seed`` gives the same fit.

    A single spectrum, or ``pool``, gives an :class:`ErmFit`; several give :class:`Fits`. Of
    several, controls and spectra under direct current are left out with a warning, so that there
    may be fewer fits than spectra; each fit names its ``spectra``.

    Raises EisError for data that cannot be fitted.
    """
    if rc != "auto" and not isinstance(rc, (int, np.integer)):
        raise EisError(f"rc: expected a number of branches or 'auto', met {rc!r}")
    cells, single = _cells(spectra)
    order = None if isinstance(rc, str) else _whole("rc", rc)
    slope = ocv_slope if ocv_slope is None or isinstance(ocv_slope, str) else repr(float(ocv_slope))
    whole = (_whole("seed", seed), _whole("starts", starts))
    results = _eisbench.fit_erm(cells, order, objective, slope, *whole, pool)
    fits = _fits(ErmFit, results, cells, pool)
    return fits[0] if single or pool else fits


@overload
def fit_circuit(
    spectra: Spectrum,
    circuit: str,
    *,
    pool: bool = ...,
    objective: str = ...,
    weight: Optional[str] = ...,
    guess: Optional[Mapping[str, float]] = ...,
    constants: Optional[Mapping[str, float]] = ...,
    starts: Optional[int] = ...,
    search: str = ...,
    seed: int = ...,
) -> CircuitFit: ...
@overload
def fit_circuit(
    spectra: Iterable[Spectrum],
    circuit: str,
    *,
    pool: bool = ...,
    objective: str = ...,
    weight: Optional[str] = ...,
    guess: Optional[Mapping[str, float]] = ...,
    constants: Optional[Mapping[str, float]] = ...,
    starts: Optional[int] = ...,
    search: str = ...,
    seed: int = ...,
) -> Union[CircuitFit, Fits[CircuitFit]]: ...
def fit_circuit(
    spectra: Union[Spectrum, Iterable[Spectrum]],
    circuit: str,
    *,
    pool: bool = False,
    objective: str = "complex",
    weight: Optional[str] = None,
    guess: Optional[Mapping[str, float]] = None,
    constants: Optional[Mapping[str, float]] = None,
    starts: Optional[int] = None,
    search: str = "starts",
    seed: int = 0,
) -> Union[CircuitFit, Fits[CircuitFit]]:
    """Fits an equivalent circuit, written as impedance.py writes it: ``R0-p(R1,CPE1)-Wo1``.

    No start values are needed; ``guess`` gives some, ``constants`` holds some, both by the names
    of :attr:`CircuitFit.parameters`. ``weight`` is ``unit``, ``modulus`` or ``covariance``;
    ``search`` is ``starts`` or ``evolution``.

    Raises EisError for a circuit that cannot be read and for data that cannot be fitted.
    """
    cells, single = _cells(spectra)
    wishes = _CircuitWishes(circuit, objective, weight, guess, constants, starts, search, seed)
    results = _eisbench.fit_circuit(cells, wishes, pool)
    fits = _fits(CircuitFit, results, cells, pool)
    return fits[0] if single or pool else fits


class _CircuitWishes:
    """A circuit and wishes for its fit, as the half in Rust takes them."""

    def __init__(
        self,
        circuit: str,
        objective: str,
        weight: Optional[str],
        guess: Optional[Mapping[str, float]],
        constants: Optional[Mapping[str, float]],
        starts: Optional[int],
        search: str,
        seed: int,
    ) -> None:
        self.circuit = circuit
        self.objective = objective
        self.weight = weight
        self.guess = list((guess or {}).items())
        self.constants = list((constants or {}).items())
        self.starts = None if starts is None else _whole("starts", starts)
        self.search = search
        self.seed = _whole("seed", seed)


def circuit_impedance(
    circuit: str, values: Sequence[float], freq_hz: ArrayLike
) -> NDArray[np.complex128]:
    """Impedance of a circuit, ohm, with these values in the order of its parameters.

    Raises EisError for a circuit that cannot be read or another number of values.
    """
    frequencies = np.atleast_1d(np.asarray(freq_hz, dtype=np.float64))
    return _eisbench.circuit_impedance(circuit, list(values), frequencies)


def assess(spectra: Union[Spectrum, Iterable[Spectrum]]) -> Assessment:
    """Judges the spectra of one cell, in order of time: Kramers–Kronig test, Z-HIT, and, where
    there are several, whether they repeat and whether the cell is linear.

    Raises EisError for a spectrum that is too short.
    """
    given = [spectra] if isinstance(spectra, Spectrum) else list(spectra)
    return Assessment(_eisbench.assess(given))


def kk(spectrum: Spectrum) -> dict[str, Any]:
    """The linear Kramers–Kronig test of one spectrum (Schönleber, Klotz and Ivers-Tiffée, 2014)."""
    return dict(assess(spectrum).spectra[0]["kramers_kronig"])


def zhit(spectrum: Spectrum) -> dict[str, Any]:
    """The modulus from the phase by the Z-HIT relation, against the measured one."""
    return dict(assess(spectrum).spectra[0]["z_hit"])


@overload
def drt(spectra: Spectrum) -> Drt: ...
@overload
def drt(spectra: Iterable[Spectrum]) -> list[Drt]: ...
def drt(spectra: Union[Spectrum, Iterable[Spectrum]]) -> Union[Drt, list[Drt]]:
    """Distribution of relaxation times, without negative parts, with its uncertainty. The noise is
    that of each spectrum by itself; repeats of a cell are not compared.

    Raises EisError for a spectrum that is too short.
    """
    single = isinstance(spectra, Spectrum)
    given = [spectra] if isinstance(spectra, Spectrum) else list(spectra)
    texts = _texts(_eisbench.drt(given))
    found = [Drt(spectrum.name, text) for spectrum, text in zip(given, texts)]
    return found[0] if single else found


class Given:
    """A spectrum of a table, or the reason why it is none."""

    def __init__(self, name: str, spectrum: Optional[Spectrum], error: Optional[str]) -> None:
        self.spectrum_id = name
        self.spectrum = spectrum
        self.error = error


def _rows_of(table: Any) -> list[Given]:
    """The spectra of a table, of a list of spectra, or of files."""
    if isinstance(table, (str, os.PathLike)):
        table = read_spectra(cast(Path, table))
    if isinstance(table, list):
        spectra = cast("list[Spectrum]", table)
        return [Given(spectrum.name, spectrum.without_flagged(), None) for spectrum in spectra]
    return [Given(*one) for one in grouped(table)]


def _table(columns: Mapping[str, tuple[str, Any]]) -> Table:
    def column(kind: str, values: Any) -> Any:
        whole = kind == "count" and not bool(np.isnan(values).any())
        return values.astype(np.int64) if whole else values

    return Table({name: column(kind, values) for name, (kind, values) in columns.items()})


def fit_table(
    table: Any,
    rc: Union[int, str] = 4,
    *,
    circuit: Optional[str] = None,
    objective: str = "complex",
    ocv_slope: Union[str, float, None] = None,
    seed: int = 0,
    starts: Optional[int] = None,
) -> Table:
    """Fits every spectrum of a table in long form, on all cores; gives one row for each spectrum, in
    the order of the table, with the columns of ``eis-bench fit --table`` (``docs/tables.md``).

    ``table`` is a mapping of columns, a data frame, or anything with ``__arrow_c_stream__``, with
    the columns of :func:`spectra_of_table`; a list of spectra; or a file. With ``circuit`` that
    circuit is fitted in the place of the extended Randles model with ``rc`` branches. A spectrum
    that cannot be fitted has the reason in the column ``error`` and no parameters.
    """
    wishes = FitWishes(rc, circuit, objective, ocv_slope, seed, starts)
    return _table(wishes.columns(_rows_of(table), alone=False))


class FitWishes:
    """Wishes for a table of fits."""

    def __init__(
        self,
        rc: Union[int, str] = 4,
        circuit: Optional[str] = None,
        objective: str = "complex",
        ocv_slope: Union[str, float, None] = None,
        seed: int = 0,
        starts: Optional[int] = None,
    ) -> None:
        if rc != "auto" and not isinstance(rc, (int, np.integer)):
            raise EisError(f"rc: expected a number of branches or 'auto', met {rc!r}")
        self.rc = None if isinstance(rc, str) else _whole("rc", rc)
        self.slope = repr(float(ocv_slope)) if isinstance(ocv_slope, (int, float)) else ocv_slope
        self.circuit = circuit
        self.objective = objective
        self.seed = _whole("seed", seed)
        self.starts = starts if starts is None else _whole("starts", starts)

    def columns(self, given: Sequence[Any], alone: bool) -> dict[str, tuple[str, Any]]:
        """Kind and values of each column; with ``alone`` this thread does all the work."""
        if self.circuit is not None:
            wishes = (self.circuit, self.objective, None, None, None, self.starts, "starts", self.seed)
            return _eisbench.circuit_rows(given, _CircuitWishes(*wishes), alone)
        whole = (self.seed, self.starts or 0)
        return _eisbench.erm_rows(given, self.rc, self.objective, self.slope, *whole, alone)


def kk_table(table: Any, *, drt: bool = False) -> Table:
    """Judges every spectrum of a table by itself, on all cores: Kramers–Kronig test and Z-HIT, with
    ``drt`` also relaxation times. ``table`` is as in :func:`fit_table`; the columns are those of
    ``eis-bench kk --table`` (``docs/tables.md``).
    """
    return _table(_eisbench.validity_rows(_rows_of(table), drt, False))
