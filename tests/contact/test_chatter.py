"""Steps too long for smooth friction: what is told of them hangs on force, mass and step as it should."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from contact_scenes import THROWN

from exunet.model.stability import friction_warnings
from exunet.scene.casefile import parse_case
from exunet.simulation.preparation import Start, prepare_case

SMOOTH = 'effects.contact.friction.law="regularised"'


def scene(slip_speed: float, step: float) -> Start:
    changes = (SMOOTH, f"effects.contact.friction.slip_speed={slip_speed}", f"solver.step={step}")
    return prepare_case(parse_case(THROWN, Path("thrown.toml"), changes))


def told(start: Start, factor: float = 1.0) -> tuple[float, float, float]:
    """Step, speed and step that is short enough, of the words on steps that many times as long."""
    assert start.plan.step is not None
    (words,) = friction_warnings(start.system, replace(start.plan, step=start.plan.step * factor))
    found = re.search(r"step (\S+) s .* below (\S+) m/s.* step of (\S+) s, slip_speed = (\S+) m/s", words)
    assert found is not None
    assert found[2] == found[4]
    return float(found[1]), float(found[2]), float(found[3])


def test_the_speed_that_jumps_to_and_fro() -> None:
    """mu N h / m: in proportion to the step, whatever the slip_speed; for that a step is short enough."""
    first, second = scene(1e-3, 1e-5), scene(2e-3, 1e-5)
    term = max(first.system.forces.kernels, key=lambda kernel: kernel.friction_rate)
    push = term.friction_rate * 1e-3  # mu N / m of what is lightest [m/s2]
    for start, slip in ((first, 1e-3), (second, 2e-3)):
        largest = max(item.friction_rate for item in start.system.forces.kernels)
        assert largest == pytest.approx(push / slip, rel=1e-9)
        for factor in (100.0, 300.0):
            step, speed, enough = told(start, factor)
            assert step == pytest.approx(factor * 1e-5, rel=5e-3)
            assert speed == pytest.approx(push * factor * 1e-5, rel=0.05)
            assert enough < step
    assert told(second, 100.0)[2] > 1.2 * told(first, 100.0)[2]
    assert list(friction_warnings(first.system, replace(first.plan, step=0.9 * told(first, 100.0)[2]))) == []
    assert list(friction_warnings(first.system, replace(first.plan, step=None))) == []
