"""Steps of the ladder in several processes: the same findings in the same order, and none is lost quietly."""

import math
import multiprocessing
import os
from functools import partial

import numpy as np
import pytest

from exunet.base.errors import InputError
from exunet.plots.style import drawing
from exunet.verification.check import Check, Plate
from exunet.verification.figures import curves
from exunet.verification.one_step import Step
from exunet.verification.processes import followed


def counting(number):
    for k in range(3):
        yield Check(f"{number}.{k}", float(k), None)


def dying():
    yield Check("before", 0.0, None)
    os._exit(3)


def stopping():
    raise InputError("no such thing")
    yield


def drawn():
    times = np.array([0.0, 1.0])
    yield Plate("a", curves("a", times, {"b": times}, {}), "what it shows")


def only_here():
    if multiprocessing.parent_process() is not None:
        os._exit(3)
    return COUNTING[:3]


COUNTING = [Step(2, str(k), partial(counting, k)) for k in range(4)]


FAILING = [Step(1, "a", dying), Step(1, "b", stopping), Step(5, "c", drawn)]


def found(steps, processes):
    return [(step.subject, list(findings)) for step, findings in followed(partial(list, steps), processes)]


def test_in_one_process_steps_run_as_they_are_asked_for():
    steps = followed(partial(list, [Step(1, "a", stopping), Step(1, "b", dying)]), 1)
    _, rows = next(steps)
    assert [row.worst for row in rows] == ["no such thing"]


@pytest.mark.ci
@pytest.mark.slow
def test_findings_come_in_order_and_a_process_that_dies_fails_its_step(tmp_path):
    *counted, (_, first), (_, second), (_, (plate,)) = found([*COUNTING, *FAILING], 2)
    assert counted == found(COUNTING, 1)
    assert [row.holds for row in first] == [True, False]
    assert first[1].measured == math.inf
    assert "ended with exit code 3" in first[1].worst
    assert [row.worst for row in second] == ["no such thing"]
    assert plate.rung == 5
    with drawing():
        plate.figure.savefig(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.ci
@pytest.mark.slow
def test_processes_that_die_before_their_first_step_fail_all_and_end():
    """As where there is no memory for them; the first process makes the steps too and lives."""
    rows = [row for _, found in followed(only_here, 2) for row in found]
    assert [row.holds for row in rows] == [False] * 3


@pytest.mark.slow
def test_leaving_off_ends_the_processes():
    steps = followed(partial(list, COUNTING), 2)
    next(steps)
    assert len(multiprocessing.active_children()) == 2
    steps.close()
    assert multiprocessing.active_children() == []
    assert found([], 2) == []
