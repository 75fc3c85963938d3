"""A motion that was found: columns, table, pictures, and its profile of power."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from .._eisbench import EisError
from .._table import Table
from ._mechanics import Mechanics
from ._robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A motion over time, a row per point; both sides of a change of contact have one. A gait is one step.

    Torques and currents of motors are those of one leg's joints (``torque_nm``, ``motor_a``), or with legs
    ``apart`` of the standing and then the swinging leg's; forces of the ground (``force_n``: along the
    ground, up at toe and heel) are those of both feet, or of each in turn; powers (``joint_w``,
    ``motor_w``) are those of all motors of a joint. Margins are those of a cell, positive inside
    its window, and not a number without a pack. ``state`` is that of a cell.
    """

    goal: str
    law: str
    robot: Robot
    apart: bool
    time_s: Array
    phase: list[str]
    q: Array
    v: Array
    a: Array
    torque_nm: Array
    force_n: Array
    com_m: Array
    com_m_s: Array
    joint_w: Array
    motor_a: Array
    motor_w: Array
    bus_w: Array
    current_a: Array
    ccv_v: Array
    margin_low_v: Array
    margin_high_v: Array
    state: Array
    status: str
    iterations: int
    solve_s: float
    build_s: float

    @property
    def mechanics(self) -> Mechanics:
        """The equations of motion."""
        return self.robot.mechanics(self.apart)

    @property
    def take_off(self) -> int:
        """Row of the first point in flight.

        Raises EisError for a gait.
        """
        if self.apart:
            raise EisError(f"{self.goal}: expected a motion with a flight, met a gait")
        return self.phase.index("flight")

    @property
    def step_m(self) -> float:
        """Length of a step.

        Raises EisError for a motion that is not a gait.
        """
        if not self.apart:
            raise EisError(f"{self.goal}: expected a gait, met a motion with legs together")
        place = self.mechanics.functions()["foot"](self.q[-1], self.v[-1], self.a[-1])[0]
        return float(place[0])

    @property
    def height_m(self) -> float:
        """Height of the centre of mass at its highest above that of the upright robot."""
        row, g = self.take_off, self.robot.gravity_m_s2
        rise_m = self.com_m[row, 1] + self.com_m_s[row, 1] ** 2 / (2 * g)
        return float(rise_m - self.robot.standing_m)

    @property
    def energy_j(self) -> float:
        """Energy that the bus gave."""
        return float(np.sum(np.diff(self.time_s) * (self.bus_w[1:] + self.bus_w[:-1]) / 2))

    def columns(self) -> dict[str, Array]:
        """Columns by name, of one length."""
        com = {"com_x_m": self.com_m[:, 0], "com_z_m": self.com_m[:, 1]}
        out: dict[str, Array] = {"time_s": self.time_s, **com}
        for k, hinge in enumerate(self.mechanics.hinges):
            name, upper, lower = hinge.name, hinge.upper, hinge.lower
            out[f"{name}_rad"] = hinge.sign * (self.q[:, upper] - self.q[:, lower])
            out[f"{name}_rad_s"] = hinge.sign * (self.v[:, upper] - self.v[:, lower])
            out[f"{name}_nm"] = self.torque_nm[:, k]
            out[f"{name}_joint_w"] = self.joint_w[:, k]
            out[f"{name}_motor_w"] = self.motor_w[:, k]
        names = [f"{foot}{part}" for foot in ("", "swing_") for part in ("ground_x_n", "toe_z_n", "heel_z_n")]
        for name, force_n in zip(names, self.force_n.T):
            out[name] = force_n
        for name in ("bus_w", "current_a", "ccv_v", "margin_low_v", "margin_high_v"):
            out[name] = getattr(self, name)
        return out

    def table(self) -> Table:
        """The columns as a table."""
        return Table(self.columns())

    def profile(self, steps: int = 1) -> tuple[Array, Array]:
        """Time and power of the bus at rising times; a gait takes ``steps``. Where the power jumps, as at a
        landing, the second row follows 0.1 ms later."""
        if steps != 1 and not self.apart:
            raise EisError(f"{self.goal}: steps: expected 1 for a motion that is not a gait, met {steps!r}")
        if steps != int(steps) or steps < 1:
            raise EisError(f"{self.goal}: steps: expected a whole number from 1, met {steps!r}")
        starts_s = np.repeat(self.time_s[-1] * np.arange(steps), self.time_s.size)
        time_s, bus_w = starts_s + np.tile(self.time_s, steps), np.tile(self.bus_w, steps)
        kept = np.ones(time_s.size, bool)
        for row in np.flatnonzero(np.diff(time_s) <= 0) + 1:
            if abs(bus_w[row] - bus_w[row - 1]) < 0.1:
                kept[row] = False
            else:
                time_s[row] += 1e-4
        return time_s[kept], bus_w[kept]

    def write_profile(self, path: Union[str, "os.PathLike[str]"], steps: int = 1) -> None:
        """Writes ``time_s,power_w``, which ``eis-bench simulate --profile`` and ``pack simulate`` read;
        the power goes along lines (``--interpolation linear``). A gait takes ``steps``."""
        rows = [f"{time_s:.6f},{power_w:.4f}" for time_s, power_w in zip(*self.profile(steps))]
        Path(path).write_text("\n".join(["time_s,power_w", *rows, ""]), encoding="utf-8")

    def plot(self, axes: Any = None) -> Any:
        """Power, voltage of the bus and height over time; gives matplotlib axes."""
        from .._plot import motion

        return motion(self, axes)

    def animate(
        self, path: Union[str, "os.PathLike[str]"], fps: int = 25, slow: float = 4.0
    ) -> None:
        """Writes a GIF in which the robot moves ``slow`` times slower than in life."""
        from .._plot import moving

        moving(self, path, fps, slow)

    def shapes(self) -> Array:
        """Heel, toe, ankle, knee, hip, shoulders, and with legs apart hip to heel of the other leg, at every
        point: points, coordinates, corners."""
        shape = self.mechanics.functions()["shape"]
        return np.stack([np.asarray(shape(row)) for row in self.q])

    @property
    def reached(self) -> str:
        """What the motion reaches, as text: a height, or steps."""
        if not self.apart:
            return f"{self.height_m:.3f} m"
        step_m = self.step_m
        return f"steps of {step_m:.3f} m, {self.energy_j / step_m:.0f} J/m"

    def __str__(self) -> str:
        peak_kw, lowest_v = self.bus_w.max() / 1e3, self.ccv_v.min()
        return (
            f"{self.goal}, law {self.law}: {self.reached}, {self.time_s[-1]:.3f} s, "
            f"{self.energy_j:.0f} J, peak {peak_kw:.2f} kW, lowest {lowest_v:.2f} V; "
            f"{self.iterations} iterations, {self.solve_s:.1f} s"
        )
