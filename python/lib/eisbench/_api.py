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

F = TypeVar("F")
Path = Union[str, "os.PathLike[str]"]


def read_spectra(path: Union[Path, Iterable[Path], Any]) -> Spectra:
    """Reads the spectra of a file, of several files, or of a data frame in long form.

    Formats: those of ``docs/formats.md``; which one it is, the file tells. A data frame has the
    columns of :func:`spectra_of_table`.

    Raises FileError, which names file, line and field.
    """
    if hasattr(path, "columns"):
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
    spectra; ``sigma_ohm``, standard deviation of either part, where it is known. Spectra stand in
    the order of their first row.

    Raises EisError for a missing column and for what cannot be a measurement.
    """
    names = list(getattr(table, "columns", table))
    for needed in ("freq_hz", "z_re_ohm", "z_im_ohm"):
        if needed not in names:
            told = ", ".join(map(str, names))
            raise EisError(f"table: expected a column {needed}, met {told}")
    freq_hz = _column(table, "freq_hz")
    z_re, z_im = _column(table, "z_re_ohm"), _column(table, "z_im_ohm")
    sigma = _column(table, "sigma_ohm") if "sigma_ohm" in names else None
    ids = np.asarray(table["spectrum_id"]) if "spectrum_id" in names else np.zeros(len(freq_hz))
    lengths = {len(column) for column in (freq_hz, z_re, z_im, ids)}
    if sigma is not None:
        lengths.add(len(sigma))
    if len(lengths) > 1:
        raise EisError("table: expected columns of one length, met several")
    _, first, group = np.unique(ids, return_index=True, return_inverse=True)
    found = Spectra()
    for nth in np.argsort(first):
        rows = np.flatnonzero(group == nth)
        name = str(ids[rows[0]]) if "spectrum_id" in names else "table"
        z_ohm = z_re[rows] + 1j * z_im[rows]
        part = None if sigma is None else sigma[rows]
        found.append(Spectrum(name, freq_hz[rows], z_ohm, part))
    return found


def _column(table: Any, name: str) -> NDArray[np.float64]:
    try:
        return np.asarray(table[name], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise EisError(f"table: expected numbers in column {name}: {error}") from None


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
        told = ", ".join(others)
        text = f"not fitted, for they are controls or carry a direct current: {told}"
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
    thesis'). ``ocv_slope`` is what becomes of the charge that the cell stores, −j·(dU/dQ)/ω:
    ``fit`` finds the slope with a weak prior and takes it out, ``none`` leaves it in, a number is
    the slope in V/C; None is ``fit`` for ``complex``, else ``none``. No start values are needed:
    the search is global, and the same ``seed`` gives the same fit.

    A single spectrum, or ``pool``, gives an :class:`ErmFit`; several give :class:`Fits`. Of
    several, controls and spectra under direct current are left out with a warning, so that there
    may be fewer fits than spectra; each fit tells its ``spectra``.

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
    results = _eisbench.fit_circuit(
        cells,
        circuit,
        objective,
        weight,
        list((guess or {}).items()),
        list((constants or {}).items()),
        None if starts is None else _whole("starts", starts),
        search,
        _whole("seed", seed),
        pool,
    )
    fits = _fits(CircuitFit, results, cells, pool)
    return fits[0] if single or pool else fits


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


def fit_table(
    table: Any, rc: int = 4, *, objective: str = "complex", seed: int = 0, starts: int = 0
) -> Any:
    """Fits every spectrum of a table in long form, on all cores; gives a pandas data frame.

    Columns of the table: those of :func:`spectra_of_table`. The frame has one row for each
    spectrum, in the order of the table. A spectrum that cannot be fitted has a reason in the
    column ``error`` and no parameters.
    """
    import pandas

    spectra = spectra_of_table(table)
    whole = (_whole("seed", seed), _whole("starts", starts))
    results = _eisbench.fit_erm(spectra, _whole("rc", rc), objective, None, *whole, False)
    rows: list[dict[str, Any]] = []
    for spectrum, (text, reason) in zip(spectra, results):
        row: dict[str, Any] = {"spectrum": spectrum.name}
        if text is not None:
            row = Fits([ErmFit(text, [spectrum])]).to_rows()[0]
        rows.append({**row, "error": reason})
    return pandas.DataFrame(rows)
