"""What `exunet effects` says of contact beforehand: when and how hard it comes, what friction can change."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from contact_scenes import THROWN

from exunet.case.casefile import load
from exunet.forces.contact.foretold import restitution_at
from exunet.forces.contact.law import damping_of
from exunet.system.effect_survey import finding

CASES = Path(__file__).parents[2] / "cases"


def words(path: Path, *changes: str, name: str = "contact") -> str:
    """The source of an estimate."""
    one = finding(load(path, changes).scene, name)
    assert one.estimate is not None
    return one.estimate.source


# First contacts of runs, as the heads of the cases tell them; a ball 0.25 m before its middle at 2 m/s.
@pytest.mark.parametrize(
    ("case", "known"),
    [
        ("capture/fixed_sphere.toml", (0.5 - 0.25) / 2.0),
        ("capture/box.toml", 0.1846),
        ("missions/closed_box.toml", 0.155),
    ],
)
def test_when_contact_comes(case: str, known: float) -> None:
    found = re.search(r"threads reach \w+ at ([\d.]+) s", words(CASES / case))
    assert found is not None
    assert float(found[1]) == pytest.approx(known, rel=0.02)


def test_how_hard_it_comes_and_what_friction_can_change() -> None:
    """By hand: m v2 = k p2 of a bullet, rho A v2 = K p2 of a thread; mu (1 + e) v along the surface."""
    told = words(CASES / "capture" / "fixed_sphere.toml")
    line = 1390.0 * math.pi / 4.0 * 1e-3**2  # kg/m
    depth = 2.0 * math.sqrt(line / 1e3)
    assert f"a thread sinks in by {depth:.2g} m with {1e3 * depth:.2g} N/m" in told
    depth = 2.0 * math.sqrt(0.02 / 5e3)
    bullet = re.search(r"a bullet of 0\.02 kg and 0\.01 m by ([\d.]+) m with ([\d.]+) N", told)
    assert bullet is not None
    assert [float(one) for one in bullet.groups()] == pytest.approx([depth, 5e3 * depth], rel=0.02)
    assert "restitution at that speed 0.5" in told
    assert "friction changes speeds along the surface by up to 0.9 m/s" in told
    assert f"exp(mu pi) = {math.exp(0.3 * math.pi):.2g} times" in told
    without = words(CASES / "capture" / "fixed_sphere.toml", "effects.contact.friction=0.0")
    assert (
        "there is no friction; with 0.3 it would change speeds along the surface by up to 0.9 m/s" in without
    )


def test_a_net_that_flies_past_is_told_to() -> None:
    """1.2 m beside its way, with a radius of 0.25 m, and 0.735 m of the net."""
    told = words(CASES / "capture" / "miss.toml")
    found = re.search(r"threads come no nearer to ball than ([\d.]+) m", told)
    assert found is not None
    assert float(found[1]) == pytest.approx(1.2 - 0.25 - 0.735, abs=0.01)
    assert "restitution" not in told


def test_threads_meet_each_other_once_the_net_has_met_a_body() -> None:
    told = words(CASES / "capture" / "box.toml", name="self_contact")
    assert "after it has met box" in told
    assert float(told.split(" meetings")[0].split()[-1]) > 0.1


def test_a_body_that_comes_to_a_net_at_rest_is_told_too(tmp_path: Path) -> None:
    """A bullet of 1 cm, 1 cm before the face that the box of 0.1 m turns to it, at 1 m/s."""
    path = tmp_path / "scene.toml"
    path.write_text(THROWN)
    still = ["initial.velocity=[0.0, 0.0, 0.0]", "bodies.box.velocity=[0.0, 0.0, 1.0]"]
    assert "bullets reach box at 0.0198 s" in words(path, *still)


@pytest.mark.parametrize("restitution", [0.99, 0.5, 0.2])
def test_the_restitution_at_other_speeds_is_that_of_the_law(restitution: float) -> None:
    a = damping_of(restitution, 2.0)
    assert restitution_at(a, 2.0) == pytest.approx(restitution, abs=1e-9)
    e, d = restitution_at(a, 5.0), 5.0 * a
    assert d * (1.0 + e) == pytest.approx(math.log((1.0 + d) / (1.0 - e * d)), rel=1e-6)
    assert e < restitution
    assert restitution_at(a, 1e-9) == pytest.approx(1.0, abs=1e-6)
    assert restitution_at(0.0, 2.0) == 1.0
