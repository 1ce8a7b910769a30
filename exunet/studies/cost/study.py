"""The study of one scene: ladders climbed cheap settings first, within a budget, repeats interleaved."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from exunet.case.cross_checks import cross_checks
from exunet.methods.method import METHODS, Kind, Method
from exunet.methods.plan import Plan
from exunet.studies.cost.converged import Converged
from exunet.studies.cost.runners import StudyEntry, Subject, run
from exunet.studies.cost.settings import ReferenceMethod, Setting, ladders
from exunet.system.limits import explicit_only, form_faults
from exunet.system.stability import largest_damping_rate, largest_frequency, step_limit
from reference_impl.integration import unsupported

REPEATS = 3
_WARM_UP = 1e-3  # of the run: compiles what is to be compiled
_FIRST_GUESS = 1e-5  # [s] a right-hand side, before any is measured
_ADAPTIVE = 800.0  # right-hand sides at a tolerance of 1: some 5000 at 1e-4
_NEXT = 1.6  # an adaptive run at the next decade of tolerance costs at most this much more

Say = Callable[[str], None]


@dataclass
class Study:
    """All entries of a scene, in the order they were run, and the solution they are measured against."""

    converged: Converged
    entries: list[StudyEntry] = field(default_factory=list)
    interrupted: bool = False

    @property
    def measured(self) -> list[StudyEntry]:
        """The entries that have measures."""
        return [entry for entry in self.entries if entry.measures is not None]

    @property
    def ranked(self) -> list[StudyEntry]:
        """Those whose error tells how good they are: not after the horizon, if they conserve energy."""
        return [entry for entry in self.measured if self.converged.predicts or not entry.setting.conserves]

    def error(self, entry: StudyEntry) -> float:
        """The error that counts: of the speed, or after the horizon that of the energy balance.

        Speed errors are not resolved below the uncertainty of the converged solution, of which some are part.
        """
        assert entry.measures is not None
        if self.converged.predicts:
            return max(entry.speed_error, self.converged.uncertainty)
        return entry.measures.energy


def climb(
    study: Study,
    subject: Subject,
    rungs: Sequence[Sequence[Setting]],
    left: Callable[[], float],
    say: Say,
    base: Sequence[Setting] = (),
) -> None:
    """Run the ladders into `study` until all is done or nothing is `left()` of the budget of wall time [s].

    The settings of `base` are run first and whatever is left. Then the cheapest run that is next on its
    ladder comes first; a run whose expected time exceeds what is left is left out with all that follow on its
    ladder, and says so. What remains of the budget repeats all successful runs, interleaved. Ctrl-C ends the
    study and marks it.
    """
    rates: dict[str, float] = {}  # [s] a right-hand side, by name of the setting and by code

    def expected(setting: Setting) -> float:
        """Wall time [s], from the last run of its name, else from one of its code."""
        rate = rates.get(setting.name, rates.get(setting.code, _FIRST_GUESS))
        return rate * _right_hand_sides(setting, subject.end)

    def measure(setting: Setting) -> None:
        say(str(setting))
        if not any(entry.setting.name == setting.name for entry in study.entries):
            run(subject, setting, subject.end * _WARM_UP)
        entry = run(subject, setting)
        if entry.measures is not None:
            gaps = np.abs(entry.measures.speeds - study.converged.speeds)
            entry.speed_error = float(gaps.max()) / subject.speed
        study.entries.append(entry)
        rates[setting.name] = entry.median / _right_hand_sides(setting, subject.end)
        if entry.work is not None and entry.work.right_hand_sides:
            rates[setting.code] = entry.median / entry.work.right_hand_sides

    try:
        for setting in base:
            measure(setting)
        waiting = [list(rung) for rung in rungs if rung and list(rung) != list(base)]
        while waiting:
            waiting.sort(key=lambda rung: expected(rung[0]))
            rung, budget = waiting[0], max(left(), 0.0)
            if budget == 0.0 or expected(rung[0]) > budget:
                for setting in waiting.pop(0):
                    words = f"some {expected(setting):.2g} s expected, {budget:.2g} s of the budget left"
                    study.entries.append(StudyEntry(setting, reason=f"left out: {words}"))
                continue
            measure(rung.pop(0))
            if not rung:
                waiting.pop(0)
        for number in range(2, REPEATS + 1):
            for entry in study.measured:
                if entry.median <= left():
                    say(f"repeat {number} of {entry.setting}")
                    entry.seconds += run(subject, entry.setting).seconds
    except KeyboardInterrupt:
        study.interrupted = True


def _right_hand_sides(setting: Setting, end: float) -> float:
    """How many to expect; of an adaptive method a few thousand, more with each decade of its tolerance."""
    if setting.step is None:
        return _ADAPTIVE * _NEXT ** -math.log10(setting.size)
    stages = METHODS[setting.method].stages if isinstance(setting.method, Method) else 4
    return stages * end / setting.step


def all_rungs(subject: Subject, *, compiled: bool) -> list[list[Setting]]:
    """The ladders of every method and code that can run the scene: effects and bodies may refuse some."""
    return [one for one in _ladders(subject, compiled=compiled) if not _refusal(subject, one[0])]


def untried(subject: Subject, *, compiled: bool) -> dict[str, list[str]]:
    """Why the scene refuses methods, each reason with their names; of one in all its forms without these."""
    every = [one[0] for one in _ladders(subject, compiled=compiled)]
    reasons = {setting: _refusal(subject, setting) for setting in every}
    found: dict[str, list[str]] = {}
    for setting, reason in reasons.items():
        alike = (other for one, other in reasons.items() if one.method == setting.method)
        in_all = setting.form is not None and all(other == reason for other in alike)
        name = str(setting.method) if in_all else setting.name
        if reason and name not in found.setdefault(reason, []):
            found[reason].append(name)
    return found


def _ladders(subject: Subject, *, compiled: bool) -> list[list[Setting]]:
    """Of every method and code."""
    system = subject.start.system
    frequency, rate = largest_frequency(system), largest_damping_rate(system)
    explicit = [name for name, method in METHODS.items() if method.kind == Kind.EXPLICIT]
    stable = {name: step_limit(name, frequency, rate) for name in explicit}
    theirs = [] if subject.both is None else list(ReferenceMethod)
    return ladders(stable, subject.end, compiled=compiled, reference=theirs)


def _refusal(subject: Subject, setting: Setting) -> str:
    """Why the scene's effects or bodies refuse a method or a form; "" if they do not."""
    if setting.form is None:
        em = setting.method == ReferenceMethod.EM and subject.both is not None
        return unsupported(subject.both.theirs.system) if em and subject.both else ""
    scene, start = subject.scene(setting), subject.start
    plan = Plan(Method(setting.method), step=setting.step, tolerance=setting.tolerance)
    faults = [*form_faults(start.system, start.state, plan, scene.engine), *cross_checks(scene)]
    if METHODS[plan.method].kind == Kind.IMPLICIT and (words := explicit_only(start.system)):
        return ", ".join(words)
    return "; ".join(fault.reason for fault in faults)
