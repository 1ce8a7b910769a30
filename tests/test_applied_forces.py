"""Forces that a kernel computes in the engine: their evaluation, their Jacobian, without Numba."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import CASES, model, planar, states

from exunet.integrators.exudyn.build import Linearised
from exunet.integrators.exudyn.probe import Probe
from exunet.kernels import kernel as kernels
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare


def test_the_jacobian_is_the_derivative_of_the_kernel_terms() -> None:
    """Central differences along random directions."""
    start = planar(on=("two-body orbit",))
    forces = start.system.forces
    kernel, linearised = kernels.term_kernel(forces.kernels), Linearised(start.system.blocks, forces)
    random, (position, velocity) = np.random.default_rng(2), states(start)["mixed"]
    push = 1e-3 * random.normal(size=position.shape)
    ahead, behind = (kernel.forces(0.0, position + sign * push, velocity) for sign in (1.0, -1.0))
    matrix = linearised(0.0, position.ravel(), velocity.ravel(), 1.0, 0.0)
    expected = -(ahead - behind).ravel() / 2.0
    assert np.abs(expected).max() > 0.0
    assert np.abs(matrix @ push.ravel() - expected).max() <= 1e-6 * np.abs(expected).max()


def test_without_numba_kernel_terms_are_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    start = planar(on=("two-body orbit",))
    state = states(start)["mixed"]
    compiled = Probe(model(start)).accelerations(*state)
    kernels.term_kernel.cache_clear()
    monkeypatch.setattr(kernels, "numba_installed", lambda: False)
    interpreted = Probe(model(start)).accelerations(*state)
    kernels.term_kernel.cache_clear()
    assert np.abs(interpreted - compiled).max() <= 1e-13 * np.abs(compiled).max()


def test_forces_and_rates_of_one_state_come_of_one_evaluation() -> None:
    """Rates are looked up where forces, memories and state are the same; a number put there shows it."""
    start = prepare(load(CASES / "capture" / "free_sphere.toml", ["engine.backend=exudyn"]).scene)
    made = model(start)
    applied, blocks, (q, v, _) = made.applied, start.system.blocks, made.coordinates()
    place, out = applied.place, np.zeros(made.n_coordinates)
    rates = slice(blocks.n_v, blocks.n_force)

    def evaluated_anew(time: float, speed: Any) -> bool:
        place.force[rates] = 7.0
        return not (applied.rates(time, q, speed) == 7.0).all()

    assert blocks.n_states > 0
    applied.evaluate(0.5, q, v, out)
    assert not evaluated_anew(0.5, v)
    assert evaluated_anew(0.5, v + 1e-9)
    assert not evaluated_anew(0.5, v + 1e-9)
    assert evaluated_anew(0.6, v)
    applied.push(np.ones((blocks.n_points, 3)))
    assert evaluated_anew(0.6, v)
    applied.accepted(0.6, q, v)
    assert evaluated_anew(0.6, v)
    applied.remember(start.state.memory)
    assert evaluated_anew(0.6, v)
