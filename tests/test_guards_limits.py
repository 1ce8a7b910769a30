"""What is refused before it runs, each with the key to change; and the words of an engine that gives up."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scenes import CABLE, pair_of_masses, thrown
from scripts import case_of

import exunet
from exunet.base.errors import CaseError, RunStopped
from exunet.simulation.preparation import prepare

BACKENDS = (
    {"backend": "compiled"},
    {"backend": "exudyn"},
)


def net_of(**cable: float) -> dict[str, object]:
    cable = {**CABLE, **cable}
    strings = {**cable, "length": 1.0}
    return {
        "topology": "square", "size": 2.0, "mesh": 1.0, "cable": cable, "strings": strings,
        "bullets": {"mass": 0.5},
    }  # fmt: skip


def refused(key: str, words: str, **tables: object) -> CaseError:
    with pytest.raises(CaseError, match=words) as refusal:
        prepare(thrown(tables.pop("solver", {}), **tables))  # type: ignore[arg-type]
    assert [fault.key for fault in refusal.value.faults] == [key]
    assert refusal.value.exit_code == 2
    return refusal.value


@pytest.mark.parametrize(
    "solver", [{}, {"method": "RK44"}, {"method": "GeneralizedAlpha", "step": 1e-3}], ids=str
)
def test_frequencies_beyond_floats_are_refused(solver):
    error = refused(
        "net", "element 0 .*outside the range of floating-point", net=net_of(density=1e-300), solver=solver
    )
    assert error.faults[0].beyond_floats  # so that the value in the case file is named


@pytest.mark.parametrize("solver", [{}, {"method": "RK44"}, {"method": "DOPRI5", "tolerance": 1e-6}], ids=str)
def test_steps_that_cannot_come_to_an_end_are_refused(solver):
    """The stiffness asks for steps of some 1e-48 s; and there is no end of 1e10 s in steps of 1e-4 s."""
    refused("net", "the limit is .*element", net=net_of(youngs_modulus=1e100), solver=solver)
    refused("net", "of at least", end=1e10, time={"end": 1e10, "output_step": 1e9}, solver=solver)


def test_too_many_steps_that_were_asked_for_are_refused():
    solver = {"method": "RK44", "step": 1e-11}
    refused("solver.step", "of at least", solver=solver)
    assert prepare(thrown({"method": "RK44", "step": 1e-10})).plan.step == 1e-10


def test_a_start_beyond_the_law_is_refused():
    refused("initial.packing", "starts at 2.5 times", initial={"packing": 2.5})
    assert prepare(thrown({"tolerance": 1e-6}, initial={"packing": 2.0})).plan.method
    places = [[-1.5, 0.0, 0.0], [1.5, 0.0, 0.0]]  # of an element of 1 m
    with pytest.raises(CaseError, match="starts at 3 times") as refusal:
        prepare(pair_of_masses(initial={"packing": 1.0, "node_positions": places}))
    assert refusal.value.faults[0].key == "initial.node_positions"


def test_speeds_that_no_step_can_follow_are_refused():
    """A bullet that passes its string of 1 m in 1e-30 s."""
    refused("launch", "separate at .* lengths a second", launch={"radial_speed": 1e30, "axial_speed": 0.0})
    refused(
        "initial",
        "separate at .* lengths a second",
        launch=None,
        initial={"packing": 0.5, "spin": [0, 0, 1e20]},
    )


def test_places_where_positions_have_no_digits_left_are_refused():
    """Doubles of 52 digits are 2^-10 m apart below 2^43 m, and twice that above; 1e-3 of 1 m lies between.

    Reached within 0.5 s at 2^44 m/s. Catches a limit elsewhere, and one that forgets the way or its duration.
    """
    fast = {"packing": 0.5, "velocity": [0.999 * 2.0**44, 0.0, 0.0]}
    assert prepare(thrown({}, initial=fast)).plan.method
    fast["velocity"] = [1.001 * 2.0**44, 0.0, 0.0]
    refused("initial", "8.8e[+]12 m until time.end, where .* spacing of 0.002 m", initial=fast)


@pytest.mark.parametrize("engine", BACKENDS, ids=str)
def test_steps_that_collapse_are_told_with_element_node_and_state(engine):
    """A tolerance below the round-off of the positions, which a case of such speeds is refused for."""
    start = prepare(thrown({"method": "DOPRI5", "tolerance": 1e-10}, engine=engine))
    start = replace(start, plan=replace(start.plan, tolerance=1e-25))
    with pytest.raises(
        RunStopped, match=r"collapsed to .* cannot be met; at t = .* most stretched element"
    ) as stop:
        exunet.run(start)
    assert "the fastest node is" in str(stop.value)
    assert "below round-off" in str(stop.value)
    assert not stop.value.step_cause


@pytest.mark.parametrize("engine", BACKENDS, ids=str)
def test_a_collapse_after_a_wrong_state_tells_of_that_state(engine):
    """Bullets at 1e9 m/s: the strings are beyond the law within the first steps."""
    launch = {"radial_speed": 1e9, "axial_speed": 0.0}
    with pytest.raises(RunStopped, match=r"diverged at .*longer than 2 times") as stop:
        exunet.run(thrown({}, engine=engine, launch=launch))
    assert "solver.accuracy" not in str(stop.value)


def test_what_implicit_methods_cannot_run_is_told_by_name():
    """A reel's states, a body that is held; the key is that of the method."""
    with pytest.raises(CaseError) as refusal:
        prepare(case_of("", 'solver={method="GeneralizedAlpha", step=1e-3}', 'engine.backend="exudyn"').scene)
    told = [(fault.key, fault.reason) for fault in refusal.value.faults]
    assert {key for key, _ in told} == {"solver.method"}
    words = " ".join(reason for _, reason in told)
    assert "a body that is fixed or prescribed (target): use an explicit method" in words
    assert "a force that has first-order states (tow/wound_up)" in words
