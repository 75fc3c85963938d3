"""Results: they print as tables, show as HTML in notebooks, and plot themselves."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Optional, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._eisbench import Model as _Model
from ._eisbench import Spectrum, circuit_impedance

T = TypeVar("T")


def significant(value: float, digits: int = 5) -> str:
    """A number with ``digits`` significant digits, without an exponent where that is readable."""
    if value == 0.0 or not np.isfinite(value):
        return str(value)
    exponent = int(np.floor(np.log10(abs(value))))
    if -4 <= exponent < 7:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}"
    return f"{value:.{digits - 1}e}"


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns of text, set flush."""
    widths = [max(len(row[k]) for row in [header, *rows]) for k in range(len(header))]
    lines = [header, ["─" * width for width in widths], *rows]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip()
        for line in lines
    )


def html_table(caption: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The same as HTML."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    caption = f"<caption>{html.escape(caption)}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter: its value, its standard deviation (None where the data do not fix it)."""

    name: str
    value: float
    sigma: Optional[float]
    unit: str

    def row(self) -> list[str]:
        sigma = "not fixed" if self.sigma is None else f"± {significant(self.sigma, 2)}"
        return [self.name, significant(self.value), sigma, self.unit]


@dataclass(frozen=True)
class Branch:
    """An RC branch."""

    r_ohm: float
    c_f: float

    @property
    def tau_s(self) -> float:
        """Time constant, s."""
        return self.r_ohm * self.c_f


class Fit:
    """What all fits have in common. ``raw`` holds everything, as the program prints it."""

    def __init__(self, text: str, spectra: Sequence[Spectrum]) -> None:
        self.raw: dict[str, Any] = json.loads(text)
        self.fitted_spectra: list[Spectrum] = list(spectra)

    @property
    def objective(self) -> float:
        """Value of the objective."""
        return float(self.raw["objective"])

    @property
    def objective_kind(self) -> str:
        """``complex``, ``modulus`` or ``sum-abs``."""
        return str(self.raw["objective_kind"])

    @property
    def rms_ohm(self) -> float:
        """Root mean square of |Z_model − Z_data|, ohm."""
        return float(self.raw["rms_ohm"])

    @property
    def reduced_chi2(self) -> Optional[float]:
        """χ² per degree of freedom; None where the data do not state their uncertainty."""
        value = self.raw["reduced_chi2"]
        return None if value is None else float(value)

    @property
    def points(self) -> int:
        """Points fitted."""
        return int(self.raw["points"])

    @property
    def spectra(self) -> list[str]:
        """Names of the spectra."""
        return [str(name) for name in self.raw["spectra"]]

    @property
    def warnings(self) -> list[str]:
        """Warnings to the user, in sentences."""
        return [str(text) for text in self.raw["warnings"]]

    @property
    def parameters(self) -> list[Parameter]:
        """The fitted parameters."""
        raise NotImplementedError

    def __getitem__(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = ", ".join(parameter.name for parameter in self.parameters)
        raise KeyError(f"expected one of {names}, met {name!r}")

    def impedance(self, freq_hz: ArrayLike) -> NDArray[np.complex128]:
        """Impedance of the fit, ohm."""
        raise NotImplementedError

    def _title(self) -> str:
        raise NotImplementedError

    def _caption(self) -> str:
        count = len(self.spectra)
        what = self.spectra[0] if count == 1 else f"{count} spectra"
        chi2 = "" if self.reduced_chi2 is None else f", reduced χ² {self.reduced_chi2:.3g}"
        rms = significant(1e6 * self.rms_ohm, 4)
        return f"{self._title()}: {what}, {self.points} points, rms {rms} µΩ{chi2}"

    def __str__(self) -> str:
        rows = [parameter.row() for parameter in self.parameters]
        table = text_table(["parameter", "value", "1σ", "unit"], rows)
        notes = "".join(f"\nnote: {text}" for text in self.warnings)
        return f"{self._caption()}\n{table}{notes}"

    def __repr__(self) -> str:
        return f"<{self._caption()}>"

    def _repr_html_(self) -> str:
        rows = [parameter.row() for parameter in self.parameters]
        header = ["parameter", "value", "1σ", "unit"]
        notes = "".join(f"<p>note: {html.escape(text)}</p>" for text in self.warnings)
        return html_table(self._caption(), header, rows) + notes

    def plot(self, axes: Any = None) -> Any:
        """Nyquist plot of the spectra and the fit; gives matplotlib axes."""
        from ._plot import nyquist

        return nyquist(self.fitted_spectra, self, axes)


class ErmFit(Fit):
    """A fit of the extended Randles model: a resistance and RC branches in series."""

    @property
    def rc(self) -> int:
        """Number of branches."""
        return int(self.raw["rc"])

    @property
    def r_ohm(self) -> float:
        """Series resistance, ohm."""
        return float(self.raw["r_ohm"])

    @property
    def branches(self) -> list[Branch]:
        """Branches by rising time constant."""
        return [Branch(float(b["r_ohm"]), float(b["c_f"])) for b in self.raw["branches"]]

    @property
    def dc_resistance_ohm(self) -> float:
        """Resistance at zero frequency, ohm."""
        return float(self.raw["dc_resistance_ohm"])

    @property
    def log_covariance(self) -> Optional[NDArray[np.float64]]:
        """Covariance of ln R, ln R1, ln C1, …; None where the data do not fix all."""
        rows = self.raw["log_covariance"]
        return None if rows is None else np.array(rows, dtype=np.float64)

    @property
    def order(self) -> Optional[dict[str, Any]]:
        """How the order was chosen, where the data chose it."""
        return self.raw["order"]

    @property
    def parameters(self) -> list[Parameter]:
        sigma = self.raw["sigma"]
        found = [Parameter("R", self.r_ohm, sigma["r_ohm"], "Ω")]
        for k, (branch, of) in enumerate(zip(self.branches, sigma["branches"]), start=1):
            found.append(Parameter(f"R{k}", branch.r_ohm, of["r_ohm"], "Ω"))
            found.append(Parameter(f"C{k}", branch.c_f, of["c_f"], "F"))
        return found

    @property
    def ocv_slope_v_per_c(self) -> float:
        """Slope of the open-circuit voltage that was taken out of the spectra, V/C; 0 for none."""
        storage = self.raw["charge_storage"]
        return 0.0 if storage is None else float(storage["v_per_c"])

    def impedance(self, freq_hz: ArrayLike) -> NDArray[np.complex128]:
        """Impedance that is expected to be measured, ohm, at frequencies in Hz: the model and the
        charge that the cell stores. That of the model alone is ``Model.from_fit(fit).impedance``.
        """
        branches = [(branch.r_ohm, branch.c_f) for branch in self.branches]
        frequencies = np.atleast_1d(np.asarray(freq_hz, dtype=np.float64))
        stored_ohm = -1j * self.ocv_slope_v_per_c / (2 * np.pi * frequencies)
        return _Model(self.r_ohm, branches).impedance(frequencies) + stored_ohm

    def _title(self) -> str:
        return f"{self.rc} RC"


class CircuitFit(Fit):
    """A fit of an equivalent circuit."""

    @property
    def circuit(self) -> str:
        """The circuit."""
        return str(self.raw["circuit"])

    @property
    def values(self) -> list[float]:
        """Values of the parameters, in the order of the circuit."""
        return [float(value) for value in self.raw["values"]]

    @property
    def parameters(self) -> list[Parameter]:
        raw = self.raw
        columns = zip(raw["names"], raw["values"], raw["sigmas"], raw["units"])
        return [Parameter(name, value, sigma, unit) for name, value, sigma, unit in columns]

    @property
    def states(self) -> dict[str, str]:
        """Of each parameter: free, constant, or at which bound."""
        return dict(zip(self.raw["names"], self.raw["states"]))

    def impedance(self, freq_hz: ArrayLike) -> NDArray[np.complex128]:
        """Impedance of the circuit, ohm, at frequencies in Hz."""
        frequencies = np.atleast_1d(np.asarray(freq_hz, dtype=np.float64))
        return circuit_impedance(self.circuit, self.values, frequencies)

    def _title(self) -> str:
        return self.circuit


class Fits(list[T], Generic[T]):
    """Several fits: a list that prints as a table, one row for each."""

    def to_rows(self) -> list[dict[str, Any]]:
        """One dictionary for each fit: spectra, figures of merit, parameters and their sigmas."""
        rows: list[dict[str, Any]] = []
        for fit in self:
            assert isinstance(fit, Fit)
            row: dict[str, Any] = {
                "spectrum": "+".join(fit.spectra),
                "rms_ohm": fit.rms_ohm,
                "reduced_chi2": fit.reduced_chi2,
                "points": fit.points,
            }
            for parameter in fit.parameters:
                row[parameter.name] = parameter.value
                row[f"sigma_{parameter.name}"] = parameter.sigma
            row["warnings"] = "; ".join(fit.warnings)
            rows.append(row)
        return rows

    def to_pandas(self) -> Any:
        """A pandas data frame of :meth:`to_rows`."""
        import pandas

        return pandas.DataFrame(self.to_rows())

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        rows = self.to_rows()
        every = {name: None for row in rows for name in row}
        names = [name for name in every if name not in ("points", "warnings")]

        def cell(value: Any) -> str:
            if value is None:
                return "–"
            return significant(value, 4) if isinstance(value, float) else str(value)

        return names, [[cell(row.get(name)) for name in names] for row in rows]

    def __str__(self) -> str:
        names, rows = self._cells()
        return text_table(names, rows) if rows else "no fits"

    def _repr_html_(self) -> str:
        names, rows = self._cells()
        return html_table(f"{len(self)} fits", names, rows)


class Spectra(list[Spectrum]):
    """Several spectra: a list that prints as a table. ``notes`` state how their files were read."""

    def __init__(self, spectra: Sequence[Spectrum] = (), notes: Sequence[str] = ()) -> None:
        super().__init__(spectra)
        self.notes: list[str] = list(notes)

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        header = ["spectrum", "points", "from / Hz", "to / Hz", "fixture", "bias / A"]
        rows = [
            [
                spectrum.name,
                str(len(spectrum)),
                significant(float(spectrum.freq_hz[0]), 4),
                significant(float(spectrum.freq_hz[-1]), 4),
                spectrum.fixture or "–",
                "–" if spectrum.bias_a is None else significant(spectrum.bias_a, 3),
            ]
            for spectrum in self
        ]
        return header, rows

    def __str__(self) -> str:
        header, rows = self._cells()
        return text_table(header, rows) if rows else "no spectra"

    def _repr_html_(self) -> str:
        header, rows = self._cells()
        return html_table(f"{len(self)} spectra", header, rows)

    def plot(self, axes: Any = None) -> Any:
        """Nyquist plot; gives matplotlib axes."""
        from ._plot import nyquist

        return nyquist(self, None, axes)


class Assessment:
    """What is to be thought of the spectra of one cell: Kramers–Kronig, Z-HIT, repeats."""

    def __init__(self, text: str) -> None:
        self.raw: dict[str, Any] = json.loads(text)

    @property
    def spectra(self) -> list[dict[str, Any]]:
        """Of each spectrum ``name``, ``verdict``, ``kramers_kronig``, ``z_hit``."""
        return list(self.raw["spectra"])

    @property
    def grades(self) -> dict[str, str]:
        """Grade of each spectrum: ``good``, ``doubtful``, ``cannot-be-judged``, ``bad``."""
        return {entry["name"]: entry["verdict"]["grade"] for entry in self.spectra}

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        rows = [
            [
                entry["name"],
                entry["verdict"]["grade"],
                f"{entry['kramers_kronig']['p']:.2g}",
                entry["verdict"]["text"],
            ]
            for entry in self.spectra
        ]
        return ["spectrum", "grade", "p", "verdict"], rows

    def __str__(self) -> str:
        header, rows = self._cells()
        return text_table(header, rows)

    def _repr_html_(self) -> str:
        header, rows = self._cells()
        return html_table("Validity", header, rows)


class Drt:
    """Distribution of relaxation times of one spectrum."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.raw: dict[str, Any] = json.loads(text)

    @property
    def tau_s(self) -> NDArray[np.float64]:
        """Time constants, s, rising; shape (n,)."""
        return np.array(self.raw["tau_s"], dtype=np.float64)

    @property
    def gamma_ohm(self) -> NDArray[np.float64]:
        """Resistance per unit of ln τ, ohm; shape (n,)."""
        return np.array(self.raw["gamma_ohm"], dtype=np.float64)

    @property
    def sigma_ohm(self) -> NDArray[np.float64]:
        """Standard deviation of ``gamma_ohm``, ohm; shape (n,)."""
        return np.array(self.raw["sigma_ohm"], dtype=np.float64)

    @property
    def peaks(self) -> list[dict[str, Any]]:
        """Peaks by rising time constant."""
        return list(self.raw["peaks"])

    @property
    def polarisation_ohm(self) -> float:
        """Area under the distribution, ohm."""
        return float(self.raw["polarisation_ohm"]["value"])

    def __str__(self) -> str:
        rows = [
            [significant(peak["tau_s"], 4), significant(1e3 * peak["r_ohm"], 4)]
            for peak in self.peaks
        ]
        total = significant(1e3 * self.polarisation_ohm, 4)
        table = text_table(["peak / s", "R / mΩ"], rows)
        return f"{self.name}: polarisation {total} mΩ\n{table}"

    def plot(self, axes: Any = None) -> Any:
        """γ over τ with its standard deviation; gives matplotlib axes."""
        from ._plot import distribution

        return distribution(self, axes)
