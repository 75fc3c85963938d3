"""Equations of motion of a planar tree of bodies that stands on feet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .._optional import optional

if TYPE_CHECKING:
    from ._robot import Joint

#: Vectors along bodies, each with the coordinate of the angle of its body.
Way = list[tuple[int, tuple[float, float]]]


def casadi() -> Any:
    """CasADi, whose wheel contains IPOPT."""
    return optional("casadi", "'eisbench[motion]'")


@dataclass(frozen=True)
class Body:
    """A body: mass, moment of inertia, the coordinate of its angle, and the way from the first toe to its
    centre of mass."""

    mass_kg: float
    inertia_kg_m2: float
    angle: int
    way: Way


@dataclass(frozen=True)
class Hinge:
    """A joint between the angles of two bodies; ``count`` motors move it. Its angle is ``sign`` times that
    of the upper body less that of the lower."""

    name: str
    joint: Joint
    sign: int
    upper: int
    lower: int
    count: int


@dataclass(frozen=True)
class Foot:
    """The ways from the first toe to a toe and its heel."""

    toe: Way
    heel: Way


@dataclass(frozen=True)
class Mechanics:
    """A tree of bodies on one or two feet.

    The coordinates q are the place of the first toe and the angles of the bodies from upright, positive
    forwards. Forces of the ground on each foot are along it, up at the toe, and up at the heel.
    ``outline`` has the ways to the corners of a drawing.
    """

    bodies: list[Body]
    hinges: list[Hinge]
    feet: list[Foot]
    outline: list[Way]
    gravity_m_s2: float

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return 2 + len(self.bodies)

    @property
    def joints(self) -> list[Joint]:
        """The joints in the order of columns."""
        return [hinge.joint for hinge in self.hinges]

    @property
    def counts(self) -> list[int]:
        """Motors of each joint."""
        return [hinge.count for hinge in self.hinges]

    @property
    def mass_kg(self) -> float:
        """Mass of all bodies."""
        return sum(body.mass_kg for body in self.bodies)

    def angles(self, q: Any) -> Any:
        """Angles, or speeds, of the joints, a row each."""
        rows = [h.sign * (q[h.upper, :] - q[h.lower, :]) for h in self.hinges]
        return casadi().vertcat(*rows)

    def functions(self) -> dict[str, Any]:
        """CasADi functions of the coordinates q, speeds v, accelerations a, torques of one leg's joints and
        forces of the ground.

        ``dynamics``: (q, v, a, torque, force) → residual, N and Nm. ``blow``: (q, change of v, blow)
        → residual of the inelastic landing, Ns. ``com``: (q, v) → place and speed of the centre of
        mass, and angular momentum about it. ``shape``: (q) → corners of a drawing. ``motors``: (v, torque)
        → current and voltage of a motor, and power of all motors of a joint. ``foot``: (q, v, a) → place,
        speed and acceleration of the last toe, and place of its heel.
        """
        ca = casadi()
        q, v, a = (ca.SX.sym(name, self.size) for name in "qva")
        torque, force = ca.SX.sym("torque", len(self.hinges)), ca.SX.sym("force", 3 * len(self.feet))
        motions = self._residual(q, v, a, torque, force, self.gravity_m_s2)
        still, slack = ca.DM.zeros(self.size), ca.DM.zeros(len(self.hinges))
        blow = self._residual(q, still, a, slack, force, 0.0)
        shares = ca.DM([body.mass_kg / self.mass_kg for body in self.bodies])
        places = ca.horzcat(*(place(q, body.way) for body in self.bodies))
        speeds = ca.horzcat(*(speed(q, v, body.way) for body in self.bodies))
        centre, moving = ca.mtimes(places, shares), ca.mtimes(speeds, shares)
        spin: Any = 0
        for k, body in enumerate(self.bodies):
            arm, rate = places[:, k] - centre, speeds[:, k] - moving
            spin += body.inertia_kg_m2 * v[body.angle]
            spin += body.mass_kg * (arm[1] * rate[0] - arm[0] * rate[1])
        turns = self.angles(v)
        motors = [hinge.joint.motor(torque[k], turns[k]) for k, hinge in enumerate(self.hinges)]
        columns = [ca.vertcat(*column) for column in zip(*motors)]
        columns[2] *= ca.DM(self.counts)
        toe, heel = self.feet[-1].toe, self.feet[-1].heel
        last = [place(q, toe), speed(q, v, toe), acceleration(q, v, a, toe), place(q, heel)]
        outline = ca.horzcat(*(place(q, way) for way in self.outline))
        return {
            "dynamics": ca.Function("dynamics", [q, v, a, torque, force], [motions]),
            "blow": ca.Function("blow", [q, a, force], [blow]),
            "com": ca.Function("com", [q, v], [centre, moving, spin]),
            "shape": ca.Function("shape", [q], [outline]),
            "motors": ca.Function("motors", [v, torque], columns),
            "foot": ca.Function("foot", [q, v, a], last),
        }

    def _residual(self, q: Any, v: Any, a: Any, torque: Any, force: Any, gravity: float) -> Any:
        """Lagrange's equations: inertia and weight less torques and forces of the ground."""
        ca = casadi()
        out: list[Any] = [0] * self.size

        def pull(way: Way, push: Any) -> None:
            out[0] += push[0]
            out[1] += push[1]
            for angle, d in way:
                out[angle] += ca.dot(push, crossed(q[angle], d))

        for body in self.bodies:
            inertial = acceleration(q, v, a, body.way) + ca.vertcat(0, gravity)
            pull(body.way, body.mass_kg * inertial)
            out[body.angle] += body.inertia_kg_m2 * a[body.angle]
        for k, hinge in enumerate(self.hinges):
            joint = hinge.joint
            rotor = joint.gear**2 * joint.rotor_kg_m2 * (a[hinge.upper] - a[hinge.lower])
            turn = hinge.count * (rotor - hinge.sign * torque[k])
            out[hinge.upper] += turn
            out[hinge.lower] -= turn
        for k, foot in enumerate(self.feet):
            along, toe, heel = (force[3 * k + part] for part in range(3))
            pull(foot.toe, -ca.vertcat(along, toe))
            pull(foot.heel, -ca.vertcat(0, heel))
        return ca.vertcat(*out)


def turned(angle: Any, d: Sequence[float]) -> Any:
    """A vector that is fixed to a body, ahead and up, in the plane."""
    ca = casadi()
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(d[0] * c + d[1] * s, d[1] * c - d[0] * s)


def crossed(angle: Any, d: Sequence[float]) -> Any:
    """The derivative of :func:`turned` by the angle."""
    return turned(angle, (d[1], -d[0]))


def place(q: Any, way: Way) -> Any:
    """The end of a way."""
    return q[:2] + sum(turned(q[angle], d) for angle, d in way)


def speed(q: Any, v: Any, way: Way) -> Any:
    """Its speed."""
    return v[:2] + sum(v[angle] * crossed(q[angle], d) for angle, d in way)


def acceleration(q: Any, v: Any, a: Any, way: Way) -> Any:
    """Its acceleration."""
    out = a[:2]
    for angle, d in way:
        out += crossed(q[angle], d) * a[angle] - turned(q[angle], d) * v[angle] ** 2
    return out
