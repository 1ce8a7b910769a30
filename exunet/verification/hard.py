"""Runs the gallery of hard cases in every form of the engine and in the reference."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
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
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.both_codes import pair_of
from exunet.verification.check import Check, left_out
from exunet.verification.gallery import GALLERY, Hard, above_limit
from exunet.verification.ladder import shipped
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
    (path,) = (path for path in shipped("hard") if path.stem == name)
    return path


def checks(forms: Sequence[str] = tuple(FORMS), quick: bool = False) -> Iterator[Check]:
    """All checks of the gallery, item by item; quick: in the compiled loop only, without implicit steps."""
    forms = ("compiled",) if quick else forms
    for item in sorted({hard.item for hard in GALLERY} | {5}):
        for hard in GALLERY:
            if hard.item == item:
                for form in forms:
                    yield from of_form(hard, form)
                if not quick:
                    yield from of_reference(hard)
        if item == 5 and not quick:
            for form in forms:
                if form != "compiled":
                    yield from implicit(form)
            yield from energy_momentum()
        if item == 6:
            for form in forms:
                yield from above(form)


def of_form(hard: Hard, form: str) -> Iterator[Check]:
    """A case in one form of the engine."""
    subject = f"{hard.case}, {form}"
    whole = load(case_path(hard.case), FORMS[form])
    end = hard.short.get(form)
    case = whole if end is None else load(case_path(hard.case), (*FORMS[form], f"time.end={end!r}"))
    ran = "ran to its end" if end is None else f"ran {end:g} s of {whole.scene.time.end:g} s"
    start = prepare(case.scene)
    try:
        result = _run(start)
    except RunStopped as stop:
        yield Check(hard.item, subject, ran, math.inf, RAN, str(stop))
        return
    yield Check(hard.item, subject, ran, 0.0 if _sound(result) else math.inf, RAN)
    yield Check(hard.item, subject, "energy balance", energy_balance(result), hard.energy)
    speeds = result.net.mass * np.linalg.norm(result.velocity, axis=-1)
    if hard.momentum:
        change = _change(result.momentum) / float(speeds.sum(axis=1).max())
        yield Check(hard.item, subject, "linear momentum", change, hard.momentum)
    if hard.angular:
        arms = (speeds * np.linalg.norm(result.position, axis=-1)).sum(axis=1).max()
        yield Check(
            hard.item, subject, "angular momentum", _change(result.angular_momentum) / arms, hard.angular
        )
    if end is not None:
        why = "the whole run takes a quarter of an hour in this form; it is done in the others"
        yield left_out(hard.item, subject, "what the whole run shows", why)
        return
    for findings in filter(None, (hard.of_both, hard.more)):
        for name, measured, allowed in findings(result, start):
            yield Check(hard.item, subject, name, measured, allowed)
    if hard.case == "odd_times":
        pair = pair_of(case)
        other = pair.march(result.time)
        apart = float(np.abs(other.position - result.position).max())
        yield Check(hard.item, subject, "positions, from the reference's", apart, HARD_POSITIONS)


def of_reference(hard: Hard) -> Iterator[Check]:
    """A case in the reference: energy balance, momenta and what concerns both codes, in the same bounds."""
    subject = f"{hard.case}, reference"
    if isinstance(hard.reference, str):
        yield left_out(hard.item, subject, "the whole case", hard.reference)
        return
    how = dict(hard.reference)
    overrides = {"time.output_step": how["step"], "time.output_times": None} if "step" in how else {}
    scene = reference.load(case_path(hard.case), overrides)
    try:
        run = scene.march(**how)
    except reference.Diverged as stop:
        yield Check(hard.item, subject, "ran to its end", math.inf, RAN, str(stop))
        return
    system = scene.system
    yield Check(hard.item, subject, "energy balance", _reference_balance(scene, run), hard.energy)
    speeds = scene.net.mass * np.linalg.norm(run.v, axis=-1)
    if hard.momentum:
        change = _change(theirs.momentum(system, run.v)) / float(speeds.sum(axis=1).max())
        yield Check(hard.item, subject, "linear momentum", change, hard.momentum)
    if hard.angular:
        arms = (speeds * np.linalg.norm(run.x, axis=-1)).sum(axis=1).max()
        change = _change(theirs.angular_momentum(system, run.x, run.v)) / float(arms)
        yield Check(hard.item, subject, "angular momentum", change, hard.angular)
    if hard.of_both:
        for name, measured, allowed in hard.of_both(states_of(scene, run), None):
            yield Check(hard.item, subject, name, measured, allowed)


def states_of(scene: Any, run: Any) -> SimpleNamespace:
    """States of the reference with the names of a result."""
    return SimpleNamespace(
        net=scene.net,
        time=run.t,
        position=run.x,
        strain=strain(scene.system, run.x),
        kinetic=theirs.kinetic(scene.system, run.v),
        elastic=theirs.elastic(scene.system, run.x),
    )


def _reference_balance(scene: Any, run: Any) -> float:
    energy = theirs.kinetic(scene.system, run.v) + theirs.elastic(scene.system, run.x) + run.dissipated
    return float(np.abs(energy - energy[0]).max() / energy[0])


def implicit(form: str) -> Iterator[Check]:
    """The implicit methods at four steps on the paper's net: within the bound, or stopped by a guard."""
    for method in IMPLICIT:
        for step in IMPLICIT_STEPS:
            settings = (f"solver.method={method}", f"solver.step={step!r}", *FORMS[form])
            start = prepare(load(case_path("implicit"), settings).scene)
            subject = f"implicit, {form}"
            name = f"{method} at {1e3 * step:g} ms"
            try:
                result = _run(start)
            except RunStopped as stop:
                yield stopped(subject, name, stop)
                continue
            measured = energy_balance(result) if _sound(result) else math.inf
            yield Check(5, subject, f"{name}: ran to the end", measured, HARD_BOUND)


def stopped(subject: str, name: str, stop: RunStopped) -> Check:
    """A run that did not end: it must be a guard that stopped it, for its energy, and what is kept sound."""
    words = str(stop)
    found = re.match(r"diverged at t = (\S+) s: the energy (grew|fell)\D* by (\S+) J", words)
    if not found or stop.partial is None or not _sound(stop.partial):
        return Check(5, subject, f"{name}: stopped by something else", math.inf, HARD_BY_GUARD, words)
    time, change, energy = found.groups()
    sign = "+" if change == "grew" else "-"
    return Check(
        5, subject, f"{name}: stopped at {time} s, energy {sign}{energy} J", 0.0, HARD_BY_GUARD, words
    )


def energy_momentum() -> Iterator[Check]:
    """The energy-momentum method of the reference at the same steps: exact at all of them."""
    for step in IMPLICIT_STEPS:
        scene = reference.load(case_path("implicit"))
        run = scene.march(method="EM", step=step)
        balance = _reference_balance(scene, run)
        yield Check(5, "implicit, reference", f"EM at {1e3 * step:g} ms: ran to the end", balance, HARD_EXACT)


def above(form: str) -> Iterator[Check]:
    """1.02 of the stable step: refused; forced, stopped by a guard."""
    path, subject = case_path("near_limit"), f"near_limit, {form}"
    step = above_limit(load(path, FORMS[form]).scene)
    try:
        prepare(load(path, (f"solver.step={step!r}", *FORMS[form])).scene)
        refused = math.inf
    except CaseError:
        refused = 0.0
    yield Check(6, subject, "1.02 of the stable step: refused", refused, HARD_REFUSED)
    forced = ("solver.force=true", "solver.retry=0", f"solver.step={step!r}", *FORMS[form])
    try:
        _run(prepare(load(path, forced).scene))
        yield Check(6, subject, "1.02 of the stable step, forced: stopped", math.inf, HARD_CAUGHT)
    except RunStopped as stop:
        kept = 0.0 if stop.partial is not None and _sound(stop.partial) else math.inf
        yield Check(6, subject, "1.02 of the stable step, forced: stopped", kept, HARD_CAUGHT, str(stop))


def _run(start: Start) -> Result:
    try:
        return simulate(start)
    except Interrupted:  # a RunStopped too, but no finding
        raise KeyboardInterrupt from None


def _sound(result: Result) -> bool:
    arrays = (
        result.position,
        result.velocity,
        result.tension,
        result.kinetic,
        result.elastic,
        result.dissipated,
    )
    return all(bool(np.isfinite(array).all()) for array in arrays)


def _change(vectors: Any) -> float:
    return float(np.linalg.norm(vectors - vectors[0], axis=-1).max())
