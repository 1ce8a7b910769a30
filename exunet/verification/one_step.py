"""One step of each method: the schemes of both codes compared at equal states."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

import reference_impl as reference
from exunet.base.errors import ExunetError, Interrupted
from exunet.integrators.protocol import IntegrationFailed
from exunet.methods.method import Plan
from exunet.studies.both_codes import BothCodes
from exunet.studies.perturbation import MOVE
from exunet.verification.check import Check, Evidence, Plate, difference, left_out, worst_of
from exunet.verification.figures import curves
from exunet.verification.horizon import VISIBLE, Growth, at_node, distances, fixed_plan
from exunet.verification.states import HALF_SLACK, NO_HALF_SLACK, smooth_states
from exunet.verification.tolerances import ONE_STEP, RAN, SAME_SCHEME


@dataclass(frozen=True)
class Step:
    """What is looked at, and how; `run` yields what it finds, and fails where a code stops.

    rung    : of the ladder, or item of the gallery
    subject : the case, mostly
    work    : calculates the findings
    """

    rung: int
    subject: str
    work: Callable[[], Iterable[Evidence]]

    def run(self) -> Iterator[Evidence]:
        """The findings of the step, under its rung and subject; a run that stops becomes a failed check."""
        try:
            for finding in self.work():
                yield self._signed(finding)
        except Interrupted:
            raise KeyboardInterrupt from None
        except (ExunetError, IntegrationFailed, reference.Diverged) as stop:
            yield self.stopped(str(stop).split("\n")[0])

    def stopped(self, why: str) -> Evidence:
        """The failed check of a step that did not come to its end."""
        return self._signed(Check("ran to its end", math.inf, RAN, why))

    def _signed(self, finding: Evidence) -> Evidence:
        if isinstance(finding, Check) and not finding.subject:
            finding = replace(finding, subject=self.subject)
        return replace(finding, rung=finding.rung or self.rung)


SEED = 20210617
SHOWN_PAST = 1.15  # of the horizon
_SHORT = 5.0  # shortest elements in the size, up to which they do not count: see `ONE_STEP`


def one_step(case: BothCodes) -> Iterator[Check]:
    """One step of RK44, and the same with the reference's forces, from two states and the start."""
    net, random = case.start.net, np.random.default_rng(SEED)
    states = smooth_states(net, random)
    if HALF_SLACK not in states:
        yield left_out(f"one step, {HALF_SLACK}", NO_HALF_SLACK)
    starts = {
        kind: case.from_state(position, case.speed * random.normal(size=position.shape))
        for kind, position in states.items()
    }
    plan = fixed_plan(case, case.start.scene.time.end)
    yield from one_step_from(starts | {"the start": case}, plan)


def one_step_from(starts: Mapping[str, BothCodes], plan: Plan) -> Iterator[Check]:
    """The same from some starts of a case, by RK44 of this plan."""
    times = np.array([0.0, plan.step])
    for kind, there in starts.items():
        shortest = there.start.net.reference_length.min(initial=there.size)
        magnified = max(1.0, float(there.size / (_SHORT * shortest)))
        if there.breaks_at_once:
            yield left_out(f"one step, {kind}", "an element is beyond its limit from the start")
            continue
        ours, theirs = there.run_exunet(times, plan), there.run_reference_in_steps(times, plan.step)
        found = []
        for name, unit in (("position", "m"), ("velocity", "m/s")):
            a, b = (getattr(run, name)[1] for run in (ours, theirs))
            least = there.speed if name == "velocity" else 0.0
            check = difference(name, a, b, ONE_STEP, ("node", "xyz"), unit, least=least)
            found.append(replace(check, measured=check.measured / magnified))
        yield worst_of(f"one step of {plan.step:.3g} s, {kind}", found)


def same_scheme(case: BothCodes, grown: Growth) -> Iterator[Evidence]:
    """The growth of the difference over the run, against the growth of a perturbation of the start.

    grown : of this case, over the time to compare

    Compared until the round-off of all steps may have become `VISIBLE`: a bound above that says nothing.
    """
    shown = grown.time <= max(SHOWN_PAST * grown.horizon, grown.time[1])
    times, size = grown.time[shown], case.size
    plan = fixed_plan(case, float(times[1]))
    ours, theirs = case.run_exunet(times, plan), case.run_reference_in_steps(times, plan.step)
    apart, lone = distances(ours, theirs).max(axis=1), size * grown.of(MOVE)[shown]
    round_off = ours.steps * np.finfo(float).eps * max(size, float(np.abs(theirs.position).max()))
    bound = np.maximum.accumulate(lone) * round_off / (MOVE * size)
    kept = max(1, int(np.count_nonzero(~(bound >= VISIBLE * size))))  # it never falls; NaN is no end
    share = (apart / np.where(apart > 0.0, bound, 1.0))[:kept]
    at = int(np.argmax(share))
    node = int(np.argmax(distances(ours, theirs)[at]))
    words = f"{at_node(ours, theirs, at, node)}; bound {bound[at]:.2g} m"
    name = f"equal steps to t = {times[kept - 1]:.3g} s, part of the bound"
    yield Check(name, float(share[at]), SAME_SCHEME, words)
    ended = f"bound {VISIBLE * size:.0e} m, compared until here"
    title = f"{case.name}: Exudyn RK44 and the reference's forces in the same steps, {plan.step:.3g} s"
    lines = {"Exudyn and reference": apart, f"one code, start moved by {MOVE * size:.0e} m": lone}
    figure = curves(title, times, lines, {ended: float(times[kept - 1])} if kept < len(times) else {})
    caption = (
        f"{case.name}: the same scheme with the same step in both codes. The difference begins as round-off "
        "and grows as fast as any small change of the start does."
    )
    yield Plate(f"same_scheme_{case.name}", figure, caption)
