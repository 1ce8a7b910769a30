"""Each planted error makes the quick ladder fail, at the rung that the report names for it, or a test."""

from importlib import import_module
from inspect import signature
from itertools import chain
from pathlib import Path

import operators
import plant_begun  # noqa: F401 - enters its errors
import plant_control  # noqa: F401 - enters its errors
import plant_script  # noqa: F401 - enters its errors
import pytest
from plant import EXUDYN, PLANTED, REFERENCE
from plant_bodies import SNAP
from plant_closing import EDGE, LOOP, OPEN
from plant_contact import BULLETS, NODES, THREADS, TOGETHER

from exunet.interfaces.commands.verify import PLANTED as REPORT_WORDS
from exunet.verification.check import Check
from exunet.verification.ladder import Ladder, read_cases
from exunet.verification.shipped import shipped

QUICK = {
    "swapped_node",
    "reference_rk4_weights",
    "one_length_in_bending",
    "peak_one_step_off",
    "potential_from_zero",
    "chaser_in_the_centre",
    "carried_mass_lost",
    "throw_without_recoil",
}

OF_SCENE = {THREADS: 9, NODES: 9, BULLETS: 9, TOGETHER: 9, LOOP: 10, OPEN: 10, EDGE: 10}
CASES = shipped() | shipped("verification/trajectories")


def first_failure(case="planar_deployment"):
    """The first check that fails on the quick ladder over one case; None if all hold.

    For a scene of rungs 8 to 10, which every ladder has, that of its rows alone.
    """
    of_rung = OF_SCENE.get(case, None if case in CASES else 8)
    ladder = Ladder([] if of_rung else read_cases([CASES[case]]), quick=True, paper=False)
    alone = {9: ladder._contacts, 10: ladder._closings}.get(of_rung)
    for step in alone() if alone else chain(ladder.nets(), ladder.later()):
        if of_rung and (step.rung, step.subject) != (of_rung, case):
            continue
        for finding in step.run():
            if isinstance(finding, Check) and not finding.holds:
                return finding
    return None


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in PLANTED],
)
def test_a_planted_error_is_caught(name, monkeypatch, tmp_path):
    error = PLANTED[name]
    if error.rung is None:
        module, function = error.case.split(":")
        test = getattr(import_module(module), function)
        error.plant(monkeypatch)
        with pytest.raises(AssertionError):
            test(
                *error.arguments,
                **({"tmp_path": tmp_path} if "tmp_path" in signature(test).parameters else {}),
            )
        return
    error.plant(monkeypatch)
    found = first_failure(error.case)
    assert found is not None
    assert found.rung == error.rung, f"{found.name}: {found.measured} ({found.worst})"
    assert found.worst


def test_every_error_finds_what_it_changes():
    """That it is caught too is tested of each, which takes half an hour."""
    for error in PLANTED.values():
        if error.rung is None:
            import_module(error.case.split(":")[0])
        with pytest.MonkeyPatch.context() as patch:
            error.plant(patch)


def test_every_module_of_the_physics_has_tests_that_concern_it():
    root = Path(__file__).resolve().parents[2]
    modules = {
        path.relative_to(root).as_posix()
        for pattern in operators.PHYSICS
        for path in (root / "exunet").glob(pattern)
    }
    assert len(modules) > 150  # 168 at 2026-11-23
    assert all(operators.concerned(root, module) for module in modules)


@pytest.mark.slow
def test_without_a_planted_error_the_ladder_holds():
    assert first_failure() is None
    assert first_failure(SNAP) is None
    assert first_failure(THREADS) is None
    assert first_failure(BULLETS) is None
    assert [first_failure(case) for case in (LOOP, OPEN, EDGE)] == [None] * 3
    assert first_failure(NODES) is None


def test_the_report_tells_how_many_are_planted_and_both_codes_have_some():
    """Rungs 5 and 7 follow whole runs; what changes those shows at a lower rung first."""
    assert len(PLANTED) == 130
    assert "plants one hundred and thirty errors in both codes" in " ".join(REPORT_WORDS.split())
    assert {error.code for error in PLANTED.values()} == {EXUDYN, REFERENCE}
    assert {error.rung for error in PLANTED.values()} == {1, 2, 3, 4, 6, 8, 9, 10, None}
    assert set(PLANTED) >= QUICK
