"""Runs the gallery of hard cases in every form of the engine and in the reference."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import reference_impl as reference
from exunet.base.errors import CaseError, Interrupted, RunStopped
from exunet.case.casefile import load
from exunet.methods.method import METHODS, Kind
from exunet.results.measures import energy_balance
from exunet.results.result import Result
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.studies.both_codes import both_of
from exunet.system.stability import largest_frequency, stable_step
from exunet.verification.check import Check, left_out
from exunet.verification.gallery import GALLERY, ITEMS, Hard
from exunet.verification.ladder import Step
from exunet.verification.shipped import shipped
from exunet.verification.tolerances import (
    HARD_BOUND,
    HARD_BY_GUARD,
    HARD_CAUGHT,
    HARD_EXACT,
    HARD_POSITIONS,
    HARD_REFUSED,
    RAN,
)
from reference_impl import energy as theirs
from reference_impl.forces import strain

FORMS = {
    "connectors": ("engine.loop=exudyn", "engine.net=connectors"),
    "fused": ("engine.loop=exudyn", "engine.net=fused"),
    "compiled": ("engine.loop=compiled",),
}
IMPLICIT = tuple(method for method, facts in METHODS.items() if facts.kind == Kind.IMPLICIT)
IMPLICIT_STEPS = (0.2e-3, 1e-3, 5e-3, 20e-3)  # [s]


def case_path(name: str) -> Path:
    """The file of a case of the gallery."""
    return shipped("hard")[name]


def steps(forms: Sequence[str] = tuple(FORMS), quick: bool = False) -> Iterator[Step]:
    """All checks of the gallery, item by item; quick: in the compiled loop only, without implicit steps."""
    forms = ("compiled",) if quick else forms
    for item in ITEMS:
        for hard in (one for one in GALLERY if one.item == item):
            for form in forms:
                yield Step(item, f"{hard.case}, {form}", partial(of_form, hard, form))
            if not quick:
                yield Step(item, f"{hard.case}, reference", partial(of_reference, hard))
        if item == 5 and not quick:
            for form in forms:
                if form != "compiled":
                    yield Step(item, f"implicit, {form}", partial(implicit, form))
            yield Step(item, "implicit, reference", energy_momentum)
        if item == 6:
            for form in forms:
                yield Step(item, f"near_limit, {form}", partial(above, form))


def of_form(hard: Hard, form: str) -> Iterator[Check]:
    """A case in one form of the engine."""
    whole = load(case_path(hard.case), FORMS[form])
    end = hard.short.get(form)
    case = whole if end is None else load(case_path(hard.case), (*FORMS[form], f"time.end={end!r}"))
    ran = "ran to its end" if end is None else f"ran {end:g} s of {whole.scene.time.end:g} s"
    start = prepare(case.scene)
    try:
        result = simulate(start)
    except Interrupted:  # a RunStopped too, but not a finding
        raise
    except RunStopped as stop:
        yield Check(ran, math.inf, RAN, str(stop))
        return
    yield Check(ran, 0.0 if _finite(result) else math.inf, RAN)
    yield from _balances(hard, result, energy_balance(result))
    if end is not None:
        why = "the whole run takes a quarter of an hour in this form; it is done in the others"
        yield left_out("what the whole run shows", why)
        return
    for findings in filter(None, (hard.of_both, hard.more)):
        yield from findings(result, start)
    if hard.case == "odd_times":
        other = both_of(case).run_reference(result.time)
        apart = float(np.abs(other.position - result.position).max())
        yield Check("positions, from the reference's", apart, HARD_POSITIONS)


def of_reference(hard: Hard) -> Iterator[Check]:
    """A case in the reference: energy balance, momenta and what concerns both codes, in the same bounds."""
    if isinstance(hard.reference, str):
        yield left_out("the whole case", hard.reference)
        return
    how = dict(hard.reference)
    overrides = {"time.output_step": how["step"], "time.output_times": None} if "step" in how else {}
    scene = reference.load(case_path(hard.case), overrides)
    run = scene.march(**how)
    states = states_of(scene, run)
    yield from _balances(hard, states, _reference_balance(scene, run))
    if hard.of_both:
        yield from hard.of_both(states, None)


def _balances(hard: Hard, states: Any, energy: float) -> Iterator[Check]:
    """Energy and momenta of a result, or of the reference's states with its names."""
    yield Check("energy balance", energy, hard.energy)
    shares = states.net.mass * np.linalg.norm(states.velocity, axis=-1)
    if hard.momentum:
        change = _change(states.momentum) / float(shares.sum(axis=1).max())
        yield Check("linear momentum", change, hard.momentum)
    if hard.angular:
        arms = (shares * np.linalg.norm(states.position, axis=-1)).sum(axis=1).max()
        yield Check("angular momentum", _change(states.angular_momentum) / float(arms), hard.angular)


def states_of(scene: Any, run: Any) -> SimpleNamespace:
    """States of the reference with the names of a result."""
    system = scene.system
    return SimpleNamespace(
        net=scene.net,
        time=run.t,
        position=run.x,
        velocity=run.v,
        strain=strain(system, run.x),
        kinetic=theirs.kinetic(system, run.v),
        elastic=theirs.elastic(system, run.x),
        momentum=theirs.momentum(system, run.v),
        angular_momentum=theirs.angular_momentum(system, run.x, run.v),
    )


def _reference_balance(scene: Any, run: Any) -> float:
    energy = theirs.kinetic(scene.system, run.v) + theirs.elastic(scene.system, run.x) + run.dissipated
    return float(np.abs(energy - energy[0]).max() / energy[0])


def implicit(form: str) -> Iterator[Check]:
    """The implicit methods at four steps on the paper's net: within the bound, or stopped by a guard."""
    for method in IMPLICIT:
        for step in IMPLICIT_STEPS:
            settings = (f"solver.method={method}", f"solver.step={step!r}", *FORMS[form])
            name = f"{method} at {1e3 * step:g} ms"
            try:
                result = simulate(prepare(load(case_path("implicit"), settings).scene))
            except Interrupted:
                raise
            except RunStopped as stop:
                yield stopped(name, stop)
                continue
            measured = energy_balance(result) if _finite(result) else math.inf
            yield Check(f"{name}: ran to the end", measured, HARD_BOUND)


def stopped(name: str, stop: RunStopped) -> Check:
    """A run that did not end: a guard must have stopped it, for its energy, and what is kept is finite."""
    words = str(stop)
    found = re.match(r"diverged at t = (\S+) s: the energy (grew|fell)\D* by (\S+) J", words)
    if not found or stop.partial is None or not _finite(stop.partial):
        return Check(f"{name}: stopped by something else", math.inf, HARD_BY_GUARD, words)
    time, change, energy = found.groups()
    sign = "+" if change == "grew" else "-"
    return Check(f"{name}: stopped at {time} s, energy {sign}{energy} J", 0.0, HARD_BY_GUARD, words)


def energy_momentum() -> Iterator[Check]:
    """The energy-momentum method of the reference at the same steps: exact at all of them."""
    for step in IMPLICIT_STEPS:
        scene = reference.load(case_path("implicit"))
        balance = _reference_balance(scene, scene.march(method="EM", step=step))
        yield Check(f"EM at {1e3 * step:g} ms: ran to the end", balance, HARD_EXACT)


def above(form: str) -> Iterator[Check]:
    """1.02 of the stable step: refused; forced, stopped by a guard."""
    path = case_path("near_limit")
    start = prepare(load(path, FORMS[form]).scene)
    step = 1.02 * stable_step(start.plan.method, largest_frequency(start.system))
    name, setting = "1.02 of the stable step", (f"solver.step={step!r}", *FORMS[form])
    try:
        prepare(load(path, setting).scene)
        yield Check(f"{name}: refused", math.inf, HARD_REFUSED)
    except CaseError:
        yield Check(f"{name}: refused", 0.0, HARD_REFUSED)
    try:
        simulate(prepare(load(path, ("solver.force=true", "solver.retry=0", *setting)).scene))
        yield Check(f"{name}, forced: stopped", math.inf, HARD_CAUGHT)
    except Interrupted:
        raise
    except RunStopped as stop:
        kept = 0.0 if stop.partial is not None and _finite(stop.partial) else math.inf
        yield Check(f"{name}, forced: stopped", kept, HARD_CAUGHT, str(stop))


def _finite(result: Result) -> bool:
    names = ("position", "velocity", "tension", "kinetic", "elastic", "dissipated")
    return all(bool(np.isfinite(getattr(result, name)).all()) for name in names)


def _change(vectors: Any) -> float:
    return float(np.linalg.norm(vectors - vectors[0], axis=-1).max())
