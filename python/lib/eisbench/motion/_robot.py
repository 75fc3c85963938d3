"""The robot: a planar leg of the MIT Humanoid's size, its motors, and its equations of motion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from .._eisbench import EisError
from ._mechanics import Body, Foot, Hinge, Mechanics, Way, casadi

#: Joints of a leg in the order of columns: dorsiflexion of the ankle, flexion of knee and hip.
JOINTS = ("ankle", "knee", "hip")


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
    """A planar robot: foot, shank, thigh, trunk. Links of the leg and motors are those of one leg;
    ``legs`` counts them. They move as one, or two of them apart (:meth:`mechanics`)."""

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
    clearance_m: float = 0.03
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

    def mechanics(self, apart: bool = False) -> Mechanics:
        """Equations of motion with the coordinates: place of the toe, angles of foot, shank, thigh, trunk.

        With legs that move ``apart``, these are of the leg that stands; angles of thigh, shank and foot of
        the other follow.
        """
        if apart and self.legs != 2:
            raise EisError(f"Robot.legs: expected 2 to walk, met {self.legs!r}")
        count = 1 if apart else self.legs
        foot, shank, thigh, trunk = (
            (link.ahead_m, link.com_m) for link in (self.foot, self.shank, self.thigh, self.trunk)
        )
        ankle: Way = [(2, (-self.toe_m, self.foot.length_m))]
        knee: Way = [*ankle, (3, (0.0, self.shank.length_m))]
        hip: Way = [*knee, (4, (0.0, self.thigh.length_m))]
        shoulders: Way = [*hip, (5, (0.0, self.trunk.length_m))]
        heel: Way = [(2, (-self.foot_m, 0.0))]
        links = [
            (self.foot, 2, [(2, (foot[0] - self.toe_m, foot[1]))]),
            (self.shank, 3, [*ankle, (3, shank)]),
            (self.thigh, 4, [*knee, (4, thigh)]),
        ]
        hinges = [
            Hinge("ankle", self.ankle, 1, 3, 2, count),
            Hinge("knee", self.knee, -1, 4, 3, count),
            Hinge("hip", self.hip, 1, 5, 4, count),
        ]
        feet, outline = [Foot([], heel)], [heel, [], ankle, knee, hip, shoulders]
        if apart:
            # Downwards from the hip, each vector by the angle of its own body.
            other_knee: Way = [*hip, (6, (0.0, -self.thigh.length_m))]
            other_ankle: Way = [*other_knee, (7, (0.0, -self.shank.length_m))]
            toe: Way = [*other_ankle, (8, (self.toe_m, -self.foot.length_m))]
            other_heel: Way = [*other_ankle, (8, (-self.heel_m, -self.foot.length_m))]
            above = (0.0, -self.foot.length_m)
            links += [
                (self.thigh, 6, [*other_knee, (6, thigh)]),
                (self.shank, 7, [*other_ankle, (7, shank)]),
                (self.foot, 8, [*other_ankle, (8, above), (8, foot)]),
            ]
            hinges += [
                Hinge("swing_hip", self.hip, 1, 5, 6, 1),
                Hinge("swing_knee", self.knee, -1, 6, 7, 1),
                Hinge("swing_ankle", self.ankle, 1, 7, 8, 1),
            ]
            feet.append(Foot(toe, other_heel))
            outline += [hip, other_knee, other_ankle, toe, other_heel]
        bodies = [
            Body(count * link.mass_kg, count * link.inertia_kg_m2, angle, way)
            for link, angle, way in links
        ]
        trunk_body = Body(self.trunk.mass_kg, self.trunk.inertia_kg_m2, 5, [*hip, (5, trunk)])
        bodies.insert(3, trunk_body)
        return Mechanics(bodies, hinges, feet, outline, self.gravity_m_s2)

    @property
    def mass_kg(self) -> float:
        """Mass of the whole robot."""
        return self.mechanics().mass_kg

    @property
    def standing_m(self) -> float:
        """Height of the centre of mass of the upright robot with straight legs."""
        of = self.mechanics()
        return sum(b.mass_kg * sum(d[1] for _, d in b.way) for b in of.bodies) / of.mass_kg

    def functions(self) -> dict[str, Any]:
        """CasADi functions of the robot with both legs as one (:meth:`Mechanics.functions`)."""
        return self.mechanics().functions()
