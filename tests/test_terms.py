"""Terms of the effects: one force in every form, nothing left of absent ones, a closed energy balance."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import CASES, EFFECTS, model, planar, states, text_of

from exunet.forces.cable import Law, elastic_energy, tension, viscous_tension
from exunet.forces.cable_term import CableTerm, ElementLaw, breaking_lengths
from exunet.forces.loops import Elements
from exunet.forces.total import Forces
from exunet.integrators.compiled.loop import CompiledIntegration, loop_kernel
from exunet.integrators.exudyn.probe import Probe
from exunet.integrators.protocol import Batch
from exunet.kernels.kernel import Kernel, term_kernel
from exunet.methods.method import Plan
from exunet.model import energy
from exunet.model.system import System
from exunet.scene.casefile import load
from exunet.simulation.preparation import Start, prepare
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


# What an effect adds to the items of the engine; the mass points and connectors are always there.
ITEMS = {
    (): 0,
    ("rayleigh_damping",): 1,
    ("gravity",): 1,
    ("rayleigh_damping", "gravity", "mass_damping"): 1,
    ("linear orbit",): 1,
    ("material_damping",): 0,
    ("thermal_strain",): 0,
    ("two-body orbit",): 3,  # the Coriolis force is a constant matrix; two objects take the kernel term
}


@pytest.mark.parametrize("on", ITEMS, ids="+".join)
def test_absent_effects_have_no_item(on: tuple[str, ...]) -> None:
    items = model(planar('engine.backend="exudyn"', on=on)).items()
    assert items.pop("MassPoint") == 40
    assert items.pop("ObjectConnectorSpringDamper") == 64
    assert items == ({"ObjectGenericODE2": ITEMS[on]} if ITEMS[on] else {})


MARKS = {
    "rayleigh_damping": "add_velocity_product",
    "material_damping": "add_viscous_tension",
    "gravity": "add_load",
    "linear orbit": "add_position_product",
    "two-body orbit": "add_two_body",
}


def test_absent_effects_have_no_code_and_no_data() -> None:
    bare = Kernel(Forces.of(planar().net))
    assert [type(data) for data in bare.table().data] == [Elements]
    assert not any(mark in text_of(bare) for mark in MARKS.values())
    for name, mark in MARKS.items():
        start = planar(on=[name])
        present = text_of(Kernel(start.system.forces))
        assert mark in present
        others = {other for other in MARKS.values() if other != mark}
        if "orbit" in name:  # has a Coriolis force
            others.remove("add_velocity_product")
        assert not any(other in present for other in others), name


def test_zero_coefficients_are_absent() -> None:
    for keys in ("mass_damping={alpha=0.0}", "material_damping={relaxation_time=0.0}"):
        assert not planar(f"effects.{keys}").system.forces.dissipates


def integrate(start: Start, end: float, times: int, tolerance: float, compiled: bool = True) -> Batch:
    """States, with the energy taken out; small nets are interpreted faster than compiled."""
    plan = Plan("DOPRI5", tolerance=tolerance, first_step=1e-6, least_step=1e-12)
    kernel = loop_kernel(start.system, compiled=compiled)
    return CompiledIntegration(start.system, start.state, plan, kernel).through(np.linspace(0.0, end, times))


def balance(start: Start, states: Batch) -> float:
    """Largest change of the total over the energy turned over: the range of its parts, added."""
    x, forces = states.position, start.system.forces
    parts = [
        energy.kinetic(start.system.mass, states.velocity),
        energy.elastic(forces, x),
        energy.potential(forces, x.reshape(len(x), -1)),
        states.taken,
    ]
    return float(np.ptp(sum(parts)) / sum(np.ptp(part) for part in parts))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_the_energy_balance_closes_for_any_subset(seed: int) -> None:
    """To 1e-5 of the energy turned over (issue 6), here through taut and slack states."""
    random = np.random.default_rng(seed)
    names = [name for name in EFFECTS if "orbit" not in name and random.random() < 0.5]
    if "gravity" not in names:  # which an orbit excludes
        names.append(("linear orbit", "two-body orbit")[random.integers(2)])
    start = planar("initial.packing = 0.99", "initial.spin = [0.3, 0.2, 1.0]", on=names)
    assert balance(start, integrate(start, 0.05, 6, 1e-9)) < 1e-5, names


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


def test_the_potential_of_two_bodies_is_that_of_its_force() -> None:
    start = planar(on=("two-body orbit",))
    forces = start.system.forces
    position, push = states(start)["mixed"][0], 1e-3 * np.random.default_rng(5).normal(size=(40, 3))
    ahead, behind = (
        energy.potential(forces, (position + sign * push).reshape(1, -1))[0] for sign in (1.0, -1.0)
    )
    force = term_kernel(forces.kernels).forces(0.0, position, push)
    assert -(ahead - behind) / 2.0 == pytest.approx(float((force * push).sum()), rel=1e-6)
    assert energy.potential(forces, np.zeros((1, 120)))[0] == 0.0


def lone(keys: str, position: tuple[float, ...], velocity: tuple[float, ...]) -> Start:
    """Two heavy nodes and a cable too soft to hold them, so both are free: the second starts as told."""
    start = prepare(load(CASES / "verification" / "rotating.toml", [f"effects={{{keys}}}"]).scene)
    place, speed = 0.1 * start.net.reference_position, np.zeros((2, 3))
    place[1], speed[1] = position, velocity
    soft = replace(start.net, youngs_modulus=np.full(1, 1e-30))
    blocks = replace(start.system.blocks, net=soft)
    forces = replace(start.system.forces, cable=CableTerm(soft))
    return replace(start, system=System(blocks, forces)).moved(place, speed)


def test_the_linear_orbit_is_that_of_clohessy_and_wiltshire() -> None:
    """Their state transition matrix over one orbit (Vallado, eq. 6-23 of the 3rd edition), to 1e-9."""
    n = 1.1e-3
    start = lone(
        'orbit={mean_motion=1.1e-3, radial=[1.0,0.0,0.0], along_track=[0.0,1.0,0.0], model="linear"}',
        (0.1, -0.2, 0.05),
        (1e-6, 2e-6, -3e-6),
    )
    end = 2.0 * math.pi / n
    states = integrate(start, end, 7, 1e-14, compiled=False)
    time, x = states.time, states.position
    (x0, y0, z0), (u0, v0, w0) = start.position[1], start.velocity[1]
    s, c = np.sin(n * time), np.cos(n * time)
    expected = np.array(
        [
            u0 / n * s - (3 * x0 + 2 * v0 / n) * c + 4 * x0 + 2 * v0 / n,
            (6 * x0 + 4 * v0 / n) * s + 2 * u0 / n * c - (6 * n * x0 + 3 * v0) * time + y0 - 2 * u0 / n,
            z0 * c + w0 / n * s,
        ]
    ).T
    assert np.abs(x[:, 1] - expected).max() < 1e-9 * np.abs(expected).max()


def test_two_bodies_keep_energy_and_angular_momentum_in_the_inertial_frame() -> None:
    n, mu = 1.1e-3, 3.986004418e14  # docs/theory.md
    radius = (mu / n**2) ** (1 / 3)
    start = lone(
        'orbit={mean_motion=1.1e-3, radial=[1.0,0.0,0.0], along_track=[0.0,1.0,0.0], model="two_body"}',
        (3e4, -1e4, 2e4),
        (5.0, -20.0, 10.0),
    )
    states = integrate(start, math.pi / n, 5, 1e-9, compiled=False)
    place = states.position[:, 1] + [radius, 0.0, 0.0]
    speed = states.velocity[:, 1] + np.cross([0.0, 0.0, n], place)
    total = 0.5 * (speed**2).sum(axis=1) - mu / np.linalg.norm(place, axis=1)
    spin = np.linalg.norm(np.cross(place, speed), axis=1)
    assert np.ptp(total) < 1e-12 * abs(total[0])
    assert np.ptp(spin) < 1e-12 * spin[0]


def test_mass_damping_decays_at_its_rate() -> None:
    start = lone("mass_damping={alpha=2.0}", (0.1, 0.0, 0.0), (0.02, 0.03, -0.01))
    states = integrate(start, 1.0, 5, 1e-13, compiled=False)
    expected = np.exp(-2.0 * states.time)[:, None] * start.velocity[1]
    np.testing.assert_allclose(states.velocity[:, 1], expected, rtol=1e-9)


def test_viscous_stress_never_pushes_and_never_gives_energy() -> None:
    """docs/theory.md: S11 = max(E (E11 + tau dE11/dt), 0) where E11 > 0, zero elsewhere."""
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


def test_a_free_strain_is_a_change_of_length() -> None:
    """E (E11 - e) A L / L0 and E A L0 (E11 - e)^2 / 2, written out, against the changed element."""
    net = planar().net
    free = np.linspace(-0.1, 0.1, net.n_elements)
    law = Law.of(net, free)
    length = net.reference_length * 1.3
    strain = 0.5 * (1.3**2 - 1.0) - free
    np.testing.assert_allclose(
        tension(length, law.natural_length, law.stiffness), net.axial_stiffness * strain * 1.3, rtol=1e-12
    )
    expected = 0.5 * (net.axial_stiffness * net.reference_length) @ strain**2
    changed = CableTerm(net, ElementLaw(free_strain=free)).law
    assert elastic_energy(changed, length) == pytest.approx(expected, rel=1e-12)


def test_a_free_strain_does_not_count_at_a_break() -> None:
    """docs/theory.md: the limit is of E11 - e, a force that of EA (E11 - e) L / L0."""
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
