"""Faults that show only when a run is prepared: all at once, each with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

from exunet.base.errors import CaseError, Fault, collected
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare_case

# Line numbers in the tests below count in this text. Two masses on a cable of 1 m, EA = 1e3 N, mu = 0.5 kg:
# the taut cable's frequency is sqrt(EA / (L0 mu)) = 45 rad/s, and RK44 is stable up to 2.83 / 45 s = 0.063 s.
STRETCHED = """\
format = 1
title = "two masses"
time = { end = 10.0, output_step = 1.0 }
[solver]
method = "RK44"
step = 0.1
[net]
topology = "explicit"
nodes = [[0, 0, 0], [1, 0, 0]]
elements = [[0, 1]]
node_masses = [1.0, 1.0]
cable = { area = 1e-6, density = 1e-3, youngs_modulus = 1e9 }
[initial]
packing = 1
node_positions = [[0, 0, 0], [9, 0, 0]]
"""


def faults(tmp_path: Path, text: str, *overrides: str) -> list[tuple[str, str]]:
    """(place, key) of each fault of preparing the case."""
    path = tmp_path / "case.toml"
    path.write_text(text)
    with pytest.raises(CaseError) as caught:
        prepare_case(load(path, overrides))
    return [(fault.place.replace(str(path), "case.toml"), fault.key) for fault in caught.value.faults]


def test_a_stretched_start_and_a_long_step_are_told_together(tmp_path: Path) -> None:
    assert faults(tmp_path, STRETCHED) == [
        ("case.toml:6", "solver.step"),
        ("case.toml:15", "initial.node_positions"),
    ]


def test_a_long_step_alone_and_a_stretched_start_alone(tmp_path: Path) -> None:
    short = "initial.node_positions=[[0, 0, 0], [1, 0, 0]]"
    assert faults(tmp_path, STRETCHED, short) == [("case.toml:6", "solver.step")]
    assert faults(tmp_path, STRETCHED, "solver.step=0.05") == [("case.toml:15", "initial.node_positions")]


def test_an_override_at_fault_is_named_beside_the_line(tmp_path: Path) -> None:
    assert faults(tmp_path, STRETCHED, "solver.step=0.2") == [
        ("case.toml:15", "initial.node_positions"),
        ("--set solver.step=0.2", "solver.step"),
    ]


def test_too_many_steps_and_a_stretched_start_are_told_together(tmp_path: Path) -> None:
    """1e11 s in steps of 1 ms are 1e14; 1e10 are allowed."""
    long = ("time.end=1e11", "time.output_step=1e10", "solver.step=1e-3")
    assert {key for _, key in faults(tmp_path, STRETCHED, *long)} == {
        "initial.node_positions",
        "solver.step",
    }


def raise_all(faults: list[Fault], last: CaseError | None = None) -> None:
    with collected() as found:
        found += faults
        if last:
            raise last


def test_collected_faults_are_raised_at_the_end_of_the_block() -> None:
    with pytest.raises(CaseError) as caught:
        raise_all([Fault("a", "first"), Fault("b", "second")])
    assert [fault.key for fault in caught.value.faults] == ["a", "b"]
    raise_all([])


def test_an_error_inside_keeps_what_was_found_before() -> None:
    with pytest.raises(CaseError) as caught:
        raise_all([Fault("a", "first")], CaseError([Fault("b", "second", beyond_floats=True)]))
    assert [(fault.key, fault.beyond_floats) for fault in caught.value.faults] == [("a", False), ("b", True)]


CASES = Path(__file__).parents[1] / "cases"
WRONG_STEPS = ("solver.method=RK44", "solver.step=1.0")


def keys_at_fault(name: str, *overrides: str) -> set[str]:
    with pytest.raises(CaseError) as caught:
        prepare_case(load(CASES / name, overrides))
    return {fault.key for fault in caught.value.faults}


def test_faults_of_bodies_effects_start_and_steps_are_told_together() -> None:
    body = "bodies.chaser={mass=1.0,inertia=[1.0,1.0,1.0]}"
    found = keys_at_fault("effects/launch_force.toml", body, *WRONG_STEPS, "initial.packing=3.0")
    assert found == {"bodies.chaser", "solver.step", "initial.packing"}
    thrust = "effects.thrust={bullets=[0],time=[0.0,1e60],force=[[1e200,0.0,0.0],[0.0,0.0,0.0]]}"
    force, time = "effects.thrust.force[0][0]", "effects.thrust.time[1]"
    assert keys_at_fault("planar_deployment.toml", thrust, *WRONG_STEPS) == {force, time, "solver.step"}


def test_a_candidate_that_overflows_does_not_hide_other_faults() -> None:
    auto = "effects={choose='auto',threshold=1e-3,gravity={acceleration=[1e300,0.0,0.0]}}"
    found = keys_at_fault("planar_deployment.toml", auto, *WRONG_STEPS)
    assert found == {"effects.gravity.acceleration[0]", "solver.step"}


@pytest.mark.parametrize(("state", "key"), [
    ("velocity=[1e200,0.0,0.0]", "velocity[0]"),
    ("velocity=[1e20,0.0,0.0]", "velocity"),
    ("angular_velocity=[1e200,0.0,0.0]", "angular_velocity[0]"),
    ("angular_velocity=[1e14,0.0,0.0]", "angular_velocity"),
    ("position=[1e200,0.0,0.0],velocity=[1.0,1e120,0.0]", "position[0]"),
    ("position=[1e20,0.0,0.0]", "position"),
])  # fmt: skip
def test_a_body_that_no_run_can_follow_is_refused(state: str, key: str) -> None:
    body = f"bodies.target={{mass=1.0,inertia=[1.0,2.0,2.5],{state}}}"
    found = keys_at_fault("planar_deployment.toml", body)
    assert f"bodies.target.{key}".rstrip(".") in found
    assert len(found) == state.count("1e")  # one fault for each number that is too large


@pytest.mark.parametrize(("mass", "key"), [
    ("mass=1e-320,inertia=[1.0,1.0,1.0]", "mass"),
    ("mass=1.0,inertia=[1.0,1.0,1e-320]", "inertia[2]"),
])  # fmt: skip
def test_a_body_too_light_to_divide_by_is_refused(mass: str, key: str) -> None:
    assert keys_at_fault("planar_deployment.toml", f"bodies.target={{{mass}}}") == {f"bodies.target.{key}"}


def test_a_point_mass_too_light_to_divide_by_is_refused() -> None:
    light = "effects.launch_force.chaser_mass=1e-320"
    assert keys_at_fault("effects/launch_force.toml", light) == {"effects.launch_force.chaser_mass"}
