"""Convergence in the division of threads: what is called converged, and what a finer case is."""

from __future__ import annotations

from typing import Any

import pytest
from scenes import CASES

import exunet
from exunet.results.metrics import Metric
from exunet.simulation.preparation import prepare_case
from exunet.studies.divisions import Refinement, divided, refine, summary_of
from exunet.studies.ensemble import perturbed_runs

TENSION = Metric("largest_tension", "largest tension", "N", 817.0)


@pytest.mark.parametrize(
    ("numbers", "converged"),
    [
        ((817.0, 571.0, 617.0, 1062.0), False),  # the paper's net, from one division to two
        ((571.0, 560.0, 570.9, 571.1), True),  # out of a narrow range, by 2 % only
        ((571.0, 317.0, 560.0, 580.0), False),
        ((817.0, 700.0, 617.0, 1062.0), True),
        ((0.0, 0.0, 0.0, 0.0), True),
    ],
)
def test_a_metric_that_leaves_its_range_is_not_converged(numbers: Any, converged: bool) -> None:
    item = Refinement(TENSION, *numbers)
    assert item.converged is converged
    assert (summary_of({"largest_tension_N": item})["moved"] == []) is converged


def test_a_divided_case_has_more_elements_and_a_shorter_step() -> None:
    """Twice the elements on each thread; a fixed step follows the lumps' stable step."""
    case = exunet.load(CASES / "planar_undamped.toml", ["solver={method='VelocityVerlet', step=2e-5}"])
    fine = divided(case, 2)
    assert prepare_case(fine).net.n_elements == 2 * prepare_case(case).net.n_elements
    assert fine.scene.solver.step == 1e-5


def test_bullets_in_free_flight_do_not_depend_on_the_division() -> None:
    """Before their strings are taut."""
    case = exunet.load(CASES / "planar_deployment.toml", ["time={end=0.2, output_step=0.1}"])
    found = refine(case, perturbed_runs(prepare_case(case), 4))
    assert {"largest_area_m2", "bullet_speed_at_end_m_s"} <= found.keys()
    assert found["bullet_speed_at_end_m_s"].converged
