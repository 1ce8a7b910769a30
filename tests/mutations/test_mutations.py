"""Each planted error makes the quick ladder fail, at the rung that the report names for it."""

import plant
import pytest

from exunet.verification.check import Check
from exunet.verification.ladder import Ladder, read_cases, shipped
from exunet.verification.planted import PLANTED

QUICK = {
    "strain_without_half",
    "swapped_node",
    "elastic_doubled",
    "reference_tension_doubled",
    "reference_current_tangent",
    "reference_rk4_weights",
}


CASES = {path.stem: path for path in (*shipped(), *shipped("verification/trajectories"))}


def first_failure(case="planar_deployment"):
    """The first check that fails on the quick ladder over one case; None if all hold."""
    for step in Ladder(read_cases([CASES[case]]), quick=True, study=False).steps():
        for finding in step.run():
            if isinstance(finding, Check) and not finding.holds:
                return finding
    return None


@pytest.mark.parametrize(
    "error",
    [pytest.param(error, marks=() if error.name in QUICK else pytest.mark.slow) for error in PLANTED],
    ids=lambda error: error.name,
)
def test_a_planted_error_is_caught(error, monkeypatch):
    getattr(plant, error.name)(monkeypatch)
    found = first_failure(error.case)
    assert found is not None
    assert found.rung == error.rung, f"{found.name}: {found.measured} ({found.worst})"
    assert found.worst


@pytest.mark.slow
@pytest.mark.ci
def test_without_a_planted_error_the_ladder_holds():
    assert first_failure() is None


def test_twelve_errors_in_both_codes_each_named_once():
    names = [error.name for error in PLANTED]
    assert len(set(names)) == len(names) >= 12
    assert len({error.code for error in PLANTED}) == 2
