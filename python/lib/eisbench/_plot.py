"""Pictures by matplotlib, which is not needed for anything else."""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportMissingImports=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Optional

import numpy as np

if TYPE_CHECKING:
    from ._eisbench import Spectrum
    from ._joint import Pulse
    from ._model import Simulation
    from ._results import Drt, Fit

#: Colours of Okabe and Ito, which the colour-blind tell apart.
MEASURED, FITTED, ALONE = "#0072B2", "#D55E00", "#009E73"


def _axes(axes: Any) -> Any:
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.subplots()[1]


def nyquist(spectra: Sequence[Spectrum], fit: Optional[Fit], axes: Any) -> Any:
    axes = _axes(axes)
    for k, spectrum in enumerate(spectra):
        z_mohm = 1e3 * spectrum.z_ohm
        label = "measured" if k == 0 else None
        axes.plot(z_mohm.real, -z_mohm.imag, "o", color=MEASURED, ms=4, mfc="none", label=label)
    if fit is not None:
        ends = [(s.freq_hz[0], s.freq_hz[-1]) for s in spectra]
        low, high = min(low for low, _ in ends), max(high for _, high in ends)
        z_mohm = 1e3 * fit.impedance(np.geomspace(float(low), float(high), 400))
        axes.plot(z_mohm.real, -z_mohm.imag, "-", color=FITTED, label="fitted")
        axes.legend()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("Re Z / mΩ")
    axes.set_ylabel("−Im Z / mΩ")
    axes.grid(alpha=0.3)
    return axes


def distribution(drt: Drt, axes: Any) -> Any:
    axes = _axes(axes)
    low, high = (1e3 * (drt.gamma_ohm + sign * drt.sigma_ohm) for sign in (-1, 1))
    axes.fill_between(drt.tau_s, np.maximum(low, 0.0), high, color=MEASURED, alpha=0.2, lw=0)
    axes.plot(drt.tau_s, 1e3 * drt.gamma_ohm, color=MEASURED)
    axes.set_xscale("log")
    axes.set_xlabel("τ / s")
    axes.set_ylabel("γ / mΩ")
    axes.grid(alpha=0.3)
    return axes


def pulses(all_of_them: Sequence[Pulse], axes: Any) -> Any:
    axes = _axes(axes)
    for k, pulse in enumerate(one for one in all_of_them if one.role != "outside"):
        first = k == 0
        mv = [1e3 * v for v in (pulse.measured_v, pulse.by_spectra_v, pulse.by_joint_v)]
        axes.plot(pulse.time_s, mv[0], ".", color=MEASURED, ms=3, label="measured" if first else None)
        label = "spectra alone" if first else None
        axes.plot(pulse.time_s, mv[1], ":", color=ALONE, label=label)
        axes.plot(pulse.time_s, mv[2], "-", color=FITTED, label="joint" if first else None)
    axes.set_xlabel("time since the edge / s")
    axes.set_ylabel("voltage less that before / mV")
    axes.legend()
    axes.grid(alpha=0.3)
    return axes


def run(simulation: Simulation, axes: Any) -> Any:
    axes = _axes(axes)
    axes.plot(simulation.time_s, simulation.ccv_v, color=MEASURED)
    axes.set_xlabel("time / s")
    axes.set_ylabel("voltage / V", color=MEASURED)
    other = axes.twinx()
    other.plot(simulation.time_s, simulation.current_a, color=FITTED, lw=1)
    other.set_ylabel("current / A (discharge +)", color=FITTED)
    axes.grid(alpha=0.3)
    return axes
