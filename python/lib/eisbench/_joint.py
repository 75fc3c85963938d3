"""Models from spectra and pulses together."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from . import _eisbench
from ._eisbench import EisError, Spectrum
from ._model import Model
from ._ocv import Ocv
from ._results import html_table, significant, text_table
from ._series import Fields, record_of


@dataclass(frozen=True)
class Pulse:
    """A pulse under both models. ``role`` is ``fitted``, ``held-out`` or ``outside`` (of the range
    of open-circuit voltages). Arrays are of one length: time since the edge, s, and voltages less
    that before the edge, V."""

    role: str
    time_s: NDArray[np.float64]
    measured_v: NDArray[np.float64]
    by_spectra_v: NDArray[np.float64]
    by_joint_v: NDArray[np.float64]


class Joint:
    """A model that spectra and pulses agree on. ``raw`` is what ``eis-bench joint --json`` prints,
    with the gaps of the pulses, ``fitted_rms_v`` and ``held_out_rms_v``."""

    def __init__(
        self, text: str, model: _eisbench.Model, overlays: list[list[list[float]]]
    ) -> None:
        self.raw: dict[str, Any] = json.loads(text)
        self.model = Model.of(model)
        roles = [str(pulse["role"]) for pulse in self.raw["pulses"]]
        self.pulses = [_pulse(role, rows) for role, rows in zip(roles, overlays)]

    @property
    def rc(self) -> int:
        """RC branches of the joint model."""
        return int(self.raw["rc"])

    @property
    def gain(self) -> float:
        """Resistance of the pulses' cell and instrument over that of the spectra."""
        return float(self._chosen["joint"]["gain"])

    @property
    def held_out_rms_v(self) -> Optional[tuple[float, float]]:
        """Gap of the pulses that were kept from the fit, V rms: by the spectra alone, by the joint
        model; None without such pulses."""
        gaps = self.raw["held_out_rms_v"]
        return None if gaps is None else (float(gaps[0]), float(gaps[1]))

    @property
    def warnings(self) -> list[str]:
        """What is to be known, in sentences."""
        return [str(warning) for warning in self.raw["warnings"]]

    @property
    def _chosen(self) -> dict[str, Any]:
        return next(order for order in self.raw["orders"] if order["rc"] == self.rc)

    def _rows(self) -> list[list[str]]:
        def cell(fit: dict[str, Any]) -> str:
            sigma = fit["sigma"]["dc_resistance_ohm"]
            uncertainty = "?" if sigma is None else significant(1e3 * sigma, 2)
            return f"{significant(1e3 * fit['dc_resistance_ohm'], 4)} ± {uncertainty}"

        return [
            [
                f"{order['rc']}{' ← chosen' if order['rc'] == self.rc else ''}",
                cell(order["spectra"]),
                cell(order["joint"]),
                significant(order["joint"]["reduced_chi2"], 3),
            ]
            for order in self.raw["orders"]
        ]

    _HEADER = ("RC", "spectra alone / mΩ", "joint / mΩ", "χ² / freedom")

    def __str__(self) -> str:
        lines = [text_table(self._HEADER, self._rows())]
        if self.held_out_rms_v is not None:
            before, after = (significant(1e3 * gap, 3) for gap in self.held_out_rms_v)
            lines.append(f"pulses held out: {before} mV by the spectra alone, {after} mV joint")
        return "\n".join(lines + self.warnings)

    def _repr_html_(self) -> str:
        return html_table("DC resistance", self._HEADER, self._rows())

    def plot(self, axes: Any = None) -> Any:
        """Pulses measured and by both models; gives matplotlib axes."""
        from ._plot import pulses

        return pulses(self.pulses, axes)


def _pulse(role: str, rows: list[list[float]]) -> Pulse:
    columns = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    return Pulse(role, columns[0], columns[1], columns[2], columns[3])


def joint(
    spectra: Iterable[Spectrum],
    series: Any,
    ocv: Ocv,
    rc: Union[int, str] = "auto",
    *,
    at_v: float = 3.72,
    within_v: float = 0.2,
    dcir_ohm: float = 0.015,
    seed: int = 0,
) -> Joint:
    """A model from spectra of cells without direct current, all at the same frequencies, and a
    record with pulses of current, as :func:`read_series` gives it.

    ``ocv`` is the open-circuit voltage of the cell. Pulses within ``within_v`` of ``at_v``, V, the
    open-circuit voltage at which the spectra were measured, are used; every second of them is held
    out. ``rc`` is a number of branches, or ``"auto"`` (1 to 6, by AICc). ``dcir_ohm`` brings the
    voltage under steady load to open circuit.

    Raises EisError for spectra that do not belong together and for a record without pulses.
    """
    if isinstance(rc, str) and rc != "auto":
        raise EisError(f"rc: expected a number or 'auto', met {rc!r}")
    cells = [spectrum.without_flagged() for spectrum in spectra if spectrum.is_unbiased_cell]
    wishes = Fields(
        rc=None if isinstance(rc, str) else int(rc),
        at_v=at_v,
        within_v=within_v,
        dcir_ohm=dcir_ohm,
        seed=seed,
    )
    return Joint(*_eisbench.joint(cells, record_of(series), ocv, wishes))
