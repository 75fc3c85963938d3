"""Motions of a robot that its battery can power: trajectory optimisation with the model of the cell inside.

>>> from eisbench import motion
>>> pack = motion.Pack(model, series=16, parallel=3, soc=0.2)  # doctest: +SKIP
>>> jump = motion.jump(motion.Robot(), motion.Transient(pack))  # doctest: +SKIP
>>> print(jump.height_m)  # doctest: +SKIP

Needs CasADi, whose wheel contains the solver IPOPT.
"""

from ._laws import Free, Law, Pack, PowerLimit, SimpleIR, Transient
from ._problem import Options
from ._result import Motion
from ._robot import JOINTS, Joint, Link, Robot
from ._tasks import gap, jump, jump_to, walk

__all__ = [
    "JOINTS",
    "Free",
    "Joint",
    "Law",
    "Link",
    "Motion",
    "Options",
    "Pack",
    "PowerLimit",
    "Robot",
    "SimpleIR",
    "Transient",
    "gap",
    "jump",
    "jump_to",
    "walk",
]
