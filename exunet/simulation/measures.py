"""Method and setting for solver.accuracy_of = "measures": cheap, and the measures of deployment are not shifted.

Beyond the horizon of predictability a run is one draw of many, however small its error: only the distribution
of a measure can be right. Velocity Verlet is symplectic and errs in the energy by little and without drift, so
that at a fifth of its stable step the distribution is that of tight runs, as benchmarks/measures.md shows.
The stable step follows from stiffness, lumped masses and damping, which set how long a snap takes: one number
for all nets. Where velocity Verlet is not of order 2, loosely set Dormand-Prince steps do the same.

measures_table.toml has the two settings; benchmarks/measures.py tests them, and writes what it found.
"""

from __future__ import annotations

import functools
import tomllib
from dataclasses import dataclass
from pathlib import Path

from exunet.methods.method import Method
from exunet.system.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.system.system import System


@dataclass(frozen=True)
class Settings:
    """What measures_table.toml has.

    step         : of VelocityVerlet, over its stable step
    most_damping : damping rate [1/s] times that step up to which VelocityVerlet was measured
    tolerance    : of DOPRI5, over the launch speed
    scenes       : number of scenes that were measured
    before       : largest error of a measure, as a part of its value, where the end lies before the horizon
    """

    step: float
    most_damping: float
    tolerance: float
    scenes: int
    before: float


@functools.cache
def settings() -> Settings:
    """The stored settings."""
    read = tomllib.loads(Path(__file__).with_name("measures_table.toml").read_text(encoding="utf-8"))
    return Settings(**read)


def verlet_step(system: System) -> float:
    """The step [s] of VelocityVerlet for measures."""
    frequency, rate = largest_frequency(system), largest_damping_rate(system)
    return settings().step * stable_step(Method.VELOCITY_VERLET, frequency, rate)


def why_not_verlet(system: System) -> str:
    """Why VelocityVerlet was not measured for such a system, or is not of order 2 for it; "" if it was."""
    if not largest_frequency(system):
        return "nothing oscillates, from which a step would follow"
    if system.bodies:
        return "bodies turn"
    if system.blocks.states:
        return "there are first-order states"
    if system.memory:
        return "the forces change at events"
    if largest_damping_rate(system) * verlet_step(system) > settings().most_damping:
        return "the damping is strong"
    return ""


def promise() -> str:
    """What is promised, in words."""
    found = settings()
    return (
        "promised for the measures of deployment: beyond the horizon of predictability a median within a third "
        f"of their spread, before it {found.before:g} of their value ({found.scenes} scenes, "
        "benchmarks/measures.md); not the trajectory"
    )
