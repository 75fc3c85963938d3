"""The tasks: what is asked of a motion, and what it costs."""

from __future__ import annotations

import math
from typing import Any, Optional

import numpy as np

from .._eisbench import EisError
from ._laws import Law
from ._problem import Options, Phase, Problem
from ._result import Motion
from ._robot import Robot

#: Price of a height that is missed.
MISSED_S_PER_M = 10.0
#: Poses of the built-in start: toe, and the angles of foot, shank, thigh and trunk.
CROUCH = (0.0, 0.0, 0.0, 0.6, -0.9, 0.5)
PUSHED = (0.0, 0.0, 0.5, 0.2, -0.1, 0.1)
TUCKED = (0.0, 0.0, 0.0, 0.4, -0.6, 0.3)


def jump(robot: Robot, law: Law, options: Optional[Options] = None) -> Motion:
    """The highest jump from rest, straight up: stance, flight, and touchdown with flat feet in the same place.

    Raises EisError if the solver finds none.
    """
    problem, rise_m, _ = _take_off(robot, law, options, "jump", 0.0)
    return problem.solve(-rise_m)


def jump_to(robot: Robot, law: Law, height_m: float, options: Optional[Options] = None) -> Motion:
    """The jump of ``height_m`` that reaches its highest point soonest after the start.

    Raises EisError if the solver finds none: the height may be out of reach.
    """
    if not 0 < height_m < math.inf:
        raise EisError(f"jump_to: height_m: expected a positive height, met {height_m!r}")
    problem, rise_m, rising_s = _take_off(robot, law, options, f"jump_to {height_m} m", 0.0)
    # A height that may be missed at a price above all times keeps the solver from points where it finds no
    # way to the height.
    missed_m = problem.variable(0.0, math.inf, height_m, reach=0.0)
    problem.require(rise_m + missed_m - height_m, 0.0, math.inf)
    found = problem.solve(rising_s + MISSED_S_PER_M * missed_m)
    if found.height_m < height_m - 1e-4:
        raise EisError(
            f"{found.goal}: not solved, the highest that was found is {found.height_m:.3f} m; ask for less, "
            "relax a limit or use another start (Options.seed)"
        )
    return found


def gap(robot: Robot, law: Law, length_m: float, options: Optional[Options] = None) -> Motion:
    """The jump over a gap of ``length_m`` between toe and heel, from rest to rest, that takes the least energy.

    Raises EisError if the solver finds none: the gap may be too wide.
    """
    if not 0 < length_m < math.inf:
        raise EisError(f"gap: length_m: expected a positive length, met {length_m!r}")
    problem, _, _ = _take_off(robot, law, options, f"gap {length_m} m", length_m + robot.foot_m)
    ahead = np.array([length_m + robot.foot_m, 0, 0, 0, 0, 0])
    stance = Phase("landing", problem.options.landing, 0.1, 1.0, 0.4)
    points = problem.phase(stance, ahead + TUCKED, ahead + CROUCH)
    problem.require(points["v"][3:, -1])
    problem.require(points["a"][3:, -1] / 10)
    problem.require(points["q"][3:, -1] - problem.points[0]["q"][3:, 0])
    return problem.solve(problem.energy_kj())


def walk(robot: Robot, law: Law, speed_m_s: float, options: Optional[Options] = None) -> Motion:
    """The gait at a mean speed that takes the least energy per metre: one step, after which legs, and the
    branches of the cell, are as at its start with legs exchanged.

    The step begins with both feet on the ground, the rear one on its toe (``double``); then that leg swings
    ahead (``single``), and lands flat and without impact. The standing foot stays flat.
    Raises EisError if the solver finds none: the speed may be out of reach.
    """
    if not 0 < speed_m_s < math.inf:
        raise EisError(f"walk: speed_m_s: expected a positive speed, met {speed_m_s!r}")
    pack = _law(law).pack
    if pack is not None and pack.model.additions:
        met = ", ".join(pack.model.additions)
        raise EisError(f"walk: expected a model without additions, whose states may not repeat, met {met}")
    problem = Problem(robot, law, options or Options(), f"walk {speed_m_s} m/s", apart=True)
    ca, foot, asked = problem.ca, problem.f["foot"], problem.options
    guess_m = min(0.15 + 0.25 * speed_m_s, 0.45)
    whole_s = guess_m / speed_m_s
    begin, lifted, end = (
        _standing(robot, share * guess_m, toe_m * guess_m, angle)
        for share, toe_m, angle in ((-0.5, -1, 0.0), (-0.3, -1, 0.3), (0.5, 1, 0.0))
    )
    double = problem.phase(
        Phase("double", asked.double, 0.01, 1.0, 0.2 * whole_s), begin, lifted
    )
    count = double["q"].shape[1]
    _, _, slip, heel = foot.map(count)(double["q"], double["v"], double["a"])
    problem.require(slip / 10)
    problem.require(heel[1, :], 0, math.inf)
    single = problem.phase(Phase("single", asked.single, 0.05, 3.0, 0.8 * whole_s), lifted, end)
    count = single["q"].shape[1]
    toe, speed, _, heel = foot.map(count)(single["q"], single["v"], single["a"])
    share = np.linspace(0, 1, count)
    # It leaves the ground and lands at rest, so that the height has no slope there.
    clear_m = ca.DM(16 * robot.clearance_m * (share * (1 - share)) ** 2).T
    problem.require(toe[1, 1:-1] - clear_m[1:-1], 0, math.inf)
    problem.require(heel[1, 1:-1] - clear_m[1:-1], 0, math.inf)
    # The foot lands flat, at rest.
    step_m = toe[0, -1]
    problem.require(ca.vertcat(toe[1, -1], single["q"][8, -1]))
    problem.require(ca.vertcat(speed[:, -1], single["v"][8, -1]))
    # The legs change their roles: the angles from shank to other foot, and all torques, in reversed order.
    for key, first, scale in (("q", 3, 1), ("v", 3, 1), ("t", 0, 10)):
        begun, ended = double[key][first:, 0], single[key][:, -1]
        rows = begun.numel()
        problem.require((begun - ended[::-1][max(first - 2, 0) :][:rows]) / scale)
    if problem.cell is not None:
        settled = problem.cell.lasting.stop
        problem.require(double["x"][settled:, 0] - single["x"][settled:, -1])
    problem.require(step_m - speed_m_s * (problem.spans[0] + problem.spans[1]))
    problem.require(step_m, 0.02, math.inf)
    return problem.solve(problem.energy_kj() / step_m)


def _standing(robot: Robot, hip_m: float, toe_m: float, angle_rad: float) -> list[float]:
    """Coordinates with the first foot flat, the hip ``hip_m`` before its ankle, the second toe ``toe_m``
    before the first, and an angle of its foot; trunk upright."""
    shank_m, thigh_m = robot.shank.length_m, robot.thigh.length_m
    hip = np.array([hip_m, 0.92 * (shank_m + thigh_m)])

    def leg(from_ankle: Any) -> list[float]:
        """Angles of shank and thigh, with the knee ahead."""
        reach = min(float(np.hypot(*from_ankle)), 0.999 * (shank_m + thigh_m))
        tilt = math.atan2(from_ankle[0], from_ankle[1])
        ankle = (shank_m**2 + reach**2 - thigh_m**2) / (2 * shank_m * reach)
        top = (thigh_m**2 + reach**2 - shank_m**2) / (2 * thigh_m * reach)
        return [tilt + math.acos(ankle), tilt - math.acos(top)]

    c, s = math.cos(angle_rad), math.sin(angle_rad)
    ahead, up = -robot.toe_m, robot.foot.length_m
    lifted = np.array([ahead * c + up * s, up * c - ahead * s]) - [ahead, up]
    shank, thigh = leg(hip)
    other_shank, other_thigh = leg(hip - [toe_m, 0] - lifted)
    return [0, 0, 0, shank, thigh, 0, other_thigh, other_shank, angle_rad]


def _law(law: Law) -> Law:
    if not isinstance(law, Law):  # pyright: ignore[reportUnnecessaryIsInstance]
        expected = "expected Free, PowerLimit, SimpleIR or Transient"
        raise EisError(f"law: {expected}, met {law!r}")
    return law


def _take_off(
    robot: Robot, law: Law, options: Optional[Options], goal: str, ahead_m: float
) -> tuple[Problem, Any, Any]:
    """Stance and flight until the foot is flat on the ground ``ahead_m`` further; the rise of the centre
    of mass above that of the upright robot, and the time to its highest point."""
    problem = Problem(robot, _law(law), options or Options(), goal)
    asked, ahead = problem.options, np.array([ahead_m, 0, 0, 0, 0, 0])
    start = problem.phase(Phase("flat", asked.flat, 0.05, 1.0, 0.3), CROUCH, CROUCH)
    problem.require(start["v"][3:, 0])
    problem.require(start["a"][3:, 0] / 10)
    problem.phase(Phase("toe", asked.toe, 0.01, 0.3, 0.05), CROUCH, PUSHED)
    flight = problem.phase(Phase("flight", asked.flight, 0.05, 2.0, 0.5), PUSHED, ahead + TUCKED)
    problem.require(flight["q"][:3, -1] - [ahead_m, 0.0, 0.0])
    place, speed, _ = problem.f["com"](flight["q"][:, 0], flight["v"][:, 0])
    rise_m = place[1] + speed[1] ** 2 / (2 * robot.gravity_m_s2) - robot.standing_m
    problem.require(speed[1], 0.0, math.inf)
    rising_s = problem.spans[0] + problem.spans[1] + speed[1] / robot.gravity_m_s2
    return problem, rise_m, rising_s
