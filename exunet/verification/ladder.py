"""The ladder: its rungs in order, as steps that can be run one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import reference_impl as reference
from exunet.backends.exudyn.stepper import EngineFailed
from exunet.base.errors import ExunetError, InputError, Interrupted
from exunet.studies.both_codes import Pair, read_pair
from exunet.verification.check import Check, Finding, left_out
from exunet.verification.growth import Growth
from exunet.verification.tolerances import RAN

RUNGS = {
    1: "Topology and mass",
    2: "Forces at given states",
    3: "Matrices",
    4: "One step, then many, with the same scheme",
    5: "Converged trajectories",
    6: "Known answers",
    7: "Horizon",
}
MOST_ELEMENTS = 2000  # larger nets are compared at given states and over one step, not over whole runs


@dataclass(frozen=True)
class Step:
    """A part of the ladder; `run` yields what it finds, and fails where a code stops."""

    rung: int
    title: str
    work: Callable[[], Iterator[Finding]]

    def run(self) -> Iterator[Finding]:
        """The findings of the step; a run that stops becomes a failed check."""
        try:
            yield from self.work()
        except Interrupted:
            raise KeyboardInterrupt from None
        except (ExunetError, EngineFailed, reference.Diverged) as stop:
            yield Check(self.rung, self.title, "ran to its end", math.inf, RAN, str(stop).split("\n")[0])


def shipped(folder: str = "") -> list[Path]:
    """Case files that come with exunet: cases/ or a folder in it, of the working directory or the sources.

    Raises InputError if there are none.
    """
    for place in _places(folder):
        if found := sorted(place.glob("*.toml")):
            return found
    raise InputError(_MISSING.format(Path("cases") / folder))


def _places(folder: str) -> tuple[Path, Path]:
    return Path("cases") / folder, Path(__file__).resolve().parents[2] / "cases" / folder


_MISSING = (
    "{}: no such folder with the cases that come with exunet, neither here nor beside the program; "
    "verify from a copy of the sources"
)


def answers() -> dict[str, Path]:
    """The cases of the known answers by name; raises InputError if they are not all there."""
    from exunet.verification.answers import ANSWERS

    names = {name for name, _ in ANSWERS}
    for place in _places("verification"):
        paths = {name: place / f"{name}.toml" for name in names}
        if all(path.is_file() for path in paths.values()):
            return paths
    raise InputError(_MISSING.format("cases/verification"))


def read_cases(paths: Sequence[Path]) -> list[Pair]:
    """The cases in both codes.

    Raises InputError for the first that the reference does not know, and for two of one name: rows and
    figures go by it.
    """
    paths = paths or (*shipped(), *shipped("verification/trajectories"))
    named: dict[str, Path] = {}
    for path in paths:
        if (first := named.setdefault(path.stem, path)) is not path:
            raise InputError(f"two cases are called {path.stem}, {first} and {path}: rename one")
    return [read_pair(path) for path in paths]


class Ladder:
    """The rungs over some cases.

    quick : one case only for what takes whole runs, fewer random nets; rungs 1 to 3 are the same
    study : also look into the separation of the paper's bullet curves
    Raises InputError without the cases of the known answers.
    """

    def __init__(self, pairs: Sequence[Pair], *, quick: bool, study: bool) -> None:
        self._pairs = pairs
        self._quick = quick
        self._study = study
        self._different: set[str] = set()
        self._grown: dict[str, Growth] = {}
        self._known = answers()

    def steps(self) -> Iterator[Step]:
        """The steps in order; which come later may depend on what earlier ones found."""
        yield from self._states()
        yield from self._runs()
        yield from self._answers()
        yield from self._horizons()

    def _states(self) -> Iterator[Step]:
        from exunet.verification import forces, matrices, measures, stepping, topology

        for pair in self._pairs:
            yield Step(1, pair.name, lambda pair=pair: self._topology(pair))  # type: ignore[misc]
        count = 30 if self._quick else 300
        yield Step(1, "random nets", lambda: topology.random_topologies(count))
        for rung, what in (
            (2, forces.forces),
            (2, measures.measures),
            (3, matrices.matrices),
            (4, stepping.one_step),
        ):
            # What is measured at a state is the same in all forms.
            for pair in self._same_nets() if what is measures.measures else self._forms(rung):
                yield Step(rung, pair.name, lambda pair=pair, what=what: what(pair))  # type: ignore[misc]

    def _topology(self, pair: Pair) -> Iterator[Check]:
        from exunet.verification.topology import topology

        for check in topology(pair):
            if not check.holds:
                self._different.add(pair.name)
            yield check

    def _same_nets(self) -> list[Pair]:
        """Cases whose nets are the same in both codes: only these can be compared further."""
        return [pair for pair in self._pairs if pair.name not in self._different]

    def _forms(self, rung: int) -> list[Pair]:
        """The cases with the engine's connectors and, where Numba is installed, with its fused net.

        For steps in time also with the compiled loop, which has the forces of the fused net.
        """
        from exunet.codegen.compile import numba_installed

        pairs = self._same_nets()
        forms = [*pairs]
        if numba_installed():
            forms += [pair.fused() for pair in pairs]
            forms += [pair.looped() for pair in pairs] if rung == 4 else []
        return forms

    def _runs(self) -> Iterator[Step]:
        for number, pair in enumerate(self._same_nets()):
            work = self._trajectories if number == 0 or not self._quick else self._not_followed
            yield Step(4, pair.name, lambda pair=pair, work=work: work(pair))  # type: ignore[misc]

    def _not_followed(self, pair: Pair) -> Iterator[Finding]:
        yield left_out(4, pair.name, "whole runs and horizon, rungs 4, 5 and 7", "--quick follows one case")

    def _trajectories(self, pair: Pair) -> Iterator[Finding]:
        from exunet.verification import converged, growth, stepping

        if (count := pair.start.net.n_elements) > MOST_ELEMENTS:
            why = f"for up to {MOST_ELEMENTS} elements, not {count}"
            yield left_out(4, pair.name, "whole runs and horizon, rungs 4, 5 and 7", why)
            return
        followed = (QUICK_END, (growth.ROUND_OFF, growth.LONE)) if self._quick else ()
        grown = growth.growth(pair, *followed)
        self._grown[pair.name] = grown
        reached, end = float(grown.time[-1]), pair.start.scene.time.end
        if reached < 0.999 * end:
            limit = f"{growth.MOST_WORK:.0e} elements x steps"
            why = "--quick goes no further" if self._quick and reached == QUICK_END else f"more than {limit}"
            what = f"whole runs from t = {reached:.3g} s on, of {end:g} s: rungs 4, 5 and 7"
            yield left_out(4, pair.name, what, why)
        yield from stepping.same_scheme(pair, grown)
        yield from converged.converged(pair, grown)

    def _answers(self) -> Iterator[Step]:
        from exunet.verification.answers import ANSWERS

        for name, answer in ANSWERS:
            path = self._known[name]
            if self._quick and name in LONG_ANSWERS:
                row = left_out(6, name, "the known answers of this case", "--quick leaves out the long ones")
                yield Step(6, name, lambda row=row: iter([row]))  # type: ignore[misc]
            else:
                yield Step(6, name, lambda path=path, answer=answer: answer(read_pair(path)))  # type: ignore[misc]

    def _horizons(self) -> Iterator[Step]:
        from exunet.verification import horizon, separation

        pairs = {pair.name: pair for pair in self._pairs if pair.name in self._grown}
        for name, pair in pairs.items():
            grown = self._grown[name]
            yield Step(7, name, lambda pair=pair, grown=grown: horizon.sensitivity(pair, grown))  # type: ignore[misc]
        if self._quick:
            why = "--quick leaves out what takes many runs"
            rows = [left_out(7, name, "what perturbed runs have in common", why) for name in list(pairs)[:1]]
            yield Step(7, "ensembles", lambda: iter(rows))
            return
        papers = [pairs[name] for name in PAPER if name in pairs] if self._study else []
        for pair in papers[:2] if self._study else pairs.values():
            grown, both = self._grown[pair.name], pair.name not in PAPER[1:]
            title = f"{pair.name}, ensemble"
            yield Step(
                7,
                title,
                lambda pair=pair, grown=grown, both=both: horizon.after_it(pair, grown, both),  # type: ignore[misc]
            )
        if len(papers) == len(PAPER):
            yield Step(7, "the paper's case", lambda: separation.separation(*papers))


# The paper's case, with its damping, without, and packed as the paper says elsewhere.
PAPER = ("planar_deployment", "planar_undamped", "planar_deployment_006")
LONG_ANSWERS = {"snap_from_slack"}
QUICK_END = 1.0  # [s] of the run that --quick follows
