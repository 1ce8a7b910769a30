"""Frequencies and stable steps, against closed forms and against the engine."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array

from exunet.forces.cable import (
    assemble_pairs,
    reference_blocks,
    reference_spans,
    reference_tangent_stiffness,
)
from exunet.forces.linear_term import LinearTerm
from exunet.forces.total import Forces
from exunet.methods.method import METHODS, Method
from exunet.model.stability import (
    _largest_eigenvalue,
    largest_damping_rate,
    largest_frequency,
    stable_step,
    step_limit,
)
from exunet.model.system import System
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare

E, RHO, D = 70e9, 1390.0, 0.002
AREA = math.pi / 4 * D**2


def square_net(cells: int, **more: object) -> Scene:
    cable = {"diameter": D, "density": RHO, "youngs_modulus": E}
    net = {"topology": "square", "size": float(cells), "mesh": 1.0, "cable": cable}
    return Scene.model_validate(
        {
            "format": 1,
            "title": "a square net",
            "time": {"end": 1.0, "output_step": 1.0},
            "net": net,
            "initial": {"packing": 1.0},
        }
        | more
    )


def oscillator(**more: object) -> Scene:
    """A mass of 1 kg on a massless-looking cable of 1 m, tied to the ground and kept taut by its start."""
    net = {
        "topology": "explicit",
        "nodes": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        "elements": [[0, 1]],
        "node_masses": [0.0, 1.0],
        "fixed": [0],
        "cable": {"area": 1e-6, "density": 2e-6, "youngs_modulus": 1e8},
    }
    return Scene.model_validate(
        {"format": 1, "title": "a mass on a cable", "time": {"end": 1.0, "output_step": 1.0}, "net": net,
         "initial": {"packing": 1.0}} | more
    )  # fmt: skip


@pytest.mark.parametrize(("cells", "factor"), [(5, 1.251), (10, 1.234), (25, 1.227)])
def test_verlet_step_of_square_nets(cells, factor):
    """field.md: 1.251, 1.234, 1.227 times mesh over wave speed, from eigenvalues."""
    start = prepare(square_net(cells))
    step = stable_step("VelocityVerlet", largest_frequency(start.system))
    assert step == pytest.approx(factor / math.sqrt(E / RHO), rel=1e-3)


@pytest.mark.parametrize("size", [40, 400])
def test_the_largest_eigenvalue_is_found_from_above(size):
    """Of a chain of masses and springs, 2 + 2 cos(pi / (n + 1)); Lanczos' method adds its tolerance, 1e-6."""
    chain = diags_array([-np.ones(size - 1), 2.0 * np.ones(size), -np.ones(size - 1)], offsets=[-1, 0, 1])
    known = 2.0 + 2.0 * math.cos(math.pi / (size + 1))
    assert known * (1.0 - 1e-12) <= _largest_eigenvalue(csr_array(chain)) <= known * (1.0 + 2e-6)


def test_frequency_of_one_mass_on_a_cable():
    start = prepare(oscillator())
    assert largest_frequency(start.system) == pytest.approx(math.sqrt(1e8 * 1e-6 / 1.0), rel=1e-12)


def tied(way: list[float], thread: list[float], *, divisions: int = 1) -> Scene:
    """A light node on a thread of 1 m along `thread`, tied to a heavy body by a tether along `way`."""
    cable = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e8}
    net = {
        "topology": "explicit",
        "nodes": [[0.0, 0.0, 0.0], thread],
        "elements": [[0, 1]],
        "node_masses": [0.0, 1.0],
        "cable": cable,
    }
    tether = {**cable, "length": 1.0, "divisions": divisions, "start": {"node": 0}, "end": {"body": "b"}}
    body = {"mass": 10.0, "inertia": [0.1, 0.1, 0.1], "position": way}
    return Scene.model_validate(
        {"format": 1, "title": "a tether", "time": {"end": 1.0, "output_step": 1.0}, "net": net,
         "initial": {"packing": 1.0}, "bodies": {"b": body}, "tethers": {"a": tether}}
    )  # fmt: skip


@pytest.mark.parametrize("divisions", [1, 3])
def test_the_stable_step_of_a_tether_does_not_depend_on_how_the_scene_is_turned(divisions):
    """Along x, along z, and at a right angle to the thread, into whose line it may pull it."""
    x, z = [0.9, 0.0, 0.0], [0.0, 0.0, 0.9]
    ways = ((x, [-1.0, 0.0, 0.0]), (z, [0.0, 0.0, -1.0]), (x, [0.0, 1.0, 0.0]))
    found = [largest_frequency(prepare(tied(*way, divisions=divisions)).system) for way in ways]
    assert found == pytest.approx([found[0]] * 3, rel=1e-12)


def test_frequency_of_a_node_between_a_thread_and_a_tether():
    """In line, both of k = EA / L0, between a point of 10 kg and 1 kg: the eigenvalues of the 3 x 3 chain."""
    system = prepare(tied([0.9, 0.0, 0.0], [0.0, 1.0, 0.0])).system
    k = 1e8 * AREA
    chain = k * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    mass = system.inert_mass[[1, 0, 2]]  # far end of the thread, the node, the end at the body
    known = math.sqrt(np.abs(np.linalg.eigvals(chain / mass[:, None])).max())
    assert largest_frequency(system) == pytest.approx(known, rel=1e-10)


def test_threads_that_a_tether_turns_count_with_all_their_stiffness():
    """As in a tow, where both threads of a corner hang behind it in one line with the tether."""
    cable = {"diameter": D, "density": RHO, "youngs_modulus": E}
    tether = {**cable, "length": 1.0, "start": {"node": 0}, "end": {"body": "b"}}
    body = {"mass": 10.0, "inertia": [0.1, 0.1, 0.1], "position": [-0.5, -0.5, 0.9]}
    system = prepare(square_net(1, bodies={"b": body}, tethers={"a": tether})).system
    bound = largest_frequency(system)
    at = np.flatnonzero((system.net.element_nodes == 0).any(axis=1))
    assert len(at) == 3
    weight = np.repeat(system.inert_mass, 3)
    one = np.array([1.0, 2.0, -1.0]) / math.sqrt(6.0)
    span = reference_spans(system.net, system.blocks.position, system.blocks.poses.net)
    span[at] = one * system.net.reference_length[at, None]  # all in one line
    stiffness = assemble_pairs(system.net, reference_blocks(system.net, span)).toarray()
    aligned = math.sqrt(np.abs(np.linalg.eigvals(stiffness / weight[:, None])).max())
    at_first = reference_tangent_stiffness(
        system.net, system.blocks.position, system.blocks.poses.net
    ).toarray()
    assert math.sqrt(np.abs(np.linalg.eigvals(at_first / weight[:, None])).max()) < 0.95 * aligned
    assert aligned <= bound * (1.0 + 1e-12)


def test_without_tethers_it_is_that_of_the_reference_configuration():
    system = prepare(square_net(3)).system
    stiffness = reference_tangent_stiffness(
        system.net, system.blocks.position, system.blocks.poses.net
    ).toarray()
    values = np.abs(np.linalg.eigvals(stiffness / np.repeat(system.inert_mass, 3)[:, None]))
    assert largest_frequency(system) == pytest.approx(math.sqrt(values.max()), rel=1e-10)


def test_damping_rate_of_rayleigh_damping():
    alpha, beta = 3.0, 1e-4
    scene = oscillator(effects={"rayleigh_damping": {"alpha": alpha, "beta": beta}})
    start = prepare(scene)
    # M^-1 D = alpha + beta w^2 along the cable
    assert largest_damping_rate(start.system) == pytest.approx(alpha + beta * 100.0, rel=1e-10)
    assert largest_damping_rate(System(start.system.blocks, Forces.of(start.net))) == 0.0


def test_damping_rate_of_viscous_stress():
    """S = E tau E' along a taut cable: a damper tau EA / L0, so tau w^2 with w^2 = 100 / s^2."""
    start = prepare(oscillator(effects={"material_damping": {"relaxation_time": 2e-4}}))
    assert largest_damping_rate(start.system) == pytest.approx(2e-4 * 100.0, rel=1e-10)


@pytest.mark.parametrize(
    ("method", "limit"),
    [("VelocityVerlet", 2.0), ("RK33", math.sqrt(3.0)), ("RK44", 2.0 * math.sqrt(2.0))],
)
def test_limits_on_the_imaginary_axis(method, limit):
    """Hairer & Wanner, Solving ODEs II, IV.2; central differences: Belytschko et al., section 6.2."""
    assert stable_step(method, 10.0) == pytest.approx(limit / 10.0, rel=1e-6)


@pytest.mark.parametrize(
    ("method", "limit"),
    [("ExplicitEuler", 2.0), ("ExplicitMidpoint", 2.0), ("RK44", 2.785293563), ("VelocityVerlet", 2.0)],
)
def test_limits_on_the_negative_real_axis(method, limit):
    """Hairer & Wanner, IV.2: the real stability intervals. Verlet: v(n+1/2) = (1 - h c) v(n-1/2)."""
    assert stable_step(method, 0.0, 5.0) == pytest.approx(limit / 5.0, rel=1e-6)


def test_euler_and_midpoint_are_unstable_without_damping():
    assert stable_step("ExplicitEuler", 10.0) == 0.0
    assert stable_step("ExplicitMidpoint", 10.0) == 0.0


def test_weak_methods_have_a_practical_limit():
    """Where |R(iy)| = 1.01: sqrt(1 + y^2) of Euler's method, sqrt(1 + y^4 / 4) of the mid-point rule."""
    assert step_limit("ExplicitEuler", 10.0) == pytest.approx(math.sqrt(0.0201) / 10.0, rel=1e-6)
    assert step_limit("ExplicitMidpoint", 10.0) == pytest.approx(0.0804**0.25 / 10.0, rel=1e-6)
    assert stable_step("RK67", 10.0) < step_limit("RK67", 10.0)
    assert step_limit("RK44", 10.0) == stable_step("RK44", 10.0)
    assert math.isinf(step_limit("GeneralizedAlpha", 1e5))


def test_implicit_methods_have_no_limit():
    assert math.isinf(stable_step("GeneralizedAlpha", 1e5))


def test_damped_verlet_limit_is_where_the_step_starts_to_grow():
    """h = 2/w (sqrt(1 + z^2) - z), z = c / 2w: the damping force is that of half a step before.

    Then v(n+1/2) = v(n-1/2) + h a(x(n), v(n-1/2)) and x(n+1) = x(n) + h v(n+1/2), whose largest eigenvalue
    passes -1 there. Catches a limit that is too large as well as one that is too small.
    """
    frequency, rate = 10.0, 6.0
    limit = stable_step("VelocityVerlet", frequency, rate)

    def radius(h: float) -> float:
        faster = np.array([-h * frequency**2, 1.0 - h * rate])  # v(n+1/2) from (x(n), v(n-1/2))
        step = np.array([np.array([1.0, 0.0]) + h * faster, faster])
        return float(np.abs(np.linalg.eigvals(step)).max())

    assert limit == pytest.approx(2.0 / 10.0 * (math.sqrt(1.0 + 0.3**2) - 0.3), rel=1e-12)
    assert radius(0.999 * limit) < 1.0
    assert radius(1.001 * limit) > 1.0


def test_sixth_order_methods_last_coefficient():
    """One step of the engine on x'' = -w^2 x is R(ihw) (x, v); its 7th coefficient is read off."""
    from exunet.simulation.run import simulate

    h, w = 0.1, 10.0
    scene = oscillator(
        time={"end": h, "output_step": h},
        solver={"method": "RK67", "step": h},
        initial={"packing": 1.0, "node_positions": [[0, 0, 0], [1 + 1e-7, 0, 0]],
                 "node_velocities": [[0, 0, 0], [1e-5, 0, 0]]},
    )  # fmt: skip
    start = prepare(scene)
    end = simulate(start)
    z = 1j * h * w
    # x + i v / w with the sign that makes exp(-z) of it: the motion is R(-z) on that number
    state = (end.position[:, 1, 0] - 1.0) + 1j * end.velocity[:, 1, 0] / w
    known = sum((-z) ** k / math.factorial(k) for k in range(7))
    seventh = (state[1] / state[0] - known) / (-z) ** 7
    assert METHODS["RK67"].stages == 7
    assert seventh.real == pytest.approx(
        METHODS[Method.RK67].stability_polynomial[7], rel=2e-2
    )  # the spring is linear to 1e-7 only


def test_constant_stiffness_of_effects_counts():
    """A mass of 1 kg on a cable of stiffness EA/L0 = 100 N/m, with a constant spring of 300 N/m beside it."""
    start = prepare(oscillator())
    spring = np.zeros((6, 6))
    spring[3, 3] = 300.0
    beside = Forces.of(start.net, [LinearTerm(stiffness=csr_array(spring))])
    assert largest_frequency(System(start.system.blocks, beside)) == pytest.approx(math.sqrt(400.0), rel=1e-5)
