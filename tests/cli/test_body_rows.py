"""Masses, axes and step of a scene with bodies, in `exunet check` and in the table of a run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES

import exunet
from exunet.cli.check import describe
from exunet.results.measures import momentum_books, moving_mass
from exunet.results.summary import summarise
from exunet.results.table import rows


def test_nodes_on_bodies_count_once() -> None:
    """Two satellites of 50 kg, a node of 1 kg, and a tether of 0.3 g whose two nodes are the satellites'."""
    case = exunet.load(CASES / "bodies" / "dumbbell.toml", ("time.end=10.0",))
    tether = np.pi / 4.0 * 0.002**2 * 100.0
    described = dict(describe(case))
    assert described["mass"].startswith(f"{1.0 + tether:.6f} kg")
    assert f"{101.0 + tether:.8g} kg in all" in described["mass"]
    assert f"{0.5 * tether:g} kg" in described["body above"]
    result = exunet.run(case)
    assert moving_mass(result) == pytest.approx(101.0 + tether, rel=1e-14)
    summary = summarise(result)
    table = dict(rows(summary, every=True))
    assert table["mass"] == described["mass"]
    assert table["body above"].startswith(f"{50.0 + 0.5 * tether:.6g} kg")
    nodes = sum(item["mass_of_nodes_kg"] for item in summary["bodies"].values())
    every = summary["mass_kg"] - nodes + sum(entry["mass_kg"] for entry in summary["bodies"].values())
    assert summary["mass_of_all_kg"] == pytest.approx(every, rel=1e-14)
    parts = [50.0 + 0.5 * tether, 50.0 + 0.5 * tether, 1.0]
    speeds = [*(body.velocity for body in result.bodies.values()), result.velocity[:, 0]]
    shares = sum(mass * np.linalg.norm(v, axis=1) for mass, v in zip(parts, speeds, strict=True))
    assert momentum_books(result)["linear"].size == pytest.approx(shares.max(), rel=1e-12)


BODY_ALONE = """
format = 1
title = "A body alone"
time = {{ end = 1.0, output_step = 0.1 }}
initial = {{ packing = 1.0 }}
solver = {{ method = "{method}" }}
bodies.target = {{ mass = 1.0, inertia = [1.0, 1.0, 1.0], position = [5.0, 0.0, 0.0] }}
[net]
topology = "explicit"
nodes = [[0.0, 0.0, 0.0]]
elements = []
node_masses = [1.0]
cable = {{ diameter = 0.001, density = 1000.0, youngs_modulus = 1e9 }}
"""


@pytest.mark.parametrize("method", ["auto", "RK44", "VelocityVerlet"])
def test_without_elements_no_step_is_infinite(tmp_path: Path, method: str) -> None:
    path = tmp_path / "alone.toml"
    path.write_text(BODY_ALONE.format(method=method))
    described = dict(describe(exunet.load(path)))
    assert not re.search(r"\binf\b", " ".join(described.values()))
    if method != "auto":  # 0.1 s lie between stored times
        assert described["method"] == f"{method}, 10 steps of 0.1 s"
    damped = dict(describe(exunet.load(path, ["effects.mass_damping.alpha=0.5"])))
    assert damped["stable step"].startswith("2 s (VelocityVerlet)")  # bound: 2 alpha
