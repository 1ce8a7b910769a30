"""The hard cases can fail: what their checks count, and runs that a guard must stop."""

from __future__ import annotations

from dataclasses import replace

import pytest

import reference_impl as reference
from exunet.base.errors import RunStopped
from exunet.methods.method import Backend
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.verification import hard
from exunet.verification.hard import GALLERY
from exunet.verification.tolerances import HARD_FIXED

CASES = {entry.case: entry for entry in GALLERY}


def test_turns_of_the_spinning_net_are_counted() -> None:
    """One revolution a second (spin 2 pi): after 2 s it lacks 98 of 100."""
    turns = CASES["spinning"].of_both
    assert turns is not None
    short = reference.load(hard.case_path("spinning"), {"time.end": 2.0, "time.output_step": 0.02})
    run = short.integrate(method="EM", step=0.02)
    turned, slack = turns(hard.states_of(short, run), None)
    assert turned.error == pytest.approx(98.0, abs=0.01)
    assert slack.error == 0.0


def test_a_bound_that_is_broken_fails() -> None:
    """7e-8 of the energy is what one snap costs at this tolerance."""
    tight = replace(CASES["one_element"], energy=replace(HARD_FIXED, value=1e-12))
    failed = [check.name for check in hard.on_backend(tight, Backend.COMPILED) if not check.holds]
    assert failed == ["energy balance"]


@pytest.mark.ci
@pytest.mark.slow
def test_an_implicit_run_must_be_stopped_by_a_guard() -> None:
    """A stop of another kind, however small the energy of the stored part, does not hold."""
    settings = ("solver.step=1e-3", "time.end=0.6", "engine.backend=exudyn")
    with pytest.raises(RunStopped) as stop:
        simulate(prepare(load(hard.case_path("implicit"), settings).scene))
    assert hard.stopped("GeneralizedAlpha", stop.value).holds
    other = RunStopped("the engine stopped after t = 0.5 s: Newton did not converge", stop.value.result)
    assert not hard.stopped("GeneralizedAlpha", other).holds
