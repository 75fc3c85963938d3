"""The robot: a planar leg of the MIT Humanoid's size, its motors, and its equations of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from .._eisbench import EisError
from .._optional import optional

#: Joints in the order of every column: the angle of the upper body less that of the lower, or the opposite.
JOINTS = ("ankle", "knee", "hip")
SIGNS = (1, -1, 1)


def casadi() -> Any:
    """CasADi, whose wheel contains IPOPT."""
    return optional("casadi", "'eisbench[motion]'")


def positive(owner: object, *zero: str) -> None:
    """Checks that the numbers of a dataclass are positive, or not negative for those named ``zero``."""
    for field in fields(owner):  # type: ignore[arg-type]
        value = getattr(owner, field.name)
        if not isinstance(value, (int, float)) or field.name.endswith("_rad"):
            continue
        if not (value > 0 or (field.name in zero and value == 0)):
            expected = "0 or more" if field.name in zero else "a positive number"
            raise EisError(
                f"{type(owner).__name__}.{field.name}: expected {expected}, met {value!r}"
            )


@dataclass(frozen=True)
class Link:
    """A body of one leg, or the trunk: mass, moment of inertia about its centre of mass, length to the
    next joint, and the centre of mass above (``com_m``) and before (``ahead_m``) the joint below.
    """

    mass_kg: float
    inertia_kg_m2: float
    length_m: float
    com_m: float
    ahead_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass_kg", "inertia_kg_m2", "length_m"):
            value = getattr(self, name)
            if not value > 0:
                raise EisError(f"Link.{name}: expected a positive number, met {value!r}")


@dataclass(frozen=True)
class Joint:
    """A joint with one motor per leg. ``k_nm_per_a`` and ``r_ohm`` are those of the direct-current
    motor that equals the three-phase motor at its bus; friction acts at the joint."""

    gear: float
    torque_nm: float
    speed_rad_s: float
    k_nm_per_a: float
    r_ohm: float
    rotor_kg_m2: float
    low_rad: float
    high_rad: float
    damping_nm_s: float = 0.1
    friction_nm: float = 1.0

    def __post_init__(self) -> None:
        positive(self, "rotor_kg_m2", "damping_nm_s", "friction_nm")
        if not self.low_rad < self.high_rad:
            met = f"{self.low_rad!r} and {self.high_rad!r}"
            raise EisError(f"Joint.low_rad: expected less than high_rad, met {met}")

    def motor(self, torque_nm: Any, speed_rad_s: Any) -> tuple[Any, Any, Any]:
        """Current, voltage and power of one motor for a torque and a speed of the joint."""
        # Dry friction is smoothed over 0.5 rad/s.
        ca = casadi()
        dry_nm = self.friction_nm * speed_rad_s / ca.sqrt(speed_rad_s**2 + 0.25)
        inner_nm = torque_nm + self.damping_nm_s * speed_rad_s + dry_nm
        current_a = inner_nm / (self.gear * self.k_nm_per_a)
        voltage_v = self.r_ohm * current_a + self.k_nm_per_a * self.gear * speed_rad_s
        return current_a, voltage_v, voltage_v * current_a


# Sources of the numbers: docs/motion.md. The windings are those of T-Motor U10 II and U12 II, wound for
# the published speed at 60 V.
_FOOT = Link(0.280951, 0.0007959, 0.041, 0.028174, 0.022623)
_SHANK = Link(0.3543355, 0.003033, 0.2785, 0.14649)
_THIGH = Link(2.64093, 0.0259015, 0.267, 0.170979)
_TRUNK = Link(18.316, 0.3652, 0.3789, 0.1928)
_ANKLE = Joint(9.33, 52.2, 35.0, 0.1818, 0.366, 1.6841e-4, -0.9, 1.0)
_KNEE = Joint(12.0, 136.0, 22.5, 0.2222, 0.1715, 5.548e-4, 0.1, 2.4)
_HIP = Joint(6.0, 68.0, 45.0, 0.2222, 0.1715, 5.548e-4, -0.3, 2.4)


@dataclass(frozen=True)
class Robot:
    """A planar robot with both legs as one: foot, shank, thigh, trunk. Links of the leg and motors
    are those of one leg; ``legs`` counts them.

    The coordinates are the place of the toe and the angles of foot, shank, thigh and trunk from upright,
    positive forwards.
    """

    foot: Link = _FOOT
    shank: Link = _SHANK
    thigh: Link = _THIGH
    trunk: Link = _TRUNK
    ankle: Joint = _ANKLE
    knee: Joint = _KNEE
    hip: Joint = _HIP
    toe_m: float = 0.1
    heel_m: float = 0.05
    legs: int = 2
    ground_friction: float = 0.7
    electronics_w: float = 80.0
    trunk_lean_rad: float = 1.0
    gravity_m_s2: float = 9.81

    def __post_init__(self) -> None:
        positive(self, "electronics_w")

    @property
    def joints(self) -> tuple[Joint, Joint, Joint]:
        """The joints in the order of columns."""
        return self.ankle, self.knee, self.hip

    @property
    def foot_m(self) -> float:
        """Length of the foot, heel to toe."""
        return self.toe_m + self.heel_m

    def bodies(self) -> list[tuple[float, float, list[tuple[float, float]]]]:
        """Of each body, from the foot: mass, inertia, and the vectors along the bodies from the toe to
        its centre of mass."""
        ankle = (-self.toe_m, self.foot.length_m)
        links = (self.foot, self.shank, self.thigh, self.trunk)
        joints = [ankle, *((0.0, link.length_m) for link in links[1:3])]
        out: list[tuple[float, float, list[tuple[float, float]]]] = []
        for k, link in enumerate(links):
            count = 1 if link is self.trunk else self.legs
            com = (link.ahead_m, link.com_m)
            if k == 0:
                com = (com[0] - self.toe_m, com[1])
            out.append((count * link.mass_kg, count * link.inertia_kg_m2, [*joints[:k], com]))
        return out

    @property
    def mass_kg(self) -> float:
        """Mass of the whole robot."""
        return sum(mass for mass, _, _ in self.bodies())

    @property
    def standing_m(self) -> float:
        """Height of the centre of mass of the upright robot with straight legs."""
        return sum(m * sum(z for _, z in way) for m, _, way in self.bodies()) / self.mass_kg

    def functions(self) -> dict[str, Any]:
        """CasADi functions of the coordinates q, speeds v, accelerations a, torques of one leg and
        forces of the ground on the robot (along it, up at the toe, up at the heel).

        ``dynamics``: (q, v, a, torque, force) → residual, N and Nm. ``blow``: (q, change of v, blow)
        → residual of the inelastic landing, Ns. ``com``: (q, v) → place and speed of the centre of
        mass, and angular momentum about it. ``shape``: (q) → heel, toe, ankle, knee, hip, shoulders.
        ``motors``: (v, torque) → current and voltage of a motor, and power of all motors of a joint.
        """
        ca = casadi()
        q, v, a = (ca.SX.sym(name, 6) for name in "qva")
        torque, force = ca.SX.sym("torque", 3), ca.SX.sym("force", 3)
        motions = self._residual(q, v, a, torque, force, self.gravity_m_s2)
        blow = self._residual(q, ca.DM.zeros(6), a, ca.DM.zeros(3), force, 0.0)
        places: list[Any] = []
        speeds: list[Any] = []
        masses: list[float] = []
        spin: Any = 0
        for k, (mass, inertia, way) in enumerate(self.bodies()):
            masses.append(mass / self.mass_kg)
            places.append(q[:2] + sum(turned(q[2 + j], d) for j, d in enumerate(way)))
            speeds.append(v[:2] + sum(v[2 + j] * crossed(q[2 + j], d) for j, d in enumerate(way)))
            spin += inertia * v[2 + k]
        place, speed = (ca.mtimes(ca.horzcat(*each), ca.DM(masses)) for each in (places, speeds))
        for share, at, moving in zip(masses, places, speeds):
            arm, rate = at - place, moving - speed
            spin += share * self.mass_kg * (arm[1] * rate[0] - arm[0] * rate[1])
        corners = [q[:2] + turned(q[2], (-self.foot_m, 0.0)), q[:2]]
        for k, d in enumerate([*self.bodies()[3][2][:3], (0.0, self.trunk.length_m)]):
            corners.append(corners[-1] + turned(q[2 + k], d))
        turns = joint_angles(v)
        motors = [j.motor(torque[k], turns[k]) for k, j in enumerate(self.joints)]
        columns = [ca.vertcat(*column) for column in zip(*motors)]
        columns[2] *= self.legs
        return {
            "dynamics": ca.Function("dynamics", [q, v, a, torque, force], [motions]),
            "blow": ca.Function("blow", [q, a, force], [blow]),
            "com": ca.Function("com", [q, v], [place, speed, spin]),
            "shape": ca.Function("shape", [q], [ca.horzcat(*corners)]),
            "motors": ca.Function("motors", [v, torque], columns),
        }

    def _residual(self, q: Any, v: Any, a: Any, torque: Any, force: Any, gravity: float) -> Any:
        """Lagrange's equations: inertia and weight less torques and forces of the ground."""
        ca = casadi()
        out = [-force[0], -force[1] - force[2], 0, 0, 0, 0]
        for k, (mass, inertia, way) in enumerate(self.bodies()):
            push = a[:2] + ca.vertcat(0, gravity)
            for j, d in enumerate(way):
                push += crossed(q[2 + j], d) * a[2 + j] - turned(q[2 + j], d) * v[2 + j] ** 2
            push *= mass
            out[0] += push[0]
            out[1] += push[1]
            out[2 + k] += inertia * a[2 + k]
            for j, d in enumerate(way):
                out[2 + j] += ca.dot(push, crossed(q[2 + j], d))
        for k, (joint, sign) in enumerate(zip(self.joints, SIGNS)):
            rotor = joint.gear**2 * joint.rotor_kg_m2 * (a[3 + k] - a[2 + k])
            turn = self.legs * (rotor - sign * torque[k])
            out[3 + k] += turn
            out[2 + k] -= turn
        heel = crossed(q[2], (-self.foot_m, 0.0))
        out[2] -= heel[1] * force[2]
        return ca.vertcat(*out)


def turned(angle: Any, d: Sequence[float]) -> Any:
    """A vector that is fixed to a body, ahead and up, in the plane."""
    ca = casadi()
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(d[0] * c + d[1] * s, d[1] * c - d[0] * s)


def crossed(angle: Any, d: Sequence[float]) -> Any:
    """The derivative of :func:`turned` by the angle."""
    return turned(angle, (d[1], -d[0]))


def joint_angles(q: Any) -> Any:
    """Angles, or speeds, of the joints, a row each: dorsiflexion of the ankle, flexion of knee and hip."""
    return casadi().vertcat(*(sign * (q[3 + k, :] - q[2 + k, :]) for k, sign in enumerate(SIGNS)))
