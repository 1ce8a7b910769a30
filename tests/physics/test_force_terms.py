"""Terms of the effects: the same force on both backends, viscous stress, free strain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import EFFECTS, model, planar, states

from exunet.forces.cable import viscous_tension
from exunet.forces.cable_term import CableTerm, ElementLaw, breaking_lengths
from exunet.forces.law import tension
from exunet.forces.total import Forces
from exunet.integrators.exudyn.probe import Probe
from exunet.kernels.kernel import Kernel
from exunet.simulation.preparation import Start
from exunet.simulation.run import simulate

SUBSETS = [
    (),
    *((name,) for name in EFFECTS),
    ("rayleigh_damping", "material_damping", "two-body orbit"),
    ("gravity", "rayleigh_damping", "thermal_strain"),
    ("mass_damping", "material_damping", "linear orbit", "thermal_strain"),
]


def accelerations(start: Start) -> dict[str, Any]:
    probe = Probe(model(start))
    return {name: probe.accelerations(*state) for name, state in states(start).items()}


@pytest.mark.parametrize("on", SUBSETS, ids="+".join)
def test_both_backends_have_the_same_forces(on: tuple[str, ...]) -> None:
    """The connectors state the element law with square roots, the kernel without: kept apart on purpose."""
    start = planar(on=on)
    kernel = Kernel(start.system.forces)
    exudyn = accelerations(start)
    for name, (position, velocity) in states(start).items():
        compiled = kernel.forces(0.0, position, velocity) / start.net.mass[:, None]
        scale = np.abs(compiled).max()
        assert np.abs(exudyn[name] - compiled).max() <= 1e-12 * scale, name
    assert np.abs(kernel.forces(0.0, *states(start)["overstretched"])).max() > 1.0


def test_interpreted_and_compiled_kernels_are_one() -> None:
    start = planar(on=("rayleigh_damping", "material_damping", "two-body orbit"))
    kernel = Kernel(start.system.forces)
    plain = Kernel(start.system.forces, compiled=False)
    for position, velocity in states(start).values():
        force = plain.forces(0.0, position, velocity).ravel()
        compiled = kernel.forces(0.0, position, velocity).ravel()
        np.testing.assert_allclose(force, compiled, rtol=1e-13, atol=1e-13 * np.abs(compiled).max())


@pytest.mark.slow
def test_work_is_integrated_in_the_engine_as_in_the_loop() -> None:
    """The monitor's Simpson rule in NumPy against the compiled one, on equal steps."""
    on = ("rayleigh_damping", "material_damping", "two-body orbit")
    settings = ("initial.packing = 1.001", "time.end = 0.004", "time.output_step = 0.002")
    solver = 'solver = {method = "RK44", step = 1e-5}'
    runs = [
        simulate(planar(*settings, solver, f'engine.backend = "{loop}"', on=on))
        for loop in ("exudyn", "compiled")
    ]
    assert runs[0].dissipated[-1] > 1e-3
    np.testing.assert_allclose(runs[1].dissipated, runs[0].dissipated, rtol=1e-9)
    np.testing.assert_allclose(runs[1].potential, runs[0].potential, rtol=1e-9, atol=1e-12)


def test_viscous_stress_never_pushes_and_never_gives_energy() -> None:
    """theory_effects.md: S11 = max(E (E11 + tau dE11/dt), 0) where E11 > 0, zero elsewhere."""
    random = np.random.default_rng(8)
    length, rate = random.uniform(0.5, 1.5, 1000), random.normal(size=1000)
    force = viscous_tension(length, rate, 1.0, 7.0, 0.3)
    elastic = tension(length, 1.0, 7.0)
    assert (force >= 0.0).all()
    assert (force[length <= 1.0] == 0.0).all()
    assert ((force - elastic) * rate >= 0.0).all()
    slow = (length > 1.0) & (np.abs(rate) < 0.01)
    strain = 0.5 * (length**2 - 1.0)
    expected = 7.0 * (strain + 0.3 * length * rate) * length
    np.testing.assert_allclose(force[slow & (expected > 0)], expected[slow & (expected > 0)], rtol=1e-12)


def test_material_damping_leaves_a_rigid_motion_alone() -> None:
    """Rayleigh damping (eq. 13) brakes it: that is what an objective one is for."""
    position = 1.1 * planar().net.reference_position
    velocity = np.cross([0.3, 0.4, 0.5], position) + np.array([1.0, 2.0, 3.0])

    def added_by(name: str) -> float:
        start = planar(on=(name,))
        with_it, without = (Kernel(forces) for forces in (start.system.forces, Forces.of(start.net)))
        return float(
            np.abs(with_it.forces(0.0, position, velocity) - without.forces(0.0, position, velocity)).max()
        )

    assert added_by("material_damping") < 1e-9 * net_force_scale(position)
    assert added_by("rayleigh_damping") > 0.1


def net_force_scale(position: Any) -> float:
    """Largest elastic force on a node [N]."""
    return float(np.abs(Kernel(Forces.of(planar().net)).forces(0.0, position, 0.0 * position)).max())


def test_a_free_strain_does_not_count_at_a_break() -> None:
    """docs/explanation/theory_effects.md: the limit is of E11 - e, a force that of EA (E11 - e) L / L0."""
    net = planar().net
    free = np.linspace(-0.1, 0.1, net.n_elements)
    by_strain = ElementLaw(free_strain=free, breaking_strain=np.full(net.n_elements, 0.03))
    stretch = breaking_lengths(CableTerm(net, by_strain)) / net.reference_length
    np.testing.assert_allclose(0.5 * (stretch**2 - 1.0) - free, 0.03, rtol=1e-12)
    by_force = ElementLaw(free_strain=free, breaking_force=np.full(net.n_elements, 500.0))
    stretch = breaking_lengths(CableTerm(net, by_force)) / net.reference_length
    np.testing.assert_allclose(
        net.axial_stiffness * (0.5 * (stretch**2 - 1.0) - free) * stretch, 500.0, rtol=1e-9
    )
