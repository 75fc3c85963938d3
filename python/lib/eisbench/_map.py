"""Maps: resistances over state of charge, temperature and current."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

from . import _eisbench
from ._eisbench import EisError, Spectrum
from ._model import Model
from ._ocv import Ocv
from ._results import html_table, significant, text_table
from ._series import Fields, record_of
from ._table import columns_of, numbers


@dataclass(frozen=True)
class MapRecord:
    """A record of current and voltage, as :func:`read_series` gives it, and its circumstances.

    ``soc_start`` is the state of charge at the first sample, 0…1; without it the record must begin
    at rest. ``temperature_c`` is the temperature, °C, of a record without a column
    ``temperature_c``. A column ``net_ah``, charge positive, counts the charge across gaps. A
    ``held_out`` record is predicted and not fitted.
    """

    series: Any
    name: str = "record"
    soc_start: Optional[float] = None
    temperature_c: Optional[float] = None
    held_out: bool = False


@dataclass(frozen=True)
class MapSpectrum:
    """A spectrum without a direct current, at a state of charge, 0…1, and a temperature, °C."""

    spectrum: Spectrum
    soc: float
    temperature_c: float
    held_out: bool = False


class CellMap:
    """A fitted map. ``raw`` is what ``eis-bench map --json`` prints, ``model`` simulates it."""

    _HEADER = ("record or spectrum", "fitted", "°C", "error", "unseen", "in band / %")

    def __init__(self, text: str, model: _eisbench.Model) -> None:
        self.raw: dict[str, Any] = json.loads(text)
        self.model = Model.of(model)

    @property
    def soc(self) -> NDArray[np.float64]:
        """States of charge of the knots, 0…1; shape (k,)."""
        return np.array(self.raw["map"]["soc"], dtype=np.float64)

    @property
    def temperature_c(self) -> NDArray[np.float64]:
        """Temperatures of the nodes, °C; shape (n,)."""
        return np.array(self.raw["map"]["temperature_degc"], dtype=np.float64)

    @property
    def tau_s(self) -> NDArray[np.float64]:
        """Time constants of the branches, s, rising; see ``is_extrapolated`` for the first."""
        return np.array([branch["tau_s"] for branch in self.raw["map"]["branches"]])

    @property
    def is_extrapolated(self) -> bool:
        """Whether the first branch continues the spectra beyond their highest frequency."""
        return any(branch.get("extrapolated", False) for branch in self.raw["map"]["branches"])

    @property
    def r_ohm(self) -> NDArray[np.float64]:
        """Series resistance, then that of each branch, ohm; shape (1 + branches, n, k)."""
        return np.array([surface["r_ohm"] for surface in self._surfaces], dtype=np.float64)

    @property
    def sigma_ohm(self) -> NDArray[np.float64]:
        """Standard deviations of ``r_ohm``, ohm, in the same shape."""
        return np.array([surface["sigma_ohm"] for surface in self._surfaces], dtype=np.float64)

    @property
    def dc_resistance_ohm(self) -> NDArray[np.float64]:
        """Series resistance and all branches together, ohm; shape (n, k)."""
        return self.r_ohm.sum(axis=0)

    @property
    def records(self) -> list[dict[str, Any]]:
        """What the map misses of each record: ``name``, ``role``, ``rms_v``, ``covered``, …"""
        return list(self.raw["logs"])

    @property
    def spectra(self) -> list[dict[str, Any]]:
        """What the map misses of each spectrum: ``name``, ``rms_part``, ``left_out``, …"""
        return list(self.raw["spectra"])

    @property
    def notes(self) -> list[str]:
        """Remarks, in sentences."""
        return [str(note) for note in self.raw["notes"]]

    @property
    def _surfaces(self) -> list[dict[str, Any]]:
        found = self.raw["map"]
        return [found["series"], *(branch["resistance"] for branch in found["branches"])]

    def _rows(self) -> list[list[str]]:
        def number(value: Optional[float], factor: float, unit: str) -> str:
            return "–" if value is None else f"{significant(factor * value, 3)}{unit}"

        rows: list[list[str]] = []
        for one in self.records:
            fitted = one["role"] == "train"
            unseen = one["left_out_rms_v"] if fitted else one["rms_v"]
            error = [number(v, 1e3, " mV") for v in (one["rms_v"], unseen)]
            place = ["yes" if fitted else "no", significant(one["temperature_degc"], 3)]
            rows.append([one["name"], *place, *error, number(one["covered"], 100.0, "")])
        for one in self.spectra:
            fitted = one["role"] == "train"
            left_out = one["left_out"]
            unseen = one["rms_part"] if not fitted else left_out and left_out["part"]
            error = [number(part, 100.0, " %") for part in (one["rms_part"], unseen)]
            place = ["yes" if fitted else "no", significant(one["temperature_degc"], 3)]
            rows.append([one["name"], *place, *error, "–"])
        return rows

    def __str__(self) -> str:
        return "\n".join([text_table(self._HEADER, self._rows()), *self.notes])

    def _repr_html_(self) -> str:
        return html_table("Map", self._HEADER, self._rows())

    def plot(self, axes: Any = None) -> Any:
        """Resistances over state of charge, a line per temperature; gives matplotlib axes."""
        from ._plot import surfaces

        return surfaces(self, axes)


def _record(given: Any) -> Fields:
    record = given if isinstance(given, MapRecord) else MapRecord(given)
    found = columns_of(record.series, ("temperature_c", "net_ah"))
    column = {name: numbers(name, values) for name, values in found.items()}
    return Fields(
        name=record.name,
        held_out=record.held_out,
        columns=record_of(record.series),
        temperature_c=column.get("temperature_c"),
        net_ah=column.get("net_ah"),
        at_c=record.temperature_c,
        soc_start=record.soc_start,
    )


def fit_map(
    records: Iterable[Any],
    ocv: Ocv,
    spectra: Iterable[MapSpectrum] = (),
    *,
    name: str = "cell",
    time_constants_s: Optional[Sequence[float]] = None,
    ocv_temperature_c: float = 25.0,
) -> CellMap:
    """Fits resistances over state of charge, temperature and current to records and spectra.

    ``records`` are :class:`MapRecord`, or records with a column ``temperature_c`` that begin at
    rest. ``ocv`` is the open-circuit voltage at ``ocv_temperature_c``, °C. A record that is
    ``held_out`` shows the error on data that the fit has not seen; without one, each record is
    also predicted piece by piece from everything but the piece.

    Raises EisError for records that do not state their charge or temperature, and for data that
    do not determine a map.
    """
    sweeps = list(spectra)
    for sweep in sweeps:
        if not sweep.spectrum.is_unbiased_cell:
            expected = "expected a spectrum of a cell without a direct current"
            raise EisError(f"{sweep.spectrum.name}: {expected}")
    taus_s = None if time_constants_s is None else [float(tau_s) for tau_s in time_constants_s]
    wishes = Fields(
        name=name, time_constants_s=taus_s, ocv_temperature_c=float(ocv_temperature_c)
    )
    rows = [_record(record) for record in records]
    return CellMap(*_eisbench.fit_map(rows, sweeps, ocv, wishes))
