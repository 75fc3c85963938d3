"""Packs, and the four laws by which a battery limits a motion."""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._eisbench import EisError
from .._model import Model
from ._mechanics import casadi


#: Movement of a voltage that has not moved, by which the error of held-out runs counts, V.
STILL_V = 0.02
#: How far a motion may move the state of charge of a cell.
CHARGE_REACH = 0.1


@dataclass(frozen=True)
class Pack:
    """``series`` times ``parallel`` equal cells of a model with an open-circuit voltage.

    ``soc`` is the state of charge at the start, from rest; ``ageing`` a factor of all resistances at
    constant time constants; ``window_v`` the voltages of a cell; ``ambient_degc`` the temperature of the
    surroundings, and of the cell at the start, for a model with a map.
    """

    model: Model
    series: int
    parallel: int
    soc: float
    interconnect_ohm: float = 0.0
    ageing: float = 1.0
    window_v: tuple[float, float] = (2.5, 4.2)
    ambient_degc: float = 25.0

    def __post_init__(self) -> None:
        for name, value in (("series", self.series), ("parallel", self.parallel)):
            if value != int(value) or value < 1:
                raise EisError(f"Pack.{name}: expected a whole number from 1, met {value!r}")
        if not 0 <= self.soc <= 1:
            raise EisError(f"Pack.soc: expected 0 to 1, met {self.soc!r}")
        if not self.interconnect_ohm >= 0:
            raise EisError(
                f"Pack.interconnect_ohm: expected 0 or more, met {self.interconnect_ohm!r}"
            )
        if not 0 < self.ageing < math.inf:
            raise EisError(f"Pack.ageing: expected a positive factor, met {self.ageing!r}")
        if not 0 < self.window_v[0] < self.window_v[1]:
            raise EisError(f"Pack.window_v: expected two rising voltages, met {self.window_v!r}")
        if not self.model._model.has_ocv:
            raise EisError(
                "Pack.model: expected an open-circuit voltage; add it with Model.with_ocv"
            )

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.series * self.parallel

    @property
    def aged(self) -> Model:
        """The model with aged resistances."""
        if self.ageing == 1.0:
            return self.model
        if self.model.additions:
            met = ", ".join(self.model.additions)
            raise EisError(f"Pack.ageing: expected 1 for a model with additions, met {met}")
        whole = json.loads(self.model._model.to_json())
        scaled = {"name": self.model.name, "ocv": whole["ocv"], **self._plain()}
        if "map" in whole:
            scaled["map"] = _scaled(whole["map"], self.ageing)
        return _read(scaled)

    def _plain(self) -> dict[str, Any]:
        branches = [(self.ageing * b.r_ohm, b.c_f / self.ageing) for b in self.model.branches]
        plain = [{"r_ohm": r_ohm, "c_f": c_f} for r_ohm, c_f in branches]
        return {"r_ohm": self.ageing * self.model.r_ohm, "branches": plain}


def _scaled(value: Any, factor: float) -> Any:
    """The tables of a map with resistances times a factor."""
    if isinstance(value, dict):
        out: dict[str, Any] = {}
        for key, inner in cast("dict[str, Any]", value).items():
            if key == "r_ohm":
                out[key] = [[factor * r_ohm for r_ohm in row] for row in inner]
            else:
                out[key] = _scaled(inner, factor)
        return out
    if isinstance(value, list):
        return [_scaled(inner, factor) for inner in cast("list[Any]", value)]
    return value


def _read(whole: dict[str, Any]) -> Model:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.json"
        file.write_text(json.dumps(whole), encoding="utf-8")
        return Model.read(file)


class Law:
    """What limits the power: one of :class:`Free`, :class:`PowerLimit`, :class:`SimpleIR` and
    :class:`Transient`. Without a pack the voltage of the bus is ``bus_v``."""

    name = "law"
    pack: Optional[Pack] = None
    bus_v: float = 60.0
    limit_w: float = math.inf
    correction_v: Optional[NDArray[np.float64]] = None

    def cell(self) -> Optional[Cell]:
        """The cell of the pack as CasADi functions."""
        return None


class Free(Law):
    """No law: a bus of constant voltage that gives any power."""

    name = "none"

    def __init__(self, bus_v: float = 60.0) -> None:
        if not bus_v > 0:
            raise EisError(
                f"{type(self).__name__}.bus_v: expected a positive voltage, met {bus_v!r}"
            )
        self.bus_v = bus_v


class PowerLimit(Free):
    """A bus of constant voltage that gives at most ``limit_w``."""

    name = "power limit"

    def __init__(self, limit_w: float, bus_v: float = 60.0) -> None:
        super().__init__(bus_v)
        if not limit_w > 0:
            raise EisError(f"PowerLimit.limit_w: expected a positive power, met {limit_w!r}")
        self.limit_w = limit_w


class Transient(Law):
    """The law of the model: a state per node, both margins of the voltage at every node.

    Beyond ``p0_share`` of the most power that there is the voltage follows its tangent, so that the
    solver can pass through powers that no cell can give; without ``tangent`` such a power has no
    voltage. With ``sigmas``, the window holds for the band of that many standard deviations around the
    predicted voltage, by the error that a map states, and the motors get its lower edge; for a model that a
    diagnosis has augmented, it is that many times the band of the held-out runs.
    ``correction_v``, V, is added to the voltage of a cell at each point of a motion of equal intervals:
    what a replay of an earlier plan had less the voltage of the model there, its own correction left out.
    """

    name = "transient"

    def __init__(
        self,
        pack: Pack,
        p0_share: float = 0.95,
        tangent: bool = True,
        sigmas: float = 0.0,
        correction_v: Optional[ArrayLike] = None,
    ) -> None:
        kind = type(self).__name__
        if not 0 < p0_share < 1:
            raise EisError(f"{kind}.p0_share: expected 0 to 1, met {p0_share!r}")
        if not 0 <= sigmas < math.inf:
            raise EisError(f"{kind}.sigmas: expected 0 or more, met {sigmas!r}")
        self.pack, self.p0_share, self.tangent, self.sigmas = pack, p0_share, tangent, sigmas
        if correction_v is not None:
            self.correction_v = np.asarray(correction_v, dtype=np.float64)

    def model(self, pack: Pack) -> Model:
        """The model of a cell that the law takes."""
        return pack.aged

    def cell(self) -> Cell:
        assert self.pack is not None
        names = self.model(self.pack)._module("casadi", window_v=self.pack.window_v)
        if not self.tangent:
            names["law_a"] = _root_a
        error = _error_v(self.pack) if self.sigmas else (0.0, 0.0)
        rest_v, share = (self.sigmas * part for part in error)
        return Cell(self.pack, names, self.p0_share, (rest_v, share))


class SimpleIR(Transient):
    """OCV less one resistance per cell, by default that of the model at zero frequency."""

    name = "simple IR"

    def __init__(
        self,
        pack: Pack,
        r_ohm: Optional[float] = None,
        p0_share: float = 0.95,
        tangent: bool = True,
        correction_v: Optional[ArrayLike] = None,
    ) -> None:
        super().__init__(pack, p0_share, tangent, correction_v=correction_v)
        if r_ohm is not None and not r_ohm > 0:
            raise EisError(f"SimpleIR.r_ohm: expected a positive resistance, met {r_ohm!r}")
        self.r_ohm = r_ohm

    def model(self, pack: Pack) -> Model:
        whole = json.loads(pack.model._model.to_json())
        if self.r_ohm is None and "map" in whole:
            raise EisError("SimpleIR.r_ohm: expected a resistance for a model with a map, met None")
        r_ohm = pack.ageing * (self.r_ohm or pack.model.dc_resistance_ohm)
        return _read({"name": pack.model.name, "r_ohm": r_ohm, "branches": [], "ocv": whole["ocv"]})


def _error_v(pack: Pack) -> tuple[float, float]:
    """Standard deviation of the voltage of a cell in a whole run: at rest at the start, V, and its growth
    as a share of the overpotential, under a current of one second that would take the cell to its lower
    limit if the resistance did not fall under current.

    For a model with additions the half width of the band of its held-out runs, which `simulate` documents.
    """
    whole: dict[str, Any] = json.loads(pack.model._model.to_json())
    facts: dict[str, Any] = whole.get("facts") or {}
    if pack.model.additions and facts.get("held_out"):
        share = float(facts["held_out"]["share"])
        return STILL_V * share, share

    def error_under(current_a: float) -> tuple[float, float, Any]:
        """Standard deviation at rest, V, its growth, and the run."""
        run = pack.model.simulate(
            [0.0, 1.0, 2.0, 3.0],
            current_a=[0.0, 0.0, current_a, 0.0],
            soc=pack.soc,
            ambient_c=pack.ambient_degc,
        )
        if "cell_sigma_v" not in run.columns:
            expected = "a model with a map that states its error, or with additions and held-out runs"
            message = f"Transient.sigmas: expected {expected}, met none"
            raise EisError(message)
        sigma_v, loss_v = run["cell_sigma_v"], run["ocv_v"] - run["cell_v"]
        most = int(np.argmax(loss_v))
        grown2 = max(sigma_v[most] ** 2 - sigma_v[0] ** 2, 0.0)
        return float(sigma_v[0]), math.sqrt(grown2) / float(loss_v[most]), run

    # The error of the resistances alone shows at a small current, that of their fall at a large one.
    rest_v, of_resistances, run = error_under(1.0)
    start_v = float(run["cell_v"][0])
    most_a = (start_v - pack.window_v[0]) / (start_v - float(run["cell_v"].min()))
    _, of_all, _ = error_under(max(1.0, most_a))
    whole_runs = whole["map"]["voltage_error"].get("whole_runs", 1.0)
    of_fall = math.sqrt(max(of_all**2 - of_resistances**2, 0.0))
    return whole_runs * rest_v, math.hypot(whole_runs * of_resistances, of_fall)


def _root_a(e_v: Any, r_ohm: Any, power_w: Any, p0_share: Any, order: int = 1) -> Any:
    """The current without the tangent: not a number beyond the most power."""
    return (e_v - casadi().sqrt(e_v**2 - 4 * r_ohm * power_w)) / (2 * r_ohm)


def _keep_near(names: dict[str, Any], soc: float) -> None:
    """Drops the knots of the tables of a model that no motion reaches: each costs time in every
    derivative."""

    def kept(knots: list[float]) -> slice:
        low, high = (np.searchsorted(knots, soc + sign * CHARGE_REACH) for sign in (-1, 1))
        return slice(max(int(low) - 1, 0), int(high) + 1)

    knots = kept(names["KNOT_SOC"])
    for name in ("KNOT_SOC", "KNOT_OCV_V", "KNOT_SLOPE_V"):
        names[name] = names[name][knots]
    if "MAP_SOC" in names:
        knots, size = kept(names["MAP_SOC"]), len(names["MAP_SOC"])
        rows = np.reshape(names["MAP_R_OHM"], (-1, size))
        names["MAP_R_OHM"] = rows[:, knots].ravel().tolist()
        for name in ("MAP_SOC", "OFFSET_V", "OFFSET_V_PER_K"):
            names[name] = names[name][knots]


class Cell:
    """A cell of a pack with its share of the interconnect, for powers of the bus divided over the cells.

    ``look`` (state, power) → (share of the voltage of the bus, voltage of the cell, power as a share
    of the most that there is, half width of the band); ``advance`` (state and power at the start,
    state and power at the end, step) → state at the end. In a step the current goes along a straight line
    between those of the two powers, for which the branches are exact. ``band`` is the half width at rest,
    V, and its growth as a share of the overpotential.
    """

    def __init__(
        self, pack: Pack, names: dict[str, Any], p0_share: float, band: tuple[float, float]
    ) -> None:
        ca = casadi()
        share_ohm = pack.interconnect_ohm * pack.parallel / pack.series
        _keep_near(names, pack.soc)
        within = names["source"]

        def source(state: Any, demand: Any) -> tuple[Any, Any]:
            e_v, r_ohm = within(state, demand)
            return e_v, r_ohm + share_ohm

        names["source"] = source
        look, node, moved = names["look"](2), names["node"], names["moved"]
        rest = [float(value) for value in names["rest"](pack.soc).full().ravel()]
        more: list[float] = []
        if names["surroundings"]():
            rest[1], more = pack.ambient_degc, [pack.ambient_degc]
        state, after, start_w, end_w, dt_s = (
            ca.SX.sym(n, k) for n, k in zip("xypqh", (len(rest), len(rest), 1, 1, 1))
        )
        voltage_v, current_a, *_ = look(state, start_w, p0_share)
        # The state at the end is a variable of the solver too, so that the current there needs no search.
        end_a = node(after, end_w, p0_share, 2)["current_a"]
        following = moved(state, current_a, end_a, dt_s, *more, after=after)
        e_v, r_ohm = source(state, start_w)
        self.rest = rest
        #: Rows of the state that a gait changes from step to step: charge, and temperature.
        self.lasting = slice(0, 2 if more else 1)
        #: How far a state may go from rest: the temperature by 100 K, a voltage by 1 V. States of additions,
        #: such as a heat, have other units and no bound.
        most = math.inf if pack.model.additions else 1.0
        self.wide = [CHARGE_REACH, *(most for _ in rest[1:])]
        if more:
            self.wide[1] = 100.0
        cell_v = voltage_v + share_ohm * current_a
        open_v = float(within(ca.DM(rest), 0)[0])
        half_v = ca.sqrt(band[0] ** 2 + (band[1] * (open_v - cell_v)) ** 2 + 1e-12)
        # Under a power at the terminals, a lower voltage takes more current, and sinks further.
        half_v *= voltage_v / ca.fmax(2 * voltage_v - open_v, 0.2 * voltage_v)
        shown = [voltage_v, cell_v, 4 * r_ohm * start_w / e_v**2, half_v]
        self.p0_share = p0_share
        self.look = ca.Function("look", [state, start_w], shown)
        self.advance = ca.Function("advance", [state, start_w, after, end_w, dt_s], [following])
