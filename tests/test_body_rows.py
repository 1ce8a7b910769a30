"""What `exunet check` and the table of a run say of the masses, the axes and the start of bodies."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.cli.check import body_rows, describe, vector
from exunet.results.measures import momentum_books, moving_mass
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case

CASES = Path(__file__).parents[1] / "cases" / "bodies"


def test_every_body_has_its_axes_and_no_round_off() -> None:
    """The target of the tow starts 1e-21 m off its axis, of 10 m."""
    for path in CASES.glob("*.toml"):
        start = prepare_case(exunet.load(path))
        found = dict(body_rows(start))
        for body in start.system.bodies:
            assert found[f"body {body.name}"].startswith(f"{body.mass:g} kg, free")
            assert "m in the body's frame" in found[f"{body.name}: centre of mass"]
            assert found[f"{body.name}: inertia"].count("(") == 3
            assert "of the body's frame" in found[f"{body.name}: inertia"]
            moving = found[f"{body.name}: at the start"]
            for axes in ("m/s in the scene's axes", "rad/s in the body's axes", "rad/s in the scene's"):
                assert axes in moving
        assert not re.search(r"e-(1[2-9]|2)|-0[,)]", " ".join(found.values())), path


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([10.0, 1e-6, -1e-21], "(10, 1e-06, 0)"),
        ([-1e-17, 0.0, 0.0], "(0, 0, 0)"),
        ([-0.0, 2e-8, 0.0], "(0, 2e-08, 0)"),
    ],
)
def test_round_off_is_zero(values: list[float], words: str) -> None:
    assert vector(np.array(values)) == words


def test_nodes_on_bodies_count_once() -> None:
    """Two satellites of 50 kg, a node of 1 kg, and a tether of 0.3 g whose two nodes are the satellites'."""
    case = exunet.load(CASES / "dumbbell.toml", ("time.end=10.0",))
    tether = np.pi / 4.0 * 0.002**2 * 100.0
    told = dict(describe(case))
    words = f"{1.0 + tether:.6f} kg of the net, of which {tether:.6g} kg are nodes fixed to bodies and count "
    assert told["mass"] == f"{words}with these; {101.0 + tether:.8g} kg in all"
    assert f"{0.5 * tether:g} kg of it are nodes fixed to it: 1" in told["body above"]
    result = exunet.run(case)
    assert moving_mass(result) == pytest.approx(101.0 + tether, rel=1e-14)
    summary = summarise(result)
    table = dict(rows(summary))
    assert table["mass"] == told["mass"]
    words = f"{50.0 + 0.5 * tether:.6g} kg, of which {0.5 * tether:.6g} kg are nodes of the net fixed to it"
    assert table["body above"] == words
    nodes = sum(item["mass_of_nodes_kg"] for item in summary["bodies"].values())
    every = summary["mass_kg"] - nodes + sum(entry["mass_kg"] for entry in summary["bodies"].values())
    assert summary["mass_of_all_kg"] == pytest.approx(every, rel=1e-14)
    parts = [50.0 + 0.5 * tether, 50.0 + 0.5 * tether, 1.0]
    speeds = [*(body.velocity for body in result.bodies.values()), result.velocity[:, 0]]
    shares = sum(mass * np.linalg.norm(v, axis=1) for mass, v in zip(parts, speeds, strict=True))
    assert momentum_books(result)["linear"].size == pytest.approx(shares.max(), rel=1e-12)


@pytest.mark.ci
@pytest.mark.slow
def test_a_net_without_bodies_has_one_mass() -> None:
    case = exunet.load(CASES.parent / "planar_deployment.toml")
    assert dict(describe(case))["mass"] == "2.360819 kg"


BODY_ALONE = """
format = 1
title = "A body alone"
time = {{ end = 1.0, output_step = 0.1 }}
initial = {{ packing = 1.0 }}
solver = {{ method = "{method}" }}

[net]
topology = "explicit"
nodes = [[0.0, 0.0, 0.0]]
elements = []
node_masses = [1.0]
cable = {{ diameter = 0.001, density = 1000.0, youngs_modulus = 1e9 }}

[bodies.target]
mass = 1.0
inertia = [1.0, 1.0, 1.0]
position = [5.0, 0.0, 0.0]
"""


@pytest.mark.parametrize("method", ["auto", "RK44", "VelocityVerlet"])
def test_without_elements_no_step_is_called_infinite(tmp_path: Path, method: str) -> None:
    path = tmp_path / "alone.toml"
    path.write_text(BODY_ALONE.format(method=method), encoding="utf-8")
    every = describe(exunet.load(path))
    told = dict(every)
    assert told["stable step"].startswith("any")
    assert not re.search(r"\binf\b", " ".join(words for _, words in every))
    if method != "auto":  # 0.1 s lie between stored times
        assert told["method"] == f"{method}, step 0.1 s"
        assert any(words.startswith("step = that between stored times") for _, words in every)
    damped = dict(describe(exunet.load(path, ["effects.mass_damping.alpha=0.5"])))
    assert damped["stable step"].startswith("2 s (VelocityVerlet)")  # bound: 2 alpha
