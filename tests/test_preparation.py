"""Faults that show only when a run is prepared: all at once, each with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

from exunet.base.errors import BeyondFloats, CaseError, Fault
from exunet.base.faults import collected
from exunet.case.casefile import load
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


def test_an_error_inside_keeps_its_type_and_what_was_found_before() -> None:
    with pytest.raises(BeyondFloats) as caught:
        raise_all([Fault("a", "first")], BeyondFloats([Fault("b", "second")]))
    assert [fault.key for fault in caught.value.faults] == ["a", "b"]
