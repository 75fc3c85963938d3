"""A motion that was found: columns, table, pictures, and its profile of power."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from .._table import Table
from ._robot import JOINTS, SIGNS, Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A motion over time, a row per point; both sides of a change of contact have one.

    Torques, forces of the ground and currents of motors are those of one leg's joints (``torque_nm``,
    ``motor_a``) and of the whole robot (``force_n``: along the ground, up at toe and heel); powers
    (``joint_w``, ``motor_w``) are those of all motors of a joint. Margins are those of a cell, positive inside
    its window, and not a number without a pack. ``state`` is that of a cell.
    """

    goal: str
    law: str
    robot: Robot
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
    def take_off(self) -> int:
        """Row of the first point in flight."""
        return self.phase.index("flight")

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
        for k, (name, sign) in enumerate(zip(JOINTS, SIGNS)):
            out[f"{name}_rad"] = sign * (self.q[:, 3 + k] - self.q[:, 2 + k])
            out[f"{name}_rad_s"] = sign * (self.v[:, 3 + k] - self.v[:, 2 + k])
            out[f"{name}_nm"] = self.torque_nm[:, k]
            out[f"{name}_joint_w"] = self.joint_w[:, k]
            out[f"{name}_motor_w"] = self.motor_w[:, k]
        for k, name in enumerate(("ground_x_n", "toe_z_n", "heel_z_n")):
            out[name] = self.force_n[:, k]
        for name in ("bus_w", "current_a", "ccv_v", "margin_low_v", "margin_high_v"):
            out[name] = getattr(self, name)
        return out

    def table(self) -> Table:
        """The columns as a table."""
        return Table(self.columns())

    def profile(self) -> tuple[Array, Array]:
        """Time and power of the bus at rising times: at a landing, where the power jumps, the second
        row follows 0.1 ms later."""
        time_s, kept = self.time_s.copy(), np.ones(self.time_s.size, bool)
        for row in np.flatnonzero(np.diff(time_s) <= 0) + 1:
            if abs(self.bus_w[row] - self.bus_w[row - 1]) < 0.1:
                kept[row] = False
            else:
                time_s[row] += 1e-4
        return time_s[kept], self.bus_w[kept]

    def write_profile(self, path: Union[str, "os.PathLike[str]"]) -> None:
        """Writes ``time_s,power_w``, which ``eis-bench simulate --profile`` and ``pack simulate`` read;
        the power goes along lines (``--interpolation linear``)."""
        rows = [f"{time_s:.6f},{power_w:.4f}" for time_s, power_w in zip(*self.profile())]
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
        """Heel, toe, ankle, knee, hip and shoulders at every point: points, coordinates, corners."""
        shape = self.robot.functions()["shape"]
        return np.stack([np.asarray(shape(row)) for row in self.q])

    def __str__(self) -> str:
        peak_kw, lowest_v = self.bus_w.max() / 1e3, self.ccv_v.min()
        return (
            f"{self.goal}, law {self.law}: {self.height_m:.3f} m, {self.time_s[-1]:.3f} s, "
            f"{self.energy_j:.0f} J, peak {peak_kw:.2f} kW, lowest {lowest_v:.2f} V; "
            f"{self.iterations} iterations, {self.solve_s:.1f} s"
        )
