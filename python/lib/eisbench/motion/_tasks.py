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
    problem.require(rise_m, height_m, height_m)
    return problem.solve(rising_s)


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
    energy_kj: Any = 0.0
    for phase, span, point in zip(problem.phases, problem.spans, problem.points):
        mean_w = problem.ca.dot(point["bus"], problem.ca.DM(phase.weights).T)
        energy_kj += span * mean_w / 1e3
    return problem.solve(energy_kj)


def _take_off(
    robot: Robot, law: Law, options: Optional[Options], goal: str, ahead_m: float
) -> tuple[Problem, Any, Any]:
    """Stance and flight until the foot is flat on the ground ``ahead_m`` further; the rise of the centre
    of mass above that of the upright robot, and the time to its highest point."""
    if not isinstance(law, Law):  # pyright: ignore[reportUnnecessaryIsInstance]
        expected = "expected Free, PowerLimit, SimpleIR or Transient"
        raise EisError(f"law: {expected}, met {law!r}")
    problem = Problem(robot, law, options or Options(), goal)
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
