"""Method and setting for solver.accuracy_of = "measures": cheap, without a shift of the deployment measures.

Beyond the horizon of predictability a run is one draw of many, however small its error: only the
distribution of a measure can be right. An error acts as a move of the start does, but sooner. Large nets
have so many snaps that the motion has forgotten both when it opens: velocity Verlet, symplectic and
without a drift of the energy, at a fifth of its stable step has the distribution of tight runs. The
stable step follows from stiffness, lumped masses and damping, which set how long a snap takes, so that
one number holds for all of them. Small nets may open soon after their horizon, where such errors shift
the measures: they take Dormand-Prince steps with the tolerance of accuracy 1e-3, which before the horizon
is the error of the trajectory.

measures_table.toml has the settings; benchmarks/measures.py tests them, and writes what it found.
"""

from __future__ import annotations

import functools
import tomllib
from dataclasses import dataclass
from pathlib import Path

from exunet.methods.method import Method
from exunet.net.arrays import Net
from exunet.system.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.system.system import System


@dataclass(frozen=True)
class Settings:
    """What measures_table.toml has.

    step         : of VelocityVerlet, over its stable step
    most_damping : damping rate [1/s] times that step up to which VelocityVerlet was measured
    least_elements : of a net that takes VelocityVerlet
    tolerance    : of DOPRI5, over the launch speed
    """

    step: float
    most_damping: float
    least_elements: int
    tolerance: float
    move: float


@functools.cache
def settings() -> Settings:
    """The stored settings."""
    read = tomllib.loads(Path(__file__).with_name("measures_table.toml").read_text(encoding="utf-8"))
    return Settings(**read)


def verlet_step(system: System) -> float:
    """The step [s] of VelocityVerlet for measures."""
    frequency, rate = largest_frequency(system), largest_damping_rate(system)
    return settings().step * stable_step(Method.VELOCITY_VERLET, frequency, rate)


def move_of_starts(net: Net) -> float:
    """By which starts are moved at most, in each coordinate [m], for medians that do not depend on a method.

    All runs of a method share its errors, which act as one move of the start does. Where a scene ends soon
    after its horizon, runs from starts that are moved by less stay near to each other, and far from those of
    another method, tight ones too.
    """
    return settings().move * net.size


def why_not_verlet(system: System) -> str:
    """Why VelocityVerlet was not measured for such a system, or is not of order 2 for it; "" if it was."""
    if system.net.n_elements < settings().least_elements:
        return f"fewer than {settings().least_elements} elements"
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


def promise(method: Method, net: Net) -> str:
    """What is promised, in words."""
    words = (
        "promised, as measured (benchmarks/measures.md): beyond the horizon of predictability medians of the "
        f"measures of deployment, of starts moved by up to {move_of_starts(net):.2g} m, within a third of "
        "their spread"
    )
    before = "before it measures to 1e-3" if method == Method.DOPRI5 else "nothing before it"
    return f"{words}; {before}; not the trajectory"
