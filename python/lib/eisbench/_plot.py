"""Pictures by matplotlib, which is not needed for anything else."""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportMissingImports=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Optional

import numpy as np

if TYPE_CHECKING:
    from ._catalog import Ageing
    from ._eisbench import Spectrum
    from ._joint import Pulse
    from ._map import CellMap
    from ._model import Simulation
    from .motion import Motion
    from ._results import Drt, Fit

#: Colours of Okabe and Ito, which people with colour blindness can distinguish.
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


def surfaces(of: CellMap, axes: Any) -> Any:
    axes = _axes(axes)
    parts = (of.r_ohm[0], of.dc_resistance_ohm)
    for k, (degc, *rows) in enumerate(zip(of.temperature_c, *parts)):
        colour, label = f"C{k}", f"{degc:.0f} °C"
        axes.plot(100 * of.soc, 1e3 * rows[1], "-", color=colour, label=f"{label}, with branches")
        axes.plot(100 * of.soc, 1e3 * rows[0], "--", color=colour, label=f"{label}, series")
    axes.set_yscale("log")
    axes.set_xlabel("state of charge / %")
    axes.set_ylabel("resistance / mΩ")
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


def motion(of: Motion, axes: Any) -> Any:
    axes = _axes(axes)
    axes.plot(of.time_s, of.bus_w / 1e3, color=MEASURED)
    axes.set_xlabel("time / s")
    axes.set_ylabel("power of the bus / kW", color=MEASURED)
    for k in range(1, len(of.phase)):
        if of.phase[k] != of.phase[k - 1]:
            axes.axvline(of.time_s[k], color="0.7", lw=0.8)
    other = axes.twinx()
    other.plot(of.time_s, of.ccv_v, color=FITTED, lw=1)
    other.set_ylabel("voltage of the bus / V", color=FITTED)
    axes.set_title(f"{of.goal}, law {of.law}: {of.reached}")
    axes.grid(alpha=0.3)
    return axes


def moving(of: Motion, path: Any, fps: int, slow: float) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.animation import FuncAnimation, PillowWriter

    shapes = of.shapes()
    # Rising times, of which an interpolation has one value each.
    kept = np.append(True, np.diff(of.time_s) > 0)
    now_s = np.linspace(0, of.time_s[-1], max(2, int(fps * slow * of.time_s[-1])))
    flat = shapes[kept].reshape(int(kept.sum()), -1).T
    frames = np.array([np.interp(now_s, of.time_s[kept], row) for row in flat])
    frames = frames.T.reshape(-1, 2, shapes.shape[2])
    figure, axes = plt.subplots(figsize=(4, 5))
    axes.set_xlim(shapes[:, 0].min() - 0.3, shapes[:, 0].max() + 0.3)
    axes.set_ylim(-0.1, shapes[:, 1].max() + 0.2)
    axes.set_aspect("equal")
    axes.axhline(0, color="0.5", lw=1)
    (line,) = axes.plot([], [], "o-", color=MEASURED, lw=3)

    def show(frame: int) -> tuple[Any]:
        line.set_data(frames[frame, 0], frames[frame, 1])
        axes.set_title(f"{now_s[frame]:.2f} s")
        return (line,)

    film = FuncAnimation(figure, show, frames=len(now_s))
    film.save(os.fspath(path), writer=PillowWriter(fps=fps))
    plt.close(figure)


#: Quantities of an ageing: column, column of its uncertainty, axis, factor of the axis.
_AGEING = (
    ("r_ohm", "r_sigma_ohm", "R / mΩ", 1e3),
    ("dc_resistance_ohm", "dc_resistance_sigma_ohm", "DC resistance / mΩ", 1e3),
    ("slow_r_ohm", "slow_r_sigma_ohm", "slowest pair R / mΩ", 1e3),
    ("slow_tau_s", "slow_tau_sigma_s", "slowest pair τ / s", 1.0),
)


def _bars(axes: Any, rows: Any, value: str, sigma: str, factor: float) -> None:
    """Points over time with bars of one standard uncertainty; no bar where it is not known."""
    times = np.asarray(rows["started_unix_s"], dtype=np.float64) * 1e6
    values = factor * np.asarray(rows[value], dtype=np.float64)
    spread = np.nan_to_num(factor * np.asarray(rows[sigma], dtype=np.float64))
    dates = times.astype("datetime64[us]")
    axes.errorbar(dates, values, yerr=spread, fmt="o", ms=4, capsize=2, color=MEASURED)
    axes.grid(alpha=0.3)


def ageing(of: Ageing, axes: Any) -> Any:
    table, diffusion = of.table, of.diffusion
    effects = zip(diffusion["effect"], diffusion["name"], diffusion["unit"])
    named = sorted({(str(effect), str(name), str(unit)) for effect, name, unit in effects})
    shown = [one for one in _AGEING if np.isfinite(np.asarray(table[one[0]], dtype=float)).any()]
    if axes is None:
        import matplotlib.pyplot as plt

        count = max(len(shown) + len(named), 1)
        size = (7.0, 2.2 * count)
        axes = plt.subplots(count, 1, sharex=True, squeeze=False, figsize=size)[1][:, 0]
    for one, (value, sigma, name, factor) in zip(axes, shown):
        _bars(one, table, value, sigma, factor)
        one.set_ylabel(name)
    for one, (effect, name, unit) in zip(list(axes)[len(shown) :], named):
        all_of_them = zip(diffusion["effect"], diffusion["name"])
        mine = np.array([(str(e), str(n)) == (effect, name) for e, n in all_of_them])
        rows = {c: np.asarray(diffusion[c])[mine] for c in ("started_unix_s", "value", "sigma")}
        _bars(one, rows, "value", "sigma", 1.0)
        one.set_ylabel(f"{effect} {name} / {unit}")
    axes[0].set_title(f"{of.cell}, models with {of.rc} RC pairs")
    axes[-1].set_xlabel("time (UTC)")
    return axes
