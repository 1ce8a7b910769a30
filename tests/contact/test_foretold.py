"""What `exunet effects` says of contact beforehand: when and how hard it comes, what friction can change."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from contact_scenes import THROWN

from exunet.forces.contact.estimate import estimate_notes, restitution_at
from exunet.forces.contact.law import damping_of, hertz_of_line, hertz_of_sphere
from exunet.forces.contact.sphere_contact import SphereLaw
from exunet.forces.estimate import Approach
from exunet.model.effect_survey import finding
from exunet.scene.casefile import load

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
    estimate_notes = words(CASES / "capture" / "fixed_sphere.toml")
    line = 1390.0 * math.pi / 4.0 * 1e-3**2  # kg/m
    depth = 2.0 * math.sqrt(line / 1e3)
    assert f"a thread sinks in by {depth:.2g} m with {1e3 * depth:.2g} N/m" in estimate_notes
    depth = 2.0 * math.sqrt(0.02 / 5e3)
    bullet = re.search(r"a bullet of 0\.02 kg and 0\.01 m by ([\d.]+) m with ([\d.]+) N", estimate_notes)
    assert bullet is not None
    assert [float(group) for group in bullet.groups()] == pytest.approx([depth, 5e3 * depth], rel=0.02)
    assert "restitution at that speed 0.5" in estimate_notes
    assert "friction changes speeds along the surface by up to 0.9 m/s" in estimate_notes
    assert f"exp(mu pi) = {math.exp(0.3 * math.pi):.2g} times" in estimate_notes
    without = words(CASES / "capture" / "fixed_sphere.toml", "effects.contact.friction.coefficient=0.0")
    assert (
        "there is no friction; with 0.3 it would change speeds along the surface by up to 0.9 m/s" in without
    )


def test_a_net_that_flies_past_is_told_to() -> None:
    """1.2 m beside its way, with a radius of 0.25 m, and 0.735 m of the net."""
    estimate_notes = words(CASES / "capture" / "miss.toml")
    found = re.search(r"threads come no nearer to ball than ([\d.]+) m", estimate_notes)
    assert found is not None
    assert float(found[1]) == pytest.approx(1.2 - 0.25 - 0.735, abs=0.01)
    assert "restitution" not in estimate_notes


def test_threads_meet_each_other_once_the_net_has_met_a_body() -> None:
    estimate_notes = words(CASES / "capture" / "box.toml", name="self_contact")
    assert "after it has met box" in estimate_notes
    assert float(estimate_notes.split(" meetings")[0].split()[-1]) > 0.1


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


def test_all_that_is_told_of_two_meetings_is_by_hand() -> None:
    """Threads, nodes and bullets of a net; a free body, one that is driven, one that is passed by."""
    mass = np.array([0.02, 0.07, 0.05, 0.3])
    net: Any = SimpleNamespace(
        density=np.array([1000.0, 700.0, 9e9]), area=np.array([2e-6, 4e-6, 1.0]), n_net_elements=2,
        mass=mass, n_nodes=4, bullet_nodes=np.array([1, 3]),
    )  # fmt: skip
    basis: Any = SimpleNamespace(
        net=net, duration=20.0, held=lambda way: min(way, 3.0),
        approaches=(
            Approach("ball", "threads", 4.0, 2.0, 0.0, 0.5, 7),
            Approach("plate", "threads", 2.5, 1.5, 0.0, math.inf, 0),
            Approach("far", "threads", math.inf, 1.0, 0.123, 1.0, 5),
        ),
    )  # fmt: skip
    keys: Any = SimpleNamespace(
        threads=["ball", "plate", "far"], nodes=["a"], bullets=["b"], of_threads=900.0, a=0.25,
        rubbing=SimpleNamespace(friction=0.4),
        of_nodes=SphereLaw(5e3, 1.0, 0.25, 5e3), node_radius=0.011,
        of_bullets=SphereLaw(8e4, 1.5, 0.25, 5e3), bullet_radius=0.023,
    )  # fmt: skip
    found = list(estimate_notes(keys, basis))
    known: list[str] = []
    for body, time, v in (("ball", 4.0, 2.0), ("plate", 2.5, 1.5)):
        thread = v * math.sqrt(2.8e-3 / 900.0)
        node = v * math.sqrt(0.05 / 5e3)
        bullet = (1.25 * 0.3 * v * v / 8e4) ** 0.4
        e = restitution_at(0.25, v)
        total = 0.44 * 0.5 / 0.94 if body == "ball" else 0.44
        known += [
            f"threads reach {body} at {time:.3g} s with {v:.3g} m/s",
            f"a thread sinks in by {thread:.2g} m with {900.0 * thread:.2g} N/m",
            f"a node of 0.05 kg and 0.011 m by {node:.2g} m with {5e3 * node:.2g} N",
            f"a bullet of 0.3 kg and 0.023 m by {bullet:.2g} m with {8e4 * bullet**1.5:.2g} N",
            f"restitution at that speed {e:.2g}",
            f"stopping all of the net takes {total * v:.2g} N s",
        ]
        if body == "ball":
            known[-1] += f" and gives ball {total * v / 0.5:.2g} m/s"
            known.append("some 7 threads lie on one side of it, with which a right-hand side takes ")
            known[-1] += "7 us more, with friction or without"
    most = 0.4 * (1.0 + restitution_at(0.25, 1.5)) * 1.5
    known.append("far come no nearer")
    assert len(found) == len(known) + 1
    for one, other in zip(found, known, strict=False):
        assert one.startswith(other) or "come no nearer to far than 0.123 m in the 20 s of the nominal" in one
    assert found[-1] == (
        f"friction changes speeds along the surface by up to {most:.2g} m/s, 3 m until the end, and lets "
        f"tensions differ by exp(mu pi) = {math.exp(0.4 * math.pi):.2g} times over half a turn"
    )
    basis.duration = 3.0
    assert f"{0.5 * most:.2g} m until the end" in list(estimate_notes(keys, basis))[-1]
    keys.rubbing.friction = 0.0
    most = 0.3 / 0.4 * most
    assert f"with 0.3 it would change speeds along the surface by up to {most:.2g} m/s" in list(
        estimate_notes(keys, basis)
    )[-1]  # fmt: skip


@pytest.mark.parametrize("restitution", [1e-3, 0.2, 0.5, 0.9, 1.0 - 2e-5])
def test_damping_and_restitution_obey_the_law(restitution: float) -> None:
    """d (1 + e) = ln((1 + d) / (1 - e d)); near e = 1 it is 3/2 (1 - e), and no jump between both."""
    d = 4.0 * damping_of(restitution, 4.0)
    if restitution > 0.01:  # else e d is 1 to the last bit
        known = math.log1p(d) - math.log1p(-restitution * d)
        assert d * (1.0 + restitution) == pytest.approx(known, rel=1e-9)
    else:
        assert d == pytest.approx(1.0 / restitution, rel=1e-12)
    assert restitution_at(damping_of(restitution, 4.0), 4.0) == pytest.approx(restitution, abs=1e-9)


def test_near_one_it_is_the_usual_law() -> None:
    """a = 3 (1 - e) / (2 v0), e = 1 - 2/3 d."""
    assert damping_of(1.0, 4.0) == 0.0
    assert damping_of(1.0 - 2.0**-20, 4.0) == pytest.approx(1.5 * 2.0**-22, rel=1e-12)
    assert damping_of(1.0 - 1.01e-5, 4.0) == pytest.approx(1.5 * 1.01e-5 / 4.0, rel=2e-5)
    assert restitution_at(2.0**-22, 2.0) == pytest.approx(1.0 - 2.0 / 3.0 * 2.0**-21, rel=1e-15)
    assert restitution_at(5.05e-7, 2.0) == pytest.approx(1.0 - 2.0 / 3.0 * 1.01e-6, abs=1e-9)


def test_stiffness_by_hertz() -> None:
    """4/3 E* R^(1/2), and pi/4 E*."""
    assert hertz_of_sphere(3e5, 0.04) == pytest.approx(8e4, rel=1e-12)
    assert hertz_of_line(3e5) == pytest.approx(0.75e5 * math.pi, rel=1e-12)
