"""Direct collocation: phases of contact, points, constraints, and their solution by IPOPT."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

from .._eisbench import EisError
from ._laws import Cell, Law
from ._result import Motion
from ._mechanics import casadi
from ._robot import Robot

#: Sizes by which the solver's variables are scaled: coordinates, speeds, accelerations, torques as a
#: share of their limit, forces, powers of a cell, and states of a cell.
SIZES = {"q": 1.0, "v": 10.0, "a": 300.0, "t": 1.0, "f": 500.0, "p": 100.0, "x": 1.0}
#: What the ground holds and carries in each phase: coordinates of the first foot, and the forces of each
#: foot, along it, up at the toe and up at the heel.
HELD = {"flat": (0, 1, 2), "landing": (0, 1, 2), "toe": (0, 1), "double": (0, 1, 2), "single": (0, 1, 2)}
CARRIED = {
    "flat": (1, 1, 1),
    "toe": (1, 1, 0),
    "flight": (0, 0, 0),
    "landing": (1, 1, 1),
    "double": (1, 1, 1, 1, 1, 0),
    "single": (1, 1, 1, 0, 0, 0),
}
#: Weight of the squared torques, as shares of their limits and over time, beside the goal.
EFFORT = 3e-3


@dataclass(frozen=True)
class Phase:
    """A phase of contact: its intervals, shortest, longest and guessed duration."""

    name: str
    intervals: int
    shortest_s: float
    longest_s: float
    guess_s: float

    @property
    def weights(self) -> list[float]:
        """Weights of the points by which Simpson's rule takes a mean over the phase."""
        inner = [4.0, 2.0] * self.intervals
        return [weight / (6 * self.intervals) for weight in (1.0, *inner[:-1], 1.0)]

    @property
    def locked(self) -> tuple[int, ...]:
        """Coordinates that the ground holds: those of the toe, and the angle of the foot."""
        return HELD.get(self.name, ())


@dataclass
class Options:
    """Intervals of each phase; the start, that is a motion of equal intervals (none: the built-in one);
    the seed of a random start around it and the reach of its powers of a cell; limits and settings of
    IPOPT."""

    flat: int = 8
    toe: int = 4
    flight: int = 6
    landing: int = 8
    start: Optional[Motion] = None
    seed: Optional[int] = None
    reach_w: float = 100.0
    max_iterations: int = 500
    ipopt: dict[str, Any] = field(default_factory=dict[str, Any])
    double: int = 4
    single: int = 8

    def __post_init__(self) -> None:
        for name in (*HELD, "flight", "max_iterations"):
            value = getattr(self, name)
            if value != int(value) or value < 1:
                raise EisError(f"Options.{name}: expected a whole number from 1, met {value!r}")


class Problem:
    """Variables with bounds, constraints with bounds, and a start."""

    def __init__(
        self, robot: Robot, law: Law, options: Options, goal: str, apart: bool = False
    ) -> None:
        self.ca, self.robot, self.law, self.options, self.goal = casadi(), robot, law, options, goal
        self.apart, self.mechanics = apart, robot.mechanics(apart)
        self.f = self.mechanics.functions()
        self.cell: Optional[Cell] = law.cell()
        self.rng = None if options.seed is None else np.random.default_rng(options.seed)
        self.variables: list[Any] = []
        self.low: list[float] = []
        self.high: list[float] = []
        self.start: list[float] = []
        self.constraints: list[Any] = []
        self.g_low: list[float] = []
        self.g_high: list[float] = []
        self.phases: list[Phase] = []
        #: Of each phase its duration and the matrices of its points, a column each.
        self.spans: list[Any] = []
        self.points: list[dict[str, Any]] = []
        self.effort: Any = 0

    def variable(
        self, low: Any, high: Any, start: Any, size: float = 1.0, reach: Optional[float] = None
    ) -> Any:
        """A column of variables within bounds. A random start is up to ``reach``, by default ``size``,
        away from the built-in one; with a reach of 0 it is that."""
        reach = size if reach is None else reach
        low, high, start = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (low, high, start))
        )
        if self.rng is not None:
            least, most = np.maximum(low, start - reach), np.minimum(high, start + reach)
            start = np.asarray(self.rng.uniform(least, most), dtype=np.float64)
        symbol = self.ca.MX.sym("w", low.size)
        self.variables.append(symbol)
        self.low += list(low / size)
        self.high += list(high / size)
        self.start += list(np.minimum(np.maximum(start, low), high) / size)
        return size * symbol

    def require(self, value: Any, low: float = 0.0, high: float = 0.0) -> None:
        """Adds a constraint, of every element."""
        value = self.ca.vec(value)
        self.constraints.append(value)
        self.g_low += [low] * value.numel()
        self.g_high += [high] * value.numel()

    def phase(self, phase: Phase, pose_from: Any, pose_to: Any) -> dict[str, Any]:
        """Adds a phase that begins where the last one ended; gives its points."""
        ca, robot, first = self.ca, self.robot, not self.phases
        rows = self._rows(phase)
        guess_s = phase.guess_s
        if self.options.start is not None:
            guess_s = np.ptp(self.options.start.time_s[rows])
        span = self.variable(phase.shortest_s, phase.longest_s, guess_s, phase.guess_s)
        points = self._points(phase, pose_from, pose_to, rows)
        q, v, a, torque, force = (points[key] for key in "qvatf")
        count, locked = q.shape[1], phase.locked
        step = span / phase.intervals
        # In flight the ballistic curve and the angular momentum take the place of the rates of toe and foot.
        flies = phase.name == "flight"
        if flies:
            self._ballistic(q, v, span)
        moving = [2, 3, 4, 5] if flies else self._unbound(q, phase)
        free = [3, 4, 5] if flies else [k for k in range(self.mechanics.size) if k not in locked]
        # Hermite and Simpson's rule, with the middle of each interval as a point of its own.
        begin, middle, end = (slice(k, count - 2 + k, 2) for k in range(3))
        for value, rate, chosen in ((q, v, moving), (v, a, free)):
            value, rate = value[chosen, :], rate[chosen, :]
            mean = (value[:, begin] + value[:, end]) / 2
            bow = step / 8 * (rate[:, begin] - rate[:, end])
            self.require(value[:, middle] - mean - bow)
            inner = rate[:, begin] + 4 * rate[:, middle] + rate[:, end]
            self.require(value[:, end] - value[:, begin] - step / 6 * inner)
        self.require(torque[:, middle] - (torque[:, begin] + torque[:, end]) / 2)
        self.require(self.f["dynamics"].map(count)(q, v, a, torque, force) / 100)
        angles, turns = self.mechanics.angles(q), self.mechanics.angles(v)
        for k, joint in enumerate(self.mechanics.joints):
            self.require(angles[k, :], joint.low_rad, joint.high_rad)
            self.require(turns[k, :] / joint.speed_rad_s, -1, 1)
        for foot in range(0, len(CARRIED[phase.name]), 3):
            if any(CARRIED[phase.name][foot : foot + 3]):
                along, up = force[foot, :], force[foot + 1, :] + force[foot + 2, :]
                grip = robot.ground_friction * up
                self.require(ca.vertcat(grip - along, grip + along) / SIZES["f"], 0, math.inf)
        if flies:
            heel = q[1, :] + robot.foot_m * ca.sin(q[2, :])
            self.require(heel, 0, math.inf)
        self._power(points, step / 2, rows, first)
        limits = ca.DM([joint.torque_nm for joint in self.mechanics.joints])
        self.effort += span * ca.dot(ca.sum1((torque / limits) ** 2), ca.DM(phase.weights).T)
        if not first:
            self._joined(phase, points)
        self.phases.append(phase)
        self.spans.append(span)
        self.points.append(points)
        return points

    def _ballistic(self, q: Any, v: Any, span: Any) -> None:
        ca, count, g = self.ca, q.shape[1], self.robot.gravity_m_s2
        place, speed, spin = self.f["com"].map(count)(q, v)
        since_s = span * ca.DM(np.linspace(0, 1, count)[1:]).T
        drop = ca.DM([0, g / 2])
        self.require(place[:, 1:] - place[:, 0] - speed[:, 0] @ since_s + drop @ since_s**2)
        self.require(speed[:, 1:] - speed[:, 0] + 2 * drop @ since_s)
        self.require(spin[1:] - spin[0])

    def _unbound(self, q: Any, phase: Phase) -> list[int]:
        """Rows of the coordinates that are not fixed to a number."""
        if not phase.locked:
            return list(range(self.mechanics.size))
        fixed = [k for k in phase.locked if k or phase.name != "landing"]
        return [k for k in range(self.mechanics.size) if k not in fixed]

    def _rows(self, phase: Phase) -> slice:
        """Rows of the points of the next phase in a motion."""
        begin = sum(2 * before.intervals + 1 for before in self.phases)
        rows = slice(begin, begin + 2 * phase.intervals + 1)
        start = self.options.start
        if start is not None:
            expected = [phase.name] * (rows.stop - rows.start)
            if start.phase[rows] != expected:
                what = f"{phase.intervals} intervals of {phase.name} after row {begin}"
                raise EisError(f"Options.start: expected a motion with {what}, met another mesh")
        return rows

    def _points(
        self, phase: Phase, pose_from: Any, pose_to: Any, rows: slice
    ) -> dict[str, Any]:
        count = 2 * phase.intervals + 1
        share = np.linspace(0, 1, count)
        poses = np.outer(np.asarray(pose_from), 1 - share) + np.outer(np.asarray(pose_to), share)
        lean = self.robot.trunk_lean_rad
        size, hinges = self.mechanics.size, len(self.mechanics.hinges)
        high = np.array([20.0, 5.0, 1.2, 1.6, 0.6, lean, 0.6, 1.6, 1.2])[:size]
        low = -np.array([20.0, 0.0, 1.2, 0.6, 2.6, lean, 2.6, 0.6, 1.2])[:size]
        if phase.name == "toe":
            low[2] = 0.0
        for k in phase.locked:
            if k or phase.name != "landing":
                low[k] = high[k] = 0.0
        held = np.isin(range(size), phase.locked)
        fast, hard = np.where(held, 0, 100.0), np.where(held, 0, 1e5)
        torque = np.array([joint.torque_nm for joint in self.mechanics.joints])
        most = 1e4 * np.array(CARRIED[phase.name])
        least = np.where(np.arange(most.size) % 3 == 0, -most, 0.0)
        weight = self.robot.mass_kg * self.robot.gravity_m_s2
        force = np.minimum(np.resize([0.0, weight / 2, weight / 2], most.size), most)
        zero = np.zeros(size)
        starts = [(pose, zero, zero, np.zeros(hinges), force, 10.0) for pose in poses.T]
        found = self.options.start
        if found is not None:
            cells = self.law.pack.cells if self.law.pack is not None else 1
            columns = (found.q, found.v, found.a, found.torque_nm / torque, found.force_n)
            starts = list(zip(*(column[rows] for column in (*columns, found.bus_w / cells))))
        points: dict[str, list[Any]] = {key: [] for key in SIZES}
        for q, v, a, t, f, p in starts:
            points["q"].append(self.variable(low, high, np.clip(q, low, high), SIZES["q"], 0.3))
            points["v"].append(self.variable(-fast, fast, v, SIZES["v"]))
            points["a"].append(self.variable(-hard, hard, a, SIZES["a"]))
            points["t"].append(torque * self.variable(-np.ones(hinges), 1, t))
            points["f"].append(self.variable(least, most, f, SIZES["f"]))
            if self.cell is not None:
                points["p"].append(self.variable(-1e3, 2e3, p, SIZES["p"], self.options.reach_w))
                rest = np.array(self.cell.rest)
                wide = np.array(self.cell.wide)
                points["x"].append(self.variable(rest - wide, rest + wide, rest, reach=0.0))
        return {key: self.ca.horzcat(*values) for key, values in points.items() if values}

    def _power(self, points: dict[str, Any], step: Any, rows: slice, first: bool) -> None:
        """Motors, the bus, and the law of the battery at every point."""
        ca, robot, law, count = self.ca, self.robot, self.law, points["q"].shape[1]
        _, voltage, motors = self.f["motors"].map(count)(points["v"], points["t"])
        bus = ca.sum1(motors) + robot.electronics_w
        points["bus"] = bus
        if self.cell is None or law.pack is None:
            points["ccv"] = law.bus_v * ca.MX.ones(1, count)
            if law.limit_w < math.inf:
                self.require(bus / 1e3, -math.inf, law.limit_w / 1e3)
        else:
            pack, power, state = law.pack, points["p"], points["x"]
            self.require((power - bus / pack.cells) / SIZES["p"])
            terminal_v, cell_v, share, half_v = self.cell.look.map(count)(state, power)
            added_v = ca.DM(self._correction_v(rows)).T
            terminal_v, cell_v = terminal_v + added_v, cell_v + added_v
            low_v, high_v = pack.window_v
            self.require(cell_v - half_v, low_v, math.inf)
            self.require(cell_v + half_v, -math.inf, high_v)
            # A plan has powers up to P₀ only; the tangent beyond is for the way to it.
            self.require(share, -math.inf, self.cell.p0_share)
            points["ccv"], points["half"] = pack.series * terminal_v, pack.series * half_v
            steps = ca.repmat(step, 1, count - 1)
            advance = self.cell.advance.map(count - 1)
            following = advance(state[:, :-1], power[:, :-1], state[:, 1:], power[:, 1:], steps)
            self.require(state[:, 1:] - following)
            if first:
                kept = self.cell.lasting if self.apart else slice(None)
                self.require(state[kept, 0] - ca.DM(self.cell.rest)[kept])
        least_v = points["ccv"] - points.get("half", 0)
        for sign in (1, -1):
            self.require((ca.repmat(least_v, voltage.shape[0], 1) + sign * voltage) / 10, 0, math.inf)

    def _correction_v(self, rows: slice) -> NDArray[np.float64]:
        """What the law adds to the voltage of a cell at rows of a motion."""
        added_v = self.law.correction_v
        if added_v is None:
            return np.zeros(int(rows.stop - rows.start))
        if added_v.size < rows.stop:
            expected = f"a voltage for each point of the motion, at least {rows.stop}"
            raise EisError(f"Transient.correction_v: expected {expected}, met {added_v.size}")
        return added_v[rows]

    def _joined(self, phase: Phase, points: dict[str, Any]) -> None:
        """The points of two phases at the instant that they share."""
        last, ca = self.points[-1], self.ca
        before, after = ({k: m[:, at] for k, m in p.items()} for p, at in ((last, -1), (points, 0)))
        self.require(after["q"] - before["q"])
        if "x" in points:
            self.require(after["x"] - before["x"])
        if phase.name == "landing":
            blow = self.variable([-500, 0, 0], 500, [0, 10, 10], 10.0)
            self.require(self.f["blow"](after["q"], after["v"] - before["v"], blow) / 10)
            grip = self.robot.ground_friction * (blow[1] + blow[2])
            self.require(ca.vertcat(grip - blow[0], grip + blow[0]) / 10, 0, math.inf)
            return
        self.require(after["v"] - before["v"])
        self.require((after["t"] - before["t"]) / 10)

    def energy_kj(self) -> Any:
        """The energy that the bus gives."""
        out: Any = 0.0
        for phase, span, point in zip(self.phases, self.spans, self.points):
            out += span * self.ca.dot(point["bus"], self.ca.DM(phase.weights).T) / 1e3
        return out

    def solve(self, cost: Any) -> Motion:
        """The motion of least cost.

        Raises EisError with the solver's status if it finds none.
        """
        ca = self.ca
        every = ca.vertcat(*self.variables)
        problem = {"x": every, "g": ca.vertcat(*self.constraints), "f": cost + EFFORT * self.effort}
        ipopt = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": self.options.max_iterations,
            **self.options.ipopt,
        }
        settings = {"print_time": False, "error_on_fail": False, "ipopt": ipopt}
        began = time.perf_counter()
        solver = ca.nlpsol("motion", "ipopt", problem, settings)
        built = time.perf_counter()
        found = solver(x0=self.start, lbx=self.low, ubx=self.high, lbg=self.g_low, ubg=self.g_high)
        ended = time.perf_counter()
        status = solver.stats()
        if not status["success"]:
            hint = "ask for less, relax a limit, use a finer mesh (Options) or another start (Options.seed)"
            after = f"after {status['iter_count']} iterations"
            raise EisError(f"{self.goal}: not solved, {status['return_status']} {after}; {hint}")
        values = ca.Function("values", [every], self._outputs())(found["x"])
        arrays = [np.atleast_2d(np.asarray(value)) for value in values]
        return self._motion(arrays, status, ended - built, built - began)

    def _outputs(self) -> list[Any]:
        ca = self.ca
        names = (
            "q",
            "v",
            "a",
            "t",
            "f",
            "bus",
            "ccv",
            *(("p", "x") if self.cell is not None else ()),
        )
        spans = [ca.horzcat(*self.spans)]
        return [*spans, *(ca.horzcat(*(points[name] for points in self.points)) for name in names)]

    def _motion(
        self, arrays: list[NDArray[np.float64]], status: Any, solve_s: float, build_s: float
    ) -> Motion:
        spans, *columns = arrays
        names = ("q", "v", "a", "torque", "force", "bus", "ccv", "power", "state")
        at = dict(zip(names, columns))
        times: list[NDArray[np.float64]] = []
        phases: list[str] = []
        for phase, span in zip(self.phases, spans.ravel()):
            now_s = float(times[-1][-1]) if times else 0.0
            times.append(now_s + np.linspace(0, span, 2 * phase.intervals + 1))
            phases += [phase.name] * times[-1].size
        count = at["q"].shape[1]
        motors = self.f["motors"].map(count)(at["v"], at["torque"])
        current_a, _, motor_w = (np.asarray(value) for value in motors)
        centre_m, centre_m_s, _ = (
            np.asarray(value) for value in self.f["com"].map(count)(at["q"], at["v"])
        )
        pack = self.law.pack
        margin_low_v = margin_high_v = np.full(count, np.nan)
        if self.cell is not None and pack is not None:
            cell_v = np.asarray(self.cell.look.map(count)(at["state"], at["power"])[1]).ravel()
            if self.law.correction_v is not None:
                cell_v = cell_v + self.law.correction_v[:count]
            margin_low_v, margin_high_v = cell_v - pack.window_v[0], pack.window_v[1] - cell_v
        bus_w, ccv_v = at["bus"].ravel(), at["ccv"].ravel()
        turns = np.asarray(self.mechanics.angles(self.ca.DM(at["v"])))
        joint_w = at["torque"] * turns * np.array(self.mechanics.counts)[:, np.newaxis]
        return Motion(
            goal=self.goal,
            law=self.law.name,
            robot=self.robot,
            apart=self.apart,
            time_s=np.concatenate(times),
            phase=phases,
            q=at["q"].T,
            v=at["v"].T,
            a=at["a"].T,
            torque_nm=at["torque"].T,
            force_n=at["force"].T,
            com_m=centre_m.T,
            com_m_s=centre_m_s.T,
            joint_w=joint_w.T,
            motor_a=current_a.T,
            motor_w=motor_w.T,
            bus_w=bus_w,
            current_a=bus_w / ccv_v,
            ccv_v=ccv_v,
            margin_low_v=margin_low_v,
            margin_high_v=margin_high_v,
            state=at["state"].T if "state" in at else np.zeros((count, 0)),
            status=str(status["return_status"]),
            iterations=int(status["iter_count"]),
            solve_s=solve_s,
            build_s=build_s,
        )
