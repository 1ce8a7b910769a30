"""Forces, stiffness, damping of reference_impl against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from reference_impl import System, acceleration
from reference_impl import forces as mechanics


@pytest.fixture(scope="module", params=["square", "hexagonal", "radial"])
def shaken(request, document, scene):
    """A net with damping and gravity in a random state, some elements taut, some slack."""
    made = scene(
        document(request.param),
        {
            "effects.rayleigh_damping": {"alpha": 0.3, "beta": 1e-5},
            "effects.gravity.acceleration": [1.0, 2.0, -9.81],
        },
    )
    rng = np.random.default_rng(7)
    shape = made.net.reference_position.shape
    x = made.net.reference_position + 0.05 * rng.standard_normal(shape)
    return made.system, x, rng.standard_normal(shape), rng


def dense_forces(system, x):
    """Nodal forces element by element, as in the paper."""
    net, force = system.net, np.zeros_like(x)
    for e, (i, j) in enumerate(net.element_nodes):
        squared = float(np.sum((x[j] - x[i]) ** 2))
        e11 = 0.5 * (squared - net.reference_length[e] ** 2) / net.reference_length[e] ** 2  # eq. (6)
        s11 = net.youngs_modulus[e] * e11 if e11 >= 0 else 0.0  # eq. (8)
        pull = s11 * net.area[e] / net.reference_length[e] * (x[j] - x[i])  # eq. (3)
        force[j] += pull
        force[i] -= pull
    return force


def test_elastic_forces_are_those_of_the_secant_stiffness(shaken):
    system, x, _, _ = shaken
    e11 = mechanics.strain(system, x)
    assert (e11 > 0).any()
    assert (e11 < 0).any()
    force = mechanics.elastic_forces(system, x)
    size = np.abs(force).max()
    assert np.allclose(force, dense_forces(system, x), rtol=0, atol=1e-12 * size)
    assert np.allclose(force.ravel(), mechanics.secant(system, x) @ x.ravel(), rtol=0, atol=1e-11 * size)


@pytest.mark.parametrize("arithmetic", ["symmetric", "assembled"])
def test_other_arithmetic_gives_the_same_forces(shaken, arithmetic):
    system, x, v, _ = shaken
    other = System(system.net, system.effects, **{arithmetic: True})
    size = np.abs(acceleration(system, 0.0, x, v)).max()
    assert np.allclose(
        acceleration(system, 0.0, x, v), acceleration(other, 0.0, x, v), rtol=0, atol=1e-12 * size
    )


def test_symmetric_arithmetic_takes_elements_laid_twice(explicit, scene):
    double = scene(explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1], [0, 1], [1, 0]]), symmetric=True)
    single = scene(explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]]))
    x = np.array([[0.0, 0, 0], [1.1, 0, 0.1]])
    assert np.allclose(
        mechanics.elastic_forces(double.system, x), 3 * mechanics.elastic_forces(single.system, x)
    )


def test_stiffness_matrices_are_symmetric(shaken):
    system, x, _, _ = shaken
    for matrix in (mechanics.secant(system, x), mechanics.tangent(system, x), mechanics.damping(system)):
        assert abs(matrix - matrix.T).max() <= 1e-15 * abs(matrix).max()


def test_tangent_is_the_derivative_of_the_nodal_forces(shaken):
    """Eq. (5) against the complex step, which has no truncation error to speak of."""
    system, x, _, rng = shaken
    step = rng.standard_normal(x.shape)
    d = mechanics.span(system, x + 1e-30j * step)
    e11 = 0.5 * (mechanics.dot(d, d) / system.squared_reference_length - 1.0)
    pull = (np.where(e11.real >= 0, e11, 0.0) * system.axial_stiffness)[:, None] * d
    derivative = (system.incidence @ pull).imag / 1e-30
    tangent = (mechanics.tangent(system, x) @ step.ravel()).reshape(x.shape)
    assert np.allclose(tangent, derivative, rtol=0, atol=1e-12 * np.abs(derivative).max())
    h = 1e-6
    central = (
        mechanics.elastic_forces(system, x + h * step) - mechanics.elastic_forces(system, x - h * step)
    ) / (2 * h)
    assert np.allclose(tangent, central, rtol=0, atol=1e-8 * np.abs(central).max())


def test_element_tangent_against_the_closed_form(explicit, scene):
    """field.md: dN/dl = (E A / L0)(3 lambda^2 - 1)/2."""
    system = scene(explicit([[0.0, 0, 0], [2.0, 0, 0]], [[0, 1]])).system
    for stretch in (1.0, 1.01, 1.5):
        x = np.array([[0.0, 0, 0], [2.0 * stretch, 0, 0]])
        expected = system.axial_stiffness[0] * (3 * stretch**2 - 1) / 2
        assert mechanics.tangent_element(system, x)[0, 3, 3] == pytest.approx(expected, rel=1e-13)


def test_acceleration_is_equation_16(shaken):
    system, x, v, _ = shaken
    right = (system.weight - mechanics.elastic_forces(system, x)).ravel()
    right -= mechanics.damping(system) @ v.ravel()
    expected = right.reshape(x.shape) / system.net.mass[:, None]
    assert np.allclose(acceleration(system, 0.0, x, v), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert mechanics.motion(system, 0.0, x, v)[1] == pytest.approx(
        v.ravel() @ (mechanics.damping(system) @ v.ravel())
    )


def test_coincident_nodes_give_no_nan(document, scene):
    folded = scene(
        document(), {"initial.packing": 0.0, "effects.rayleigh_damping": {"alpha": 1.0, "beta": 1.0}}
    )
    assert np.isfinite(acceleration(folded.system, 0.0, folded.x0, folded.v0)).all()
    assert np.isfinite(mechanics.tangent(folded.system, folded.x0).data).all()
    assert not mechanics.tension(folded.system, folded.x0).any()


def test_fixed_nodes_do_not_accelerate(explicit, scene):
    case = explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]], fixed=[0])
    hung = scene(case, {"effects.gravity.acceleration": [9.81, 0.0, 0.0]})
    assert np.allclose(acceleration(hung.system, 0.0, hung.x0, hung.v0), [[0, 0, 0], [9.81, 0, 0]])
