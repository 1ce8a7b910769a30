"""An edge of a net that becomes shorter, in scenes and in all forms of the engine."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import BACKENDS

import exunet
from exunet.base.errors import CaseError
from exunet.forces import perimeter
from exunet.simulation.preparation import prepare_case

Floats = np.ndarray

EVERY = pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)


def state(result: exunet.Result, name: str) -> Floats:
    return np.asarray(result.states[f"closing/{name}"].values[:])[:, 0]


SQUARE = """
format = 1
title = "An edge that becomes shorter"
time = { end = 0.4, output_step = 0.02 }
solver = { method = "RK44", step = 1e-4 }
initial.packing = 1.0
net.topology = "square"
net.size = 1.0
net.mesh = 0.5
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 1e8 }
net.bullets = { mass = 0.02 }
effects.material_damping.relaxation_time = 1e-3
closing = { kind = "perimeter", at = 0.1, rate = 2.0, part = 0.6 }
"""


def square(folder: Path, *overrides: str) -> exunet.Case:
    path = folder / "square.toml"
    path.write_text(SQUARE)
    return exunet.load(path, overrides)


@pytest.mark.slow_for("exudyn")
@EVERY
@pytest.mark.parametrize("damped", [False, True])
def test_an_edge_that_becomes_shorter(tmp_path: Path, form: str, damped: bool) -> None:
    """From 0.1 s on for 0.2 s, to 0.6 of its length; the tension follows from that, and the books close."""
    result = exunet.run(square(tmp_path, form, *([] if damped else ["effects.material_damping="])))
    part = state(result, "part")
    exact = np.clip(1.0 - 2.0 * (result.time - 0.1), 0.6, 1.0)
    np.testing.assert_allclose(part, exact, atol=1e-12)
    ends = result.net.element_nodes
    outer = (np.abs(result.net.reference_position[ends][..., :2]).max(axis=2) > 0.49).all(axis=1)
    assert outer.sum() == 8
    assert not result.tension[result.time < 0.1].any()
    length = np.linalg.norm(np.diff(result.position[:, ends], axis=2)[:, :, 0], axis=2)
    stretch = length / (0.5 * part[:, None])
    strain = 0.5 * (stretch**2 - 1.0)
    np.testing.assert_allclose(result.strain[:, outer], strain[:, outer], rtol=1e-10, atol=1e-12)
    elastic = 1e8 * math.pi * 0.0005**2 * np.maximum(strain, 0.0) * stretch
    assert (result.tension[:, outer] > 0.1).any()
    if not damped:
        np.testing.assert_allclose(result.tension[:, outer], elastic[:, outer], rtol=1e-9, atol=1e-12)
    balance = result.kinetic + result.elastic + result.potential + result.dissipated
    work = state(result, "work")[-1]
    assert work > 0.01
    assert np.ptp(balance) < 1e-5 * work
    assert np.abs(result.momentum).max() < 1e-12
    words = [item["event"] for item in result.provenance["closing"]]
    assert words == ["the edge begins to become shorter", "the edge is as short as it gets"]


def test_arrays_and_loops_say_the_same_of_an_edge(tmp_path: Path) -> None:
    """Two forms of one law, which are written apart."""
    start = prepare_case(square(tmp_path))
    shortening = start.system.forces.cable.shortening
    assert shortening is not None
    rng = np.random.default_rng(3)
    x, v = start.system.layout.pack(start.state.moving)
    x = x + rng.normal(scale=0.1, size=len(x))
    x[int(start.system.blocks.state("closing/part"))] = 0.8
    v, memory = rng.normal(size=len(v)), {"closing/perimeter": np.ones(1)}
    _, strain, tension = shortening.seen(memory, x[None], v[None])
    data = shortening.data(np.ones(1))
    assert np.count_nonzero(tension) > 2
    for e in range(8):
        _, _, elastic, of_loop, _ = perimeter.threads_pull(x, v, data, e)
        assert tension[0, e] == pytest.approx(of_loop, rel=1e-12)
        assert max(strain[0, e], 0.0) == pytest.approx(elastic, rel=1e-12, abs=1e-15)


def test_what_a_perimeter_excludes(tmp_path: Path) -> None:
    bends: Any = "effects.bending.modulus=1e6"
    with pytest.raises(CaseError, match="excludes closing"):
        square(tmp_path, bends)
