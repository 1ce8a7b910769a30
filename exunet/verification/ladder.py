"""The ladder: its rungs in order, as steps that can be run one by one."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from exunet.base.errors import InputError
from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend
from exunet.studies.both_codes import BothCodes, NotCovered, read_both
from exunet.studies.perturbation import MOVE
from exunet.verification import closing, contact, horizon, matrices, one_step, states, together, topology
from exunet.verification.answers import ANSWERS, BODY_ANSWERS, Answer
from exunet.verification.balances import converged
from exunet.verification.bodies import BODY_CASES, STATES, body_scenes
from exunet.verification.check import Check, Evidence, left_out, shipped, shipped_case
from exunet.verification.one_step import Step

RUNGS = {
    1: "Topology and mass",
    2: "Forces at given states",
    3: "Matrices",
    4: "One step, then many, with the same scheme",
    5: "Converged trajectories",
    6: "Known answers",
    7: "Horizon",
    8: "Bodies",
    9: "Contact",
    10: "Closing",
}
MOST_ELEMENTS = 2000  # larger nets are compared at given states and over one step, not over whole runs
# The paper's case, with its damping, without, and packed as the paper says elsewhere.
PAPER = ("planar_deployment", "planar_undamped", "planar_deployment_006")
LONG_ANSWERS = {"snap_from_slack"}
QUICK_PART = 0.5  # of the run that --quick follows
WHOLE_RUNS = "rungs 4, 5 and 7"
QUICK_STATES = 10  # of each kind of states of bodies, and in contact


def read_cases(paths: Sequence[Path]) -> list[BothCodes]:
    """The cases in both codes; the shipped ones if none is named.

    Raises InputError for the first that the reference does not know, and for two of one name: rows and
    figures go by it.
    """
    paths = paths or (*shipped().values(), *shipped("verification/trajectories").values())
    named: dict[str, Path] = {}
    for path in paths:
        if (first := named.setdefault(path.stem, path)) is not path:
            raise InputError(f"two cases are called {path.stem}, {first} and {path}: rename one")
    return [read_both(path) for path in paths]


@dataclass(frozen=True)
class Followed:
    """What is done of the whole runs of a case.

    quick     : they end early, and many runs are left out
    many      : what perturbed runs have in common is looked at
    both      : and compared between the codes
    """

    quick: bool
    many: bool
    both: bool


def whole_runs(case: BothCodes, how: Followed) -> Iterator[Evidence]:
    """Rungs 4, 5 and 7 of a case: its motion is followed once for all of them."""
    if (count := case.start.net.n_elements) > MOST_ELEMENTS:
        why = f"for up to {MOST_ELEMENTS} elements, not {count}"
        yield left_out(f"whole runs and horizon, {WHOLE_RUNS}", why)
        return
    end = case.start.scene.time.end
    quick_end = QUICK_PART * end
    grown = horizon.growth(case, *((quick_end, (horizon.ROUND_OFF, MOVE)) if how.quick else ()))
    reached = float(grown.time[-1])
    if reached < 0.999 * end:
        why = f"more than {horizon.MOST_WORK:.0e} elements x steps"
        if how.quick and reached == quick_end:
            why = "--quick goes no further"
        yield left_out(f"whole runs from t = {reached:.3g} s on, of {end:g} s: {WHOLE_RUNS}", why)
    yield from one_step.same_scheme(case, grown)
    yield from _of_rung(5, converged(case, grown))
    yield from _of_rung(7, horizon.sensitivity(case, grown))
    if how.quick:
        why = "--quick leaves out many runs"
        yield from _of_rung(7, [left_out("what perturbed runs have in common", why)])
        return
    if how.many:
        yield from _of_rung(7, horizon.after_it(case, grown, how.both))


def _of_rung(rung: int, findings: Iterable[Evidence]) -> Iterator[Evidence]:
    return (replace(finding, rung=rung) for finding in findings)


class Ladder:
    """The rungs over some cases.

    cases : those with forces on rigid bodies are compared in rungs 1 and 8 only, others whose mouth something
            closes in rungs 1 and 10, those whose threads touch each other in rung 1 only: rung 9 has a net
            for what touching threads do, since random states of other nets have no such pairs
    quick : one case only for what takes whole runs, fewer random nets; rungs 1 to 3 are the same
    paper : also check that round-off alone separates the bullets of the paper's nets
    different: names of cases whose nets are known to differ; `nets` adds to them
    Raises InputError without the cases of the known answers.
    """

    def __init__(
        self, cases: Sequence[BothCodes], *, quick: bool, paper: bool, different: Collection[str] = ()
    ) -> None:
        self._named, self._quick, self._paper = cases, quick, paper
        self._cases = [
            case for case in cases if not (case.moves_bodies or case.closes or case.touches_itself)
        ]
        self.different = set(different)

    def nets(self) -> Iterator[Step]:
        """Rung 1 of each case: what comes later leaves out a case whose nets differ."""
        for case in self._named:
            yield Step(1, case.name, partial(self._topology, case))

    def later(self) -> Iterator[Step]:
        """All further steps, once those have run; none depends on what another one finds."""
        count = 30 if self._quick else 300
        yield Step(1, f"{count} random nets", partial(topology.random_topologies, count))
        yield from self._states()
        yield from self._runs()
        yield from self._answers()
        yield from self._bodies()
        yield from self._contacts()
        yield from self._closings()

    def _states(self) -> Iterator[Step]:
        for case in self._forms():
            yield Step(2, case.name, partial(states.forces, case))
        for case in self._same_nets():  # what is measured at a state is the same in all forms
            yield Step(2, case.name, partial(states.measures, case))
        for case in self._forms():
            yield Step(3, case.name, partial(matrices.matrices, case))
        for case in self._forms(in_time=True):
            yield Step(4, case.name, partial(one_step.one_step, case))

    def _topology(self, case: BothCodes) -> Iterator[Check]:
        for check in topology.topology(case):
            if not check.holds:
                self.different.add(case.name)
            yield check

    def _same_nets(self) -> list[BothCodes]:
        """Cases whose nets are the same in both codes: only these can be compared further."""
        return [case for case in self._cases if case.name not in self.different]

    def _forms(self, *, in_time: bool = False) -> list[BothCodes]:
        """Return the cases in Exudyn and, for steps in time and with Numba, in the compiled loop."""
        cases = self._same_nets()
        if not (in_time and numba_installed()):
            return cases
        return [*cases, *(case.on_backend(Backend.COMPILED) for case in cases)]

    def _runs(self) -> Iterator[Step]:
        for number, case in enumerate(self._same_nets()):
            if number == 0 or not self._quick:
                yield Step(4, case.name, partial(whole_runs, case, self._followed(case)))
            else:
                yield _without(4, case.name, f"whole runs and horizon, {WHOLE_RUNS}", "follows one case")
            if self._paper and not self._quick and case.name in PAPER:
                yield Step(7, case.name, partial(matrices.symmetry, case))

    def _followed(self, case: BothCodes) -> Followed:
        """How far; of the paper's nets the two that are known to separate are run many times."""
        many = case.name in PAPER[:2] if self._paper else True
        return Followed(self._quick, many, both=case.name not in PAPER[1:])

    def _answers(self) -> Iterator[Step]:
        for name, answer in ANSWERS:
            if self._quick and name in LONG_ANSWERS:
                yield _without(6, name, "the known answers of this case", "leaves out the long ones")
            else:
                yield Step(6, name, partial(_known, name, answer))

    def _bodies(self) -> Iterator[Step]:
        """The scenes of rung 8, the known answers of bodies, and what takes whole runs."""
        named = [case for case in self._named if case.moves_bodies and case.name not in self.different]
        states = QUICK_STATES if self._quick else STATES
        scenes = []
        for scene in body_scenes(named):
            try:
                _ = scene.case  # which is read here
                scenes.append(scene)
            except NotCovered as refused:
                yield Step(8, scene.name, partial(iter, [left_out("all of it", str(refused))]))
        for scene in scenes:
            yield Step(8, scene.name, partial(scene.at_states, states))
        for name, answer in BODY_ANSWERS:
            yield Step(8, name, partial(_known, name, answer, BODY_CASES))
        runs = [scene for scene in scenes if scene.whole]
        if self._quick:
            yield _without(8, ", ".join(scene.name for scene in runs), "whole runs", "leaves out whole runs")
            return
        for scene in runs:
            yield Step(8, scene.name, scene.trajectories)

    def _contacts(self) -> Iterator[Step]:
        """The scenes of rung 9: what contact does at states, and whole runs."""
        states = QUICK_STATES if self._quick else contact.STATES
        for name in shipped(contact.CONTACT_CASES):
            yield Step(9, name, partial(_in_contact, name, contact.at_states, states))
            if self._quick:
                yield _without(9, name, "whole runs", "leaves out whole runs")
            else:
                yield Step(9, name, partial(_in_contact, name, contact.over_a_run))
        for name in shipped(together.TOGETHER_CASES):
            case = read_both(shipped_case(together.TOGETHER_CASES, name))
            yield Step(9, name, partial(together.at_states, case, states))
            yield Step(9, name, partial(together.over_a_run, case))
        for case in self._named:
            if case.touches_itself:
                yield Step(9, case.name, partial(iter, [left_out("all of it", together.OF_OTHER_NETS)]))

    def _closings(self) -> Iterator[Step]:
        """The scenes of rung 10: what closes a mouth, at states and over whole runs."""
        closed = [case for case in self._named if case.closes and not case.moves_bodies]
        states = QUICK_STATES if self._quick else STATES
        for case in closing.closing_cases([case for case in closed if case.name not in self.different]):
            yield Step(10, case.name, partial(closing.at_states, case, states))
            if self._quick:
                yield _without(10, case.name, "whole runs", "leaves out whole runs")
            else:
                yield Step(10, case.name, partial(closing.over_a_run, case))


def later_steps(paths: Sequence[Path], quick: bool, different: Collection[str]) -> list[Step]:
    """What follows rung 1 on the cases of these files (none: the shipped ones): see `Ladder.later`."""
    return list(Ladder(read_cases(paths), quick=quick, paper=not paths, different=different).later())


def _in_contact(name: str, checks: Callable[..., Iterator[Check]], *how: int) -> Iterator[Check]:
    return checks(read_both(shipped_case(contact.CONTACT_CASES, name)), *how)


def _without(rung: int, subject: str, what: str, why: str) -> Step:
    """A step of which --quick makes one row: what it leaves out."""
    return Step(rung, subject, partial(iter, [left_out(what, f"--quick {why}")]))


def _known(name: str, answer: Answer, folder: str = "verification") -> Iterator[Evidence]:
    return answer(read_both(shipped_case(folder, name)))
