"""The gallery of hard cases: what each file of cases/hard must show, with the reason for every bound.

The bounds stand here, not in the files: a case says what is simulated, and both codes read it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exunet.build import prepare
from exunet.result import Result
from exunet.stability import largest_frequency, stable_step
from exunet.times import stored_times
from exunet.verify.tolerances import Tolerance

Finding = tuple[str, float, Tolerance | None]
More = Callable[[Result, Any], Iterator[Finding]]

ITEMS = {
    1: "Coincident nodes",
    2: "Packed tightly, slack, overstretched",
    3: "Masses and stiffnesses far apart",
    4: "Long runs",
    5: "Implicit methods at steps too long for them",
    6: "Around the stable step",
    7: "Strong damping",
    8: "Sizes and topologies",
    9: "Fast, taut and long",
    10: "Stored times",
}

ADAPTIVE = Tolerance(
    1e-3,
    "of E0",
    "accuracy 1e-5 of the launch speed; the energy takes the errors of all snaps, 1.6e-4 at most was seen",
)
FIXED = Tolerance(1e-3, "of E0", "a tenth of the stable step and less; 5e-5 was seen")
LONG = Tolerance(
    1e-2,
    "of E0",
    "each snap adds an error of either sign; at this step 4e-3 was the farthest that 60 s of them walked",
)
SMOOTH = Tolerance(1e-4, "of E0", "taut throughout, so RK44 has its order; 1.4e-5 over 1e5 steps was seen")
NEAR_LIMIT = Tolerance(
    1e-3,
    "of E0",
    "nearly all of E0 is the prestress; what oscillates is a part of 1e-5, times 50 (see below)",
)
MOMENTUM = Tolerance(1e-12, "of sum m|v|", "internal forces cancel in pairs: round-off, 6e-15 seen")
ANGULAR = Tolerance(
    1e-10,
    "of sum m|x||v|",
    "central forces, whose moments no Runge-Kutta method cancels exactly; 6e-14 seen",
)
ANGULAR_FIXED = Tolerance(
    1e-8, "of sum m|x||v|", "kept to the order of RK44 at a hundred steps a period, 7e-10 seen"
)
DRIFT = Tolerance(2e-4, "of E0 / s", "the slope of a straight line through the energy of 60 s; 2e-5 was seen")
TREND = Tolerance(
    3.0,
    "sigma",
    "mean change of the energy in a second over its standard error: a walk without a trend stays below",
)
REVOLUTIONS = Tolerance(
    0.5, "revolutions", "of 100: the net's radius and with it its rate swing by 2e-3 as it stretches"
)
TAUT = Tolerance(0.0, "", "its rotation holds every element taut at every stored time")
GROWTH = Tolerance(
    60.0,
    "x",
    "largest kinetic energy over that of the start: velocity Verlet keeps v^2 + w^2 (1 - (w h / 2)^2) x^2, "
    "so at 0.99 of the limit that of the fastest mode may swing by 1 / (1 - 0.99^2) = 50; if it grew, it "
    "would overflow",
)
DAMPING_SETS = Tolerance(0.5, "x", "the step over the one that the frequencies alone would allow")
STOPPED = Tolerance(1e-6, "of v0", "exp(-50) = 2e-22 of the speed is left, beside errors of the tolerance")
NO_STATE_LOST = Tolerance(0.0, "states", "one for each step, and the start")
EXACT_TIMES = Tolerance(0.0, "s", "stored times are those asked for, to the last bit")
POSITIONS = Tolerance(
    1e-3,
    "m",
    "RK44 at a tenth of its stable step, 0.08 s after the first snap: speeds are off by 1e-3; 2e-4 was seen",
)


@dataclass(frozen=True)
class Hard:
    """A case of the gallery.

    item      : number in ITEMS
    case      : name of the file
    energy    : bound of the energy balance
    momentum, angular : bounds of the change of linear and angular momentum; None: something external acts
    short     : overrides that shorten the run in the engine, where it takes a hundred times as long as in the
                compiled loop
    reference : how the reference runs it; a text says why it is out of its reach
    more      : further findings, from the result and the start
    """

    item: int
    case: str
    energy: Tolerance = ADAPTIVE
    momentum: Tolerance | None = MOMENTUM
    angular: Tolerance | None = ANGULAR
    short: tuple[str, ...] = ()
    reference: dict[str, Any] | str = field(default_factory=dict)
    more: More | None = None


def _drift(result: Result, _start: Any) -> Iterator[Finding]:
    if result.time[-1] < 60.0:  # a walk of a few steps has a slope of its own
        return
    energy = result.kinetic + result.elastic
    energy = energy / energy[0]
    yield "energy drift per second", abs(float(np.polyfit(result.time, energy, 1)[0])), DRIFT
    seconds = np.diff(np.interp(np.arange(0.0, result.time[-1] + 0.5), result.time, energy))
    error = float(seconds.std(ddof=1)) / math.sqrt(len(seconds))
    yield "trend of the energy", abs(float(seconds.mean())) / error, TREND


def _turns(result: Result, _start: Any) -> Iterator[Finding]:
    node = int(np.argmax(np.linalg.norm(result.net.reference_position, axis=1)))
    angle = np.unwrap(np.arctan2(result.position[:, node, 1], result.position[:, node, 0]))
    turns = float(angle[-1] - angle[0]) / (2.0 * math.pi)
    yield "100 revolutions, turned", abs(turns - 100.0), REVOLUTIONS
    yield "slack elements", float((result.strain <= 0.0).sum()), TAUT


def _growth(result: Result, _start: Any) -> Iterator[Finding]:
    yield "growth in 1e6 steps", float(result.kinetic.max() / result.kinetic[0]), GROWTH


def _damping_sets(result: Result, start: Any) -> Iterator[Finding]:
    alone = stable_step(start.plan.method, largest_frequency(start.net, start.terms))
    yield "step that damping allows", float(start.plan.step / alone), DAMPING_SETS


def _stands(result: Result, _start: Any) -> Iterator[Finding]:
    speed = np.linalg.norm(result.velocity, axis=-1).max(axis=1)
    yield "speed left", float(speed[-1] / speed[0]), STOPPED


def _every_step(result: Result, _start: Any) -> Iterator[Finding]:
    steps = result.provenance["steps"]
    yield "states missing", float(abs(steps + 1 - len(result.time))), NO_STATE_LOST


def _times(result: Result, start: Any) -> Iterator[Finding]:
    asked = stored_times(start.scene.time)
    yield "stored times", float(np.abs(result.time - asked).max()), EXACT_TIMES


COARSE = {"method": "EM", "step": 0.01}
FINE = {"method": "EM", "step": 1e-3}

GALLERY = (
    Hard(1, "all_in_one_point"),
    Hard(1, "folded", reference=FINE),
    Hard(2, "packed_001"),
    Hard(2, "slack"),
    Hard(2, "overstretched"),
    Hard(3, "heavy_bullets", reference=FINE),
    Hard(3, "stiff_strings"),
    Hard(3, "soft_threads"),
    Hard(
        4, "long_undamped", LONG, angular=ANGULAR_FIXED, more=_drift,
        short=("time.end=6.0",), reference=COARSE,
    ),
    Hard(4, "spinning", SMOOTH, angular=ANGULAR_FIXED, reference=COARSE, more=_turns),
    Hard(
        6, "near_limit", NEAR_LIMIT, momentum=None, angular=None, more=_growth,
        reference="10^6 steps of NumPy take a quarter of an hour",
    ),
    Hard(7, "strong_damping", FIXED, angular=None, reference=COARSE, more=_damping_sets),
    Hard(7, "stopped_by_alpha", momentum=None, angular=None, more=_stands),
    Hard(8, "mesh_1x1"),
    Hard(8, "mesh_1x20"),
    Hard(8, "mesh_50x50", reference=FINE),
    Hard(8, "divided_by_10"),
    Hard(8, "one_element"),
    Hard(8, "two_nets"),
    Hard(9, "launch_250"),
    Hard(9, "taut_string"),
    Hard(9, "tether"),
    Hard(10, "every_step", FIXED, angular=ANGULAR_FIXED, more=_every_step),
    Hard(10, "odd_times", FIXED, angular=ANGULAR_FIXED, more=_times),
)  # fmt: skip


def above_limit(scene: Any) -> float:
    """1.02 of the stable step [s] of a scene's method."""
    start = prepare(scene)
    return 1.02 * stable_step(start.plan.method, largest_frequency(start.net, start.terms))
