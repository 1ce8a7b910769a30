"""Rung 9: states in which threads and bullets press in, and that both codes do the same there."""

from __future__ import annotations

import numpy as np
import pytest

from exunet.studies.both_codes import read_both
from exunet.verification import contact
from exunet.verification.check import Check, shipped
from exunet.verification.ladder import RUNGS, Ladder


@pytest.mark.ci_for("threads")
@pytest.mark.slow_for("threads")
@pytest.mark.parametrize("name", list(shipped(contact.CONTACT_CASES)))
def test_both_codes_do_the_same_at_states(name: str) -> None:
    checks = list(contact.at_states(read_both(shipped(contact.CONTACT_CASES)[name]), 3))
    assert [check.name for check in checks if not check.holds] == []
    assert len(checks) == len(contact.QUANTITIES) + 1


@pytest.mark.ci_for("8")
@pytest.mark.slow_for("8")
@pytest.mark.parametrize(("name", "lines"), [("threads", 8), ("bullets", 4), ("nodes", 16)])
def test_every_line_presses_in_and_is_not_too_deep(name: str, lines: int) -> None:
    case = read_both(shipped(contact.CONTACT_CASES)[name])
    surface = case.start.system.blocks.surfaces["target"]
    for state in contact.pressed_states(case, 3, np.random.default_rng(1)):
        found, touching, depth = contact._of_exunet(case, state)
        assert touching == lines
        assert depth < surface.allowed + 0.03  # the radius of the bullets; threads and nodes are thinner
        # What the body gets is the opposite of what all nodes get, by the sums of both.
        np.testing.assert_allclose(found[1], -found[0].sum(axis=0), rtol=1e-12, atol=1e-12)


def test_the_quick_ladder_has_the_states_and_tells_what_it_leaves_out() -> None:
    steps = list(Ladder([], quick=True, paper=False)._contacts())
    assert [step.subject for step in steps] == [
        name for name in ("bullets", "nodes", "threads", "together") for _ in range(2)
    ]
    assert {step.rung for step in steps} == {9} <= set(RUNGS)
    left = [item for step in steps[1::2] for item in step.run()]
    assert all(isinstance(entry, Check) and entry.left_out and entry.name == "whole runs" for entry in left)


@pytest.mark.slow
def test_bullets_do_the_same_over_a_run() -> None:
    (check,) = contact.over_a_run(read_both(shipped(contact.CONTACT_CASES)["bullets"]))
    assert check.holds, check


@pytest.mark.slow
def test_nodes_do_the_same_over_a_run() -> None:
    (check,) = contact.over_a_run(read_both(shipped(contact.CONTACT_CASES)["nodes"]))
    assert check.holds, check


def test_a_run_of_threads_is_left_out_and_told() -> None:
    (row,) = contact.over_a_run(read_both(shipped(contact.CONTACT_CASES)["threads"]))
    assert row.left_out
