"""The cable law and what changes it: viscous stress, thermal strain, breaking, bending."""

from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import EFFECT_CASES, ENDS, every_backend, listed, model, one_thread, random_states
from scipy.interpolate import CubicHermiteSpline
from scipy.sparse import csr_array

from exunet.forces import cable, law, loops
from exunet.forces.blocks import Blocks
from exunet.forces.cable import AxialLaw
from exunet.forces.cable_term import OVERSHOOT, BreakingEvents, CableTerm, ElementLaw, breaking_lengths
from exunet.forces.effects import bending, breaking
from exunet.forces.effects.thermal_strain import ThermalStrain
from exunet.forces.law import tension
from exunet.forces.total import Forces
from exunet.integrators.exudyn.probe import Probe
from exunet.net.arrays import NO_TABLE
from exunet.results.measures import energy_balance
from exunet.scene.casefile import load
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

RANDOM = np.random.default_rng(20261121)
NATURAL = np.array([0.8, 0.9, 1.1, 1.3, 1.0, 1.2])
LAW = AxialLaw(NATURAL, np.array([3.0, 5.0, 7.0, 2.0, 4.0, 6.0]), np.array([0.1, 0.3, 0.2, 0.4, 0.25, 0.15]))
State = tuple[np.ndarray, np.ndarray]
NET: Any = SimpleNamespace(element_nodes=ENDS)  # as much of a net as the laws ask for
FIRST, SECOND = 3 * ENDS.T
LOOP = loops.Elements(FIRST, SECOND, NATURAL**2, LAW.stiffness / (2.0 * NATURAL**3))
TWICE = 2.0 * np.array(LAW.relaxation_time)
VISCOUS = loops.ViscousElements(*LOOP, TWICE, np.zeros(len(ENDS)), np.zeros(2))


@pytest.mark.parametrize("viscous", [False, True])
def test_the_loops_have_the_tensions_and_the_energy_of_the_law(viscous: bool) -> None:
    law = LAW if viscous else AxialLaw(LAW.natural_length, LAW.stiffness)
    pulled = []
    for x, v in random_states(20):
        tension = cable.element_tension(NET, law, x, v)
        span = cable.spans(NET, x)
        pull = tension[:, None] * span / np.linalg.norm(span, axis=1, keepdims=True)
        wanted = np.zeros((4, 3))
        np.add.at(wanted, ENDS[:, 0], pull)
        np.add.at(wanted, ENDS[:, 1], -pull)
        force = np.zeros(12)
        if viscous:
            energy = loops.add_viscous_tension(0.0, x.ravel(), v.ravel(), VISCOUS, force)
        else:
            energy = loops.add_tension(0.0, x.ravel(), v.ravel(), LOOP, force)
        np.testing.assert_allclose(force.reshape(4, 3), wanted, rtol=1e-12, atol=1e-13)
        assert energy == pytest.approx(cable.elastic_energy(law, cable.lengths(NET, x)), rel=1e-13)
        pulled += (tension > 0.0).tolist()
    assert 0.2 < np.mean(pulled) < 0.8


def test_viscous_work_is_that_of_the_law_and_the_integral_of_its_power() -> None:
    """Element by element by hand; Simpson's rule on the viscous power where a stress lasts."""
    lasting = 0
    for (x, v), (_, w) in zip(random_states(40), random_states(40, seed=7), strict=True):
        h = float(RANDOM.uniform(0.05, 0.5))
        states = step_of(h, (x, v), (x + h * (v + 0.5 * w), v + w))
        flat = [(place.ravel(), speed.ravel()) for place, speed in states]
        found = loops.viscous_work(h, flat[0], flat[2], VISCOUS)
        total = 0.0
        for e in range(len(ENDS)):
            stress, elastic, rate = [], [], []
            for place, speed in states:
                d, u = place[ENDS[e, 1]] - place[ENDS[e, 0]], speed[ENDS[e, 1]] - speed[ENDS[e, 0]]
                strain = (d @ d - NATURAL[e] ** 2) / (2.0 * NATURAL[e] ** 2)
                rate.append(d @ u / NATURAL[e] ** 2)
                elastic.append(max(strain, 0.0))
                viscous = strain + 0.5 * TWICE[e] * rate[-1]
                stress.append(max(viscous, 0.0) if strain > 0.0 else 0.0)
            lasts = min(stress) > 0.0
            lasting += lasts
            power = [(s - lasts * k) * r for s, k, r in zip(stress, elastic, rate, strict=True)]
            work = h / 6.0 * (power[0] + 4.0 * power[1] + power[2])
            work -= 0.0 if lasts else 0.5 * (elastic[2] ** 2 - elastic[0] ** 2)
            total += LAW.stiffness[e] * NATURAL[e] * work
        assert found == pytest.approx(total, rel=1e-11, abs=1e-12)
    assert 20 < lasting < 200


def test_the_viscous_work_of_a_verlet_step_is_that_of_its_forces() -> None:
    """(F0 + F1) / 2 on the way of the step, F the viscous part of forces at the half steps' velocities."""
    h = 0.3
    states = [x.ravel() for x, _ in random_states(20)]
    before: np.ndarray | None = None
    for begin, end in pairwise(states):
        viscous, elastic = np.zeros(12), np.zeros(12)
        loops.add_viscous_tension(0.0, end, (end - begin) / h, VISCOUS, viscous)
        loops.add_tension(0.0, end, end, LOOP, elastic)
        now = viscous - elastic
        if before is not None:
            work = -0.5 * float((before + now) @ (end - begin))
            assert loops.viscous_work_of_verlet(h, VISCOUS) == pytest.approx(work, rel=1e-11)
        before = now


def step_of(h: float, begin: State, end: State) -> tuple[State, State, State]:
    """The states of a step, that in the middle of the cubic with the values and slopes of both ends."""
    (x, v), (y, w) = begin, end
    cubic = CubicHermiteSpline([0.0, h], [x, y], [v, w])
    return begin, (cubic(0.5 * h), cubic(0.5 * h, 1)), end


def one_element(square: float, factor: float, twice_time: float) -> loops.ViscousElements:
    first, second = np.array([0], dtype=loops.Index), np.array([3], dtype=loops.Index)
    of_one = np.full(1, square), np.full(1, factor), 0, NO_TABLE, np.full(1, twice_time)
    return loops.ViscousElements(first, second, *of_one, np.zeros(1), np.zeros(2))


@pytest.mark.parametrize(
    ("h", "natural", "short", "speed"),
    [
        (1.0, 1.0, 0.01, 0.3),
        (1e-4, 1.0, 0.01, 3e3),
        (1e3, 1.0, 0.01, 3e-4),
        (1.0, 1e3, 0.1, 1e3),
        # As near to the bound as can be: 10^4 b = L0, where 2 b L0 is L0^2 / 10^4 + 10^4 b^2.
        (0.25, 3.0, 1e-4 * (1.0 - 1e-3), 2.0 * 3e-4 / (0.25 * math.sqrt(3.0))),
        (0.25, 0.3, 1e-4 * (1.0 - 1e-3), 2.0 * 3e-5 / (0.25 * math.sqrt(3.0))),
    ],
)
def test_an_element_that_swings_out_is_not_passed_over(
    h: float, natural: float, short: float, speed: float
) -> None:
    """Slack at both ends of a step by some part, and taut between: nodes part at first, and meet at last.

    Each moves at a speed in each direction, outwards and then inwards: the most that the bound allows for.
    """
    along = np.full(3, math.sqrt(1.0 / 3.0))
    place = np.concatenate([np.zeros(3), natural * (1.0 - short) * along])
    parts = np.repeat([-speed, speed], 3)
    begin, end = (place, parts), (place, -(1.0 - 1e-4) * parts)
    (x, v) = step_of(h, begin, end)[1]
    d, w = x[3:] - x[:3], v[3:] - v[:3]
    excess, rate = d @ d - natural**2, d @ w
    assert excess > 0.0
    assert excess + 1.5 * rate > 0.0
    element = one_element(natural**2, 3.0, 1.5)
    work = 3.0 * h / 6.0 * 4.0 * (excess + 1.5 * rate) * rate
    assert loops.viscous_work(h, begin, end, element) == pytest.approx(work, rel=1e-6, abs=0.0)


def test_an_element_at_its_length_does_not_pull() -> None:
    """S11 = 0 where E11 = 0, however fast it lengthens, and beyond that it has the stress of the rate."""
    element = one_element(1.0, 3.0, 1.0)
    v = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0])
    for length, pull in ((1.0, 0.0), (1.0 + 2.0**-40, 6.0)):  # factor * twice_time * L dL/dt * L
        force = np.zeros(6)
        loops.add_viscous_tension(0.0, np.array([0.0, 0.0, 0.0, length, 0.0, 0.0]), v, element, force)
        assert force[0] == pytest.approx(pull, rel=1e-9)


def test_matrices_and_loads() -> None:
    """-D v with the power v . D v, -K x, and a constant force, on rows of different length, one empty."""
    random = np.random.default_rng(11)
    matrix = random.normal(size=(6, 6)) * (random.uniform(size=(6, 6)) < 0.6)
    matrix[2] = 0.0
    sparse = csr_array(matrix)
    rows = loops.SparseRows(sparse.indptr, sparse.indices, sparse.data)
    x, v, before, load = random.normal(size=(4, 6))
    power = v @ matrix @ v
    assert loops.velocity_product_power(0.0, x, v, rows) == pytest.approx(power, rel=1e-13)
    force = before.copy()
    assert loops.add_velocity_product(0.0, x, v, rows, force) == pytest.approx(power, rel=1e-13)
    np.testing.assert_allclose(force, before - matrix @ v, rtol=1e-13)
    force = before.copy()
    loops.add_position_product(0.0, x, v, rows, force)
    np.testing.assert_allclose(force, before - matrix @ x, rtol=1e-13)
    force = before.copy()
    loops.add_load(0.0, x, v, loops.Load(load), force)
    np.testing.assert_allclose(force, before + load, rtol=1e-14)


def test_a_tether_lies_along_the_way_between_its_ends_at_the_start() -> None:
    """As long as its elements are; without a direction where the ends are within 1e-9 of its length."""
    net: Any = SimpleNamespace(
        element_nodes=np.array([[0, 1], [1, 2], [2, 3]]),
        reference_position=np.array([[0.0, 0.0, 0.0], [0.6, 0.8, 0.0], [9.0, 9.0, 9.0], [8.0, 8.0, 8.0]]),
        reference_length=np.array([1.0, 0.5, 1.5]),
        axial_stiffness=np.array([3.0, 4.0, 5.0]),
        tethers=(SimpleNamespace(name="tow", nodes=(1, 2, 3)),),
        tether_elements={"tow": [1, 2]},
        n_nodes=4,
    )
    position = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [7.0, 7.0, 7.0], [1.1, 0.5, 0.8]])
    along = np.array([0.6, 0.0, 0.8])
    wanted = np.array([[0.6, 0.8, 0.0], *np.outer([0.5, 1.5], along)])
    np.testing.assert_allclose(
        cable.reference_spans(net, position, np.eye(3)), wanted, rtol=1e-14, atol=1e-16
    )
    blocks = np.einsum("e,ea,eb->eab", [3.0, 4.0 / 0.125, 5.0 / 3.375], wanted, wanted)
    np.testing.assert_allclose(cable.reference_blocks(net, wanted), blocks, rtol=1e-14)
    matrix = np.zeros((4, 3, 4, 3))
    for (i, j), block in zip(net.element_nodes, blocks, strict=True):
        for a, b, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
            matrix[a, :, b] += sign * block
    found = cable.reference_tangent_stiffness(net, position, np.eye(3)).toarray()
    np.testing.assert_allclose(found, matrix.reshape(12, 12), rtol=1e-13, atol=1e-15)
    position[1:] = 0.0
    for apart, has_direction in ((2e-9, False), (np.nextafter(2e-9, 1.0), True)):
        position[3, 2] = apart
        span = cable.reference_spans(net, position, np.eye(3))[1:]
        np.testing.assert_array_equal(span, [[0, 0, 0.5 * has_direction], [0, 0, 1.5 * has_direction]])


def test_lengths_and_tensions_of_many_states() -> None:
    """Without a length an element has no rate, and without strain no tension; lengths of many states."""
    x = np.zeros((2, 4, 3))
    x[1] = random_states(1)[0][0]
    v = np.ones((2, 4, 3))
    v[1] = random_states(1)[0][1]
    tension = cable.element_tension(NET, LAW, x, v)
    assert not tension[0].any()
    np.testing.assert_array_equal(tension[1], cable.element_tension(NET, LAW, x[1], v[1]))
    known = np.linalg.norm(x[:, ENDS[:, 1]] - x[:, ENDS[:, 0]], axis=-1)
    np.testing.assert_allclose(cable.lengths(NET, x), known, rtol=1e-14)
    many = np.repeat(x[None], 4000, axis=0)  # more than fit at once
    np.testing.assert_array_equal(
        cable.lengths(NET, many), np.repeat(cable.lengths(NET, x)[None], 4000, axis=0)
    )


def test_a_free_strain_is_another_length_and_stiffness() -> None:
    """The stress of E11 - e in the reference configuration, in force and in energy."""
    net: Any = SimpleNamespace(
        reference_length=np.array([2.0]), axial_stiffness=np.array([7.0]), law_number=None, law_table=NO_TABLE
    )
    law = AxialLaw.of(net, np.array([0.03]), np.array([0.2]))
    length = np.array([2.2])
    strain = (2.2**2 - 2.0**2) / (2.0 * 2.0**2) - 0.03
    assert tension(length, law.natural_length, law.stiffness) == pytest.approx(7.0 * strain * 1.1)
    assert cable.elastic_energy(law, length) == pytest.approx(0.5 * 7.0 * strain**2 * 2.0)
    assert law.relaxation_time is not None
    assert law.relaxation_time.tolist() == [0.2]
    assert AxialLaw.of(net).natural_length is net.reference_length
    assert law.of_intact(None) is law
    assert law.of_intact(np.array([0.5])).stiffness == pytest.approx(0.5 * law.stiffness)


# Breaking


def breaking_pair(**limit: Any) -> tuple[BreakingEvents, float]:
    """One element of 0.5 m and 40 N whose limit is a strain of 0.02, and its length there [m]."""
    net: Any = SimpleNamespace(
        n_nodes=2,
        element_nodes=np.array([[0, 1]]),
        reference_length=np.array([0.5]),
        axial_stiffness=np.array([40.0]),
        law_number=None,
        law_table=NO_TABLE,
    )
    term = CableTerm(net, ElementLaw(**({"breaking_strain": np.array([0.02])} | limit)))
    return BreakingEvents(term), 0.5 * math.sqrt(1.04)


def places(length: float) -> np.ndarray:
    return np.array([1.0, 2.0, 3.0, 1.0, 2.0 + length, 3.0])


def test_a_broken_element_loses_what_it_held() -> None:
    breaking, limit = breaking_pair()
    length, still = 0.5 * math.sqrt(1.0 + 2.0 * 0.0201), np.zeros(6)  # a strain of 0.0201
    for part, intact, beyond in ((1.000001, 1.0, [0]), (0.999999, 1.0, []), (1.000001, 0.0, [])):
        x, discrete = places(limit * part), np.array([intact])
        assert breaking.crossed(0.0, x, still, discrete).tolist() == beyond
        assert (loops.beyond_limit(0.0, x, still, breaking.limits(discrete)) >= 0.0) == bool(beyond)
    for at, beyond in ((limit, []), (float(np.nextafter(limit, 1.0)), [0])):
        x = np.array([0, 0, 0, 0, at, 0])
        assert breaking.crossed(0.0, x, still, np.ones(1)).tolist() == beyond
        assert loops.beyond_limit(0.0, x, still, breaking.limits(np.ones(1))) >= 0.0  # `crossed` decides
    change = breaking.change(7.0, places(length), still, np.ones(1), np.array([0]), {})
    assert change.energy_lost == pytest.approx(0.5 * 40.0 * 0.5 * 0.0201**2, rel=1e-12)
    assert change.discrete.tolist() == [0.0]
    (told,) = change.events
    assert told.energy_J == change.energy_lost
    assert told.energy_excess == pytest.approx(1.005**2 - 1.0, rel=1e-10)
    assert (told.element, told.time_s) == (0, 7.0)


def test_an_element_breaks_at_the_first_step_beyond_its_limit() -> None:
    """At the same step as in a run that stores, and so evaluates in Python, each step."""
    settings = ["engine.backend=compiled", "solver={method='RK44', step=1e-5}", "time.end=0.005"]
    every, some = (
        simulate(prepare(load(EFFECT_CASES / "breaking.toml", [*settings, f"time.output_step={step}"]).scene))
        for step in (1e-5, 0.005)
    )
    known, found = (run.run.breaks for run in (every, some))
    assert [event.element for event in found] == [event.element for event in known] == [0]
    assert found[0].time_s == pytest.approx(known[0].time_s, rel=1e-12)


def test_steps_shorten_where_an_element_would_go_far_beyond_its_limit() -> None:
    """Halved until the straight way ends within a strain of 0.02 (1 + OVERSHOOT), else left alone."""
    breaking, limit = breaking_pair()
    least, far = 1e-15, 0.5 * math.sqrt(1.0 + 2.0 * 0.02 * (1.0 + OVERSHOOT))
    parting = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # 1 m/s

    def step(length: float, step: float, discrete: float = 1.0, least: float = least) -> float:
        intact = np.array([discrete])
        found = breaking.step_within(step, least, places(length), parting, intact)
        assert loops.step_to_limit(step, least, places(length), parting, breaking.limits(intact)) == found
        return found

    whole, gap = 1e-3, far - limit  # [s], which is as long [m] at 1 m/s
    assert gap == pytest.approx(0.5 * 0.02 * OVERSHOOT / math.sqrt(1.04), rel=1e-3)
    assert step(limit - 2e-3, whole) == whole  # does not get there
    assert step(limit - whole + 0.9 * gap, whole) == whole  # beyond the limit, but not far
    assert step(limit - whole + 1.1 * gap, whole) == whole / 2
    assert step(limit - 0.3e-3, whole) == whole / 4
    near = limit * (1.0 - 1e-12)
    assert step(near, whole) == whole / 2 ** math.ceil(math.log2(whole / gap))
    assert step(limit + gap / 2, whole) == whole  # beyond already: the next event takes it out
    assert step(near, whole, discrete=0.0) == whole  # broken before
    assert step(near, whole, least=whole / 5) == whole / 8
    assert step(near, whole, least=whole / 8) == whole / 8


# Bending


def thread(n: int) -> Any:
    return prepare(
        Scene.model_validate(
            one_thread(
1.0,
                net={"divisions": n, "fixed": [0, 1]}, effects={"bending": {"modulus": 3e9}},
            )
        )
    )  # fmt: skip


def test_a_pinned_thread_has_the_frequencies_of_a_beam() -> None:
    """Euler-Bernoulli, pinned ends: omega_k = (k pi / L)^2 sqrt(E I / rho A); second order in the element."""
    inertia = 1e-6**2 / (4 * math.pi)
    exact = np.pi**2 * math.sqrt(3e9 * inertia / (1000.0 * 1e-6)) * np.array([1.0, 4.0])
    errors = []
    for n in (10, 20):
        start = thread(n)
        free = 3 * np.setdiff1d(np.arange(n + 1), [0, 1]) + 2
        stiffness = start.system.forces.linear.stiffness.toarray()
        block = stiffness[np.ix_(free, free)] / start.net.mass[free // 3][:, None]
        errors.append(np.sqrt(np.sort(np.linalg.eigvals(block).real))[:2] / exact - 1.0)
    assert np.abs(errors[1]).max() < 0.02
    np.testing.assert_allclose(np.abs(errors[0]) / np.abs(errors[1]), 4.0, rtol=0.1)


def test_bending_is_blind_to_rigid_motions_and_agrees_with_the_rotational_spring() -> None:
    start = thread(4)
    stiffness = start.system.forces.linear.stiffness
    place = start.net.reference_position
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    moved = (place @ turn.T + [1.0, 2.0, 3.0]).ravel()
    assert abs(moved @ (stiffness @ moved)) < 1e-12 * np.abs(stiffness).max()
    # Two elements of reference length, at an angle: k (1 - cos angle), k = E I / L.
    net = prepare(
        Scene.model_validate(
            listed([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]], [[0, 1], [1, 2]], 1.0)
        )
    ).net  # fmt: skip
    (term,) = bending.Bending(modulus=3e9).terms(Blocks.of_net(net))
    bent = np.array(
        [[-0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [0.5 * math.cos(0.8), 0.5 * math.sin(0.8), 0.0]]
    ).ravel()
    spring = 3e9 * 1e-12 / (4 * math.pi) / 0.5
    assert 0.5 * bent @ (term.stiffness @ bent) == pytest.approx(spring * (1 - math.cos(0.8)), rel=1e-12)


def test_threads_run_on_through_knots_and_not_round_corners() -> None:
    """A 2 x 2 mesh net has 6 lines of 3 knots; a string is tied to its corner, not run on from a cable."""
    net = prepare(load(EFFECT_CASES / "orbit.toml").scene).net
    nodes, length, elements = bending.joints(net)
    assert len(nodes) == 6
    assert not net.is_string[elements].any()
    assert (length == 1.0).all()
    before, at, after = (net.reference_position[nodes[:, k]] for k in range(3))
    np.testing.assert_allclose(before + after, 2 * at, atol=1e-12)


# Thermal strain


def test_thermal_strain_pulls_with_ea_times_strain() -> None:
    """At its reference length: S11 = -E (alpha dT + (alpha dT)^2 / 2), so N = EA 1e-3 (1 - 5e-4) at -1e-3."""
    case = one_thread(
1.0,
        effects={"thermal_strain": {"temperature_change": -200.0, "expansion_coefficient": 5e-6}},
    )  # fmt: skip
    start = prepare(Scene.model_validate(case))
    pull = Probe(model(start)).accelerations(start.position, start.velocity) * start.net.mass[:, None]
    expected = 1e3 * 1e-3 * (1 - 5e-4)
    np.testing.assert_allclose(pull[:, 0], [expected, -expected], rtol=1e-11)
    assert cable.elastic_energy(start.system.forces.cable.law, np.ones(1)) == pytest.approx(
        0.5 * 1e3 * (1e-3 * (1 - 5e-4)) ** 2, rel=1e-11
    )


def test_a_warm_cable_is_longer_before_it_pulls() -> None:
    keys = ThermalStrain(temperature_change=100.0, expansion_coefficient=1e-5)
    net = thread(1).net
    forces = Forces.of(net, keys.terms(Blocks.of_net(net)))
    assert forces.cable.law.natural_length == pytest.approx(1.001, rel=1e-12)


# Breaking


@pytest.mark.ci_for("stepping0-compiled")
@pytest.mark.slow_for("compiled", "stepping0")
@every_backend
@pytest.mark.parametrize("stepping", [["solver.method=RK44", "solver.step=2e-6"], ["solver.method=DOPRI5"]])
def test_a_snap_that_breaks_loses_what_the_cable_held(backend: str, stepping: list[str]) -> None:
    engine = [f"engine.backend={backend}"]
    run = simulate(prepare(load(EFFECT_CASES / "breaking.toml", [*stepping, *engine]).scene))
    (broken,) = run.run.breaks
    assert broken.element == 0
    # EA E11^2 L / 2 at the limit, 70e9 Pa, d = 1 mm; the break comes at the end of the step that passed it,
    # by 1e-6 of the energy with steps that are chosen (`breaking`), by a stretch of 2e-6 s with equal ones.
    stiffness = 70e9 * math.pi / 4 * 1e-6
    excess = broken.energy_J / (0.5 * stiffness * 0.004**2) - 1.0
    assert 0.0 <= excess < (1e-6 if stepping == ["solver.method=DOPRI5"] else 1.1e-3)
    assert broken.energy_excess == pytest.approx(excess, abs=1e-9)
    assert run.dissipated[-1] == pytest.approx(broken.energy_J, rel=1e-12)
    assert energy_balance(run) < 1e-7
    after = run.time > broken.time_s
    assert run.tension[after].max() == 0.0
    assert run.tension[~after].max() > 0.0
    assert run.elastic[-1] == 0.0
    mass = run.net.mass.sum()
    speed = math.sqrt(2.0 * (run.kinetic[0] - broken.energy_J) / mass)
    assert np.abs(run.velocity[-1, :, 0]) == pytest.approx(speed, rel=1e-6)


def test_a_cable_below_its_limit_holds() -> None:
    stronger = ["effects.breaking.strain=0.0055", "engine.backend=exudyn"]
    run = simulate(prepare(load(EFFECT_CASES / "breaking.toml", stronger).scene))
    assert run.run.breaks == []
    assert run.strain.max() == pytest.approx(
        5.331090e-3, rel=2e-2
    )  # the snap's exact peak, between stored times
    assert run.dissipated[-1] == 0.0


@pytest.mark.parametrize("free", [0.0, 0.01, -0.02])
@pytest.mark.parametrize(("limit", "force"), [({"force": 123.0}, 123.0), ({"strain": 0.02}, None)])
def test_the_limit_of_a_cable_with_a_free_strain(
    limit: dict[str, float], force: float | None, free: float
) -> None:
    """At the breaking length the tension is the limit: of a strain e EA e sqrt(1 + 2 (e + free))."""
    net, keys = thread(1).net, breaking.Breaking.model_validate(limit)
    changes = (*keys.terms(Blocks.of_net(net)), ElementLaw(free_strain=np.array([free])))
    term = Forces.of(net, changes).cable
    force = force or 1e3 * 0.02 * math.sqrt(1.0 + 2.0 * (0.02 + free))
    pull = tension(breaking_lengths(term), term.law.natural_length, term.law.stiffness)
    assert pull == pytest.approx(force, rel=1e-12)
    assert keys.breaking_limits(net, free) == pytest.approx(force, rel=1e-12)


def test_laws_by_length_and_by_squared_length_agree() -> None:
    """The two texts of `exunet.forces.law`: N = EA (s^3 - s) / 2, by hand."""
    for s in (1.0, 1.0 + 1e-6, 1.01, 1.3, 2.0):
        natural, stiffness = 0.7, 5.0
        pull, square = 0.5 * stiffness * (s**3 - s), (natural * s) ** 2
        strain = law.green_lagrange_strain(natural * s, natural)
        assert law.tension(natural * s, natural, stiffness) == pytest.approx(pull, rel=1e-12, abs=1e-15)
        excess = law.excess_over(square, natural)
        assert law.tension_by(excess, square, natural, stiffness) == pytest.approx(pull, rel=1e-9, abs=1e-15)
        assert law.strain_between(0, square, natural) == pytest.approx(strain, rel=1e-9, abs=1e-15)
        assert law.strain_at(s) == pytest.approx(strain, rel=1e-12, abs=1e-16)
        assert law.stretch_at(pull / stiffness) == pytest.approx(s, rel=1e-14)
        assert law.stretch_with(np.array([pull]), np.array([stiffness])) == pytest.approx(s, rel=1e-14)
        assert law.tangent_at(s) == pytest.approx(1.5 * s * s - 0.5, rel=1e-14)
        assert law.slope_at(s * s) == pytest.approx(1.5 * s * s - 0.5, rel=1e-14)
        held = float(law.energy(strain)) * stiffness * natural
        assert law.energy_with(0, NO_TABLE, pull, natural, stiffness) <= held * (1.0 + 1e-9)
