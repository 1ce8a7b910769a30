"""The gallery of hard cases: what each file of cases/hard must show, with the reason for every bound.

The bounds stand in `tolerances`, not in the files: a case says what is simulated, and both codes read it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exunet.case.stored_times import stored_times
from exunet.results.result import Result
from exunet.system.stability import largest_frequency, stable_step
from exunet.verification import tolerances as tol
from exunet.verification.check import Check
from exunet.verification.tolerances import Tolerance

Findings = Callable[[Any, Any], Iterator[Check]]

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


@dataclass(frozen=True)
class Hard:
    """A case of the gallery.

    item      : number in ITEMS
    case      : name of the file
    energy    : bound of the energy balance
    momentum, angular : bounds of the change of linear and angular momentum; None: something external acts
    short     : end [s] in the forms of the engine in which the whole run takes more than some minutes
    reference : how the reference runs it; a text says why it is out of its reach
    of_both   : further checks, from a result or the reference's states as one, and the start (or None)
    more      : further checks, from a result and the start
    """

    item: int
    case: str
    energy: Tolerance = tol.HARD_ADAPTIVE
    momentum: Tolerance | None = tol.HARD_MOMENTUM
    angular: Tolerance | None = tol.HARD_ANGULAR
    short: dict[str, float] = field(default_factory=dict)
    reference: dict[str, Any] | str = field(default_factory=dict)
    of_both: Findings | None = None
    more: Findings | None = None


def _drift(result: Any, _start: Any) -> Iterator[Check]:
    energy = _relative_energy(result)
    yield Check("energy drift per second", abs(float(np.polyfit(result.time, energy, 1)[0])), tol.HARD_DRIFT)


def _trend(result: Any, _start: Any) -> Iterator[Check]:
    energy = _relative_energy(result)
    seconds = np.diff(np.interp(np.arange(0.0, result.time[-1] + 0.5), result.time, energy))
    error = float(seconds.std(ddof=1)) / math.sqrt(len(seconds))
    yield Check("trend of the energy", abs(float(seconds.mean())) / error, tol.HARD_TREND)


def _relative_energy(result: Any) -> Any:
    energy = result.kinetic + result.elastic
    return energy / energy[0]


def _turns(result: Any, _start: Any) -> Iterator[Check]:
    node = int(np.argmax(np.linalg.norm(result.net.reference_position, axis=1)))
    angle = np.unwrap(np.arctan2(result.position[:, node, 1], result.position[:, node, 0]))
    turns = float(angle[-1] - angle[0]) / (2.0 * math.pi)
    yield Check("100 revolutions, turned", abs(turns - 100.0), tol.HARD_REVOLUTIONS)
    yield Check("slack elements", float((result.strain <= 0.0).sum()), tol.HARD_TAUT)


def _growth(result: Result, _start: Any) -> Iterator[Check]:
    energy = result.kinetic + result.elastic
    swing = float((energy - result.elastic[0]).max())
    yield Check("growth in 1e6 steps", swing / float(result.kinetic[0]), tol.HARD_GROWTH)


def _damping_sets(result: Result, start: Any) -> Iterator[Check]:
    alone = stable_step(start.plan.method, largest_frequency(start.system))
    yield Check("step that damping allows", float(start.plan.step / alone), tol.HARD_DAMPING_SETS)


def _stands(result: Result, _start: Any) -> Iterator[Check]:
    speed = np.linalg.norm(result.velocity, axis=-1).max(axis=1)
    yield Check("speed left", float(speed[-1] / speed[0]), tol.HARD_STOPPED)


def _every_step(result: Result, _start: Any) -> Iterator[Check]:
    steps = result.provenance["steps"]
    yield Check("states missing", float(abs(steps + 1 - len(result.time))), tol.HARD_NO_STATE_LOST)


def _times(result: Result, start: Any) -> Iterator[Check]:
    asked = stored_times(start.scene.time)
    yield Check("stored times", float(np.abs(result.time - asked).max()), tol.HARD_EXACT_TIMES)


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
        4, "long_undamped", tol.HARD_LONG, angular=tol.HARD_ANGULAR_FIXED, short={"connectors": 6.0},
        reference=COARSE, of_both=_drift, more=_trend,
    ),
    Hard(4, "spinning", tol.HARD_SMOOTH, angular=tol.HARD_ANGULAR_FIXED, reference=COARSE, of_both=_turns),
    Hard(
        6, "near_limit", tol.HARD_NEAR_LIMIT, momentum=None, angular=None, more=_growth,
        reference="10^6 steps of NumPy take a quarter of an hour",
    ),
    Hard(7, "strong_damping", tol.HARD_FIXED, angular=None, reference=COARSE, more=_damping_sets),
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
    Hard(10, "every_step", tol.HARD_FIXED, angular=tol.HARD_ANGULAR_FIXED, more=_every_step),
    Hard(10, "odd_times", tol.HARD_FIXED, angular=tol.HARD_ANGULAR_FIXED, more=_times),
)  # fmt: skip
