"""The scenes that rung 8 compares, and what it compares of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from exunet.studies.both_codes import BothCodes, read_both
from exunet.verification.at_states import measures
from exunet.verification.bodies.at_states import lines, motions, one_step, placed
from exunet.verification.check import Check, Evidence
from exunet.verification.growth import growth
from exunet.verification.horizon import sensitivity
from exunet.verification.shipped import shipped
from exunet.verification.topology import topology
from exunet.verification.trajectories import converged

BODY_CASES = "verification/bodies"  # of the known answers, below cases/
# Ends [s] of whole runs, where the reference takes minutes for the rest: threads that chatter against viscous
# stress; a taut tether for 24 s, of which the known answers have each command of its reel.
ENDS = {"bodies_frame": 0.5, "bodies_tow": 4.0}


@dataclass(frozen=True)
class BodyScene:
    """A scene with bodies, which is read when it is first looked at.

    name  : of its rows and figures
    path  : of the case file
    whole : it is followed over whole runs, and not by its known answer alone
    given : the case, where it is read already
    """

    name: str
    path: Path
    whole: bool = True
    given: BothCodes | None = None

    @cached_property
    def case(self) -> BothCodes:
        """In both codes, under this name."""
        return replace(self.given or read_both(self.path), name=self.name)

    def at_states(self, states_of_a_kind: int) -> Iterator[Check]:
        """Masses and start; random states: accelerations, books, what is attached, energies, one step."""
        yield from topology(self.case)
        yield from motions(self.case, states_of_a_kind)
        yield from lines(self.case, states_of_a_kind)
        yield from placed(self.case, states_of_a_kind)
        yield from measures(self.case, states_of_a_kind)
        yield from one_step(self.case)

    def trajectories(self) -> Iterator[Evidence]:
        """Rungs 5 and 7 for this scene, with its balances until the horizon, or until its entry of `ENDS`."""
        grown = growth(self.case, ENDS.get(self.name))
        yield from sensitivity(self.case, grown)
        yield from converged(self.case, grown)


def body_scenes(named: Sequence[BothCodes]) -> list[BodyScene]:
    """The named cases, those of cases/bodies/ that are not among them, and those of the known answers."""
    there = {case.path.resolve() for case in named}
    found = [BodyScene(case.name, case.path, given=case) for case in named]
    for folder, whole in (("bodies", True), (BODY_CASES, False)):
        for name, path in shipped(folder).items():
            if path.resolve() not in there:
                found.append(BodyScene(f"bodies_{name}" if whole else name, path, whole))
    return found
