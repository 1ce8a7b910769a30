"""The forces' scalar loops as plain Python on a few nodes, against the same laws in vectors."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.sparse import csr_array

from exunet.forces import barrels, cable, loops
from exunet.forces.cable import Law
from exunet.forces.cable_term import OVERSHOOT, Breaking, CableTerm, ElementLaw
from exunet.forces.effects import air_drag, launch_force, orbit

RANDOM = np.random.default_rng(20261121)
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2], [1, 3]])
NATURAL = np.array([0.8, 0.9, 1.1, 1.3, 1.0, 1.2])
LAW = Law(NATURAL, np.array([3.0, 5.0, 7.0, 2.0, 4.0, 6.0]), np.array([0.1, 0.3, 0.2, 0.4, 0.25, 0.15]))
State = tuple[np.ndarray, np.ndarray]
NET: Any = SimpleNamespace(element_nodes=ENDS)  # as much of a net as the laws ask for
FIRST, SECOND = 3 * ENDS.T
LOOP = loops.Elements(FIRST, SECOND, NATURAL**2, LAW.stiffness / (2.0 * NATURAL**3))
TWICE = 2.0 * np.array(LAW.relaxation_time)
VISCOUS = loops.ViscousElements(*LOOP, TWICE)


def random_states(number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions and velocities (4, 3): elements slack and taut, becoming longer and shorter."""
    return [(RANDOM.normal(0.0, 0.6, (4, 3)), RANDOM.normal(0.0, 1.5, (4, 3))) for _ in range(number)]


def gradient(function: Callable[[np.ndarray], Any], x: np.ndarray, h: float = 1e-5) -> np.ndarray:
    """Derivatives of a function of a flat array by central differences of order 4."""
    columns = []
    for k in range(x.size):
        e = np.zeros(x.size)
        e[k] = h
        near, far = function(x + e) - function(x - e), function(x + 2.0 * e) - function(x - 2.0 * e)
        columns.append((8.0 * np.asarray(near) - far) / (12.0 * h))
    return np.array(columns)


# Cables


@pytest.mark.parametrize("viscous", [False, True])
def test_the_loops_have_the_tensions_and_the_energy_of_the_law(viscous: bool) -> None:
    law = LAW if viscous else Law(LAW.natural_length, LAW.stiffness)
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
    for (x, v), (_, w) in zip(random_states(40), random_states(40), strict=True):
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


def step_of(h: float, begin: State, end: State) -> tuple[State, State, State]:
    """The states of a step, that in the middle of the cubic with the values and slopes of both ends."""
    (x, v), (y, w) = begin, end
    cubic = CubicHermiteSpline([0.0, h], [x, y], [v, w])
    return begin, (cubic(0.5 * h), cubic(0.5 * h, 1)), end


def test_an_element_at_its_length_has_no_stress_yet() -> None:
    """S11 = 0 where E11 = 0, however fast it lengthens: at the start, the middle or the end of a step."""
    h = 0.25  # exact in binary numbers, as are the lengths
    for at in range(3):
        lengths, speeds = [1.25, 1.25, 1.25], [1.0, 1.0, 1.0]
        lengths[at] = 1.0
        if at == 1:  # (1.25 + 1.25) / 2 + h / 8 (v0 - v1) = 1, speed there -(v0 + v1) / 4
            speeds = [-6.0, 1.0, 2.0]
        states = [
            (np.array([0.0, 0.0, 0.0, length, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0]))
            for length, speed in zip(lengths, speeds, strict=True)
        ]
        middle = step_of(h, states[0], states[2])[1]
        of_middle = middle[0][3], middle[1][3]
        assert at != 1 or of_middle[0] == 1.0
        lengths[1], speeds[1] = of_middle
        ends = np.array([0]), np.array([3])
        element = loops.ViscousElements(*ends, np.ones(1), np.full(1, 3.0), np.ones(1))
        # Stress per stiffness E + 0.5 dE/dt, E = (L^2 - 1) / 2, dE/dt = L dL/dt; zero at the length.
        strain = [0.5 * (length**2 - 1.0) for length in lengths]
        rate = [length * speed for length, speed in zip(lengths, speeds, strict=True)]
        stress = [max(e + 0.5 * r, 0.0) if e > 0.0 else 0.0 for e, r in zip(strain, rate, strict=True)]
        power = [s * r for s, r in zip(stress, rate, strict=True)]
        stored = 0.5 * (max(strain[2], 0.0) ** 2 - max(strain[0], 0.0) ** 2)
        work = 6.0 * (h / 6.0 * (power[0] + 4.0 * power[1] + power[2]) - stored)
        assert loops.viscous_work(h, states[0], states[2], element) == pytest.approx(work, rel=1e-12)


def test_slack_at_both_ends_may_be_taut_between_them() -> None:
    """What is passed over is slack in the middle too: random steps, long and short, against all looked at."""
    random, taut = np.random.default_rng(5), 0
    element = loops.ViscousElements(np.array([0]), np.array([3]), np.ones(1), np.full(1, 3.0), np.ones(1))
    for _ in range(2000):
        h = 10.0 ** random.uniform(-4.0, 0.0)
        begin, end = (
            (
                np.append(np.zeros(3), (1.0 - 10.0 ** random.uniform(-7.0, -0.7)) * np.eye(3)[0]),
                random.normal(size=6),
            )
            for _ in range(2)
        )
        (x, v) = step_of(h, begin, end)[1]
        d, w = x[3:] - x[:3], v[3:] - v[:3]
        strain, rate = 0.5 * (d @ d - 1.0), d @ w
        stress = max(strain + 0.5 * rate, 0.0) if strain > 0.0 else 0.0
        taut += strain > 0.0
        work = 6.0 * h / 6.0 * 4.0 * stress * rate
        assert loops.viscous_work(h, begin, end, element) == pytest.approx(work, rel=1e-9, abs=1e-12)
    assert 300 < taut < 1700


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
    element = loops.ViscousElements(
        np.array([0]), np.array([3]), np.full(1, natural**2), np.full(1, 3.0), np.full(1, 1.5)
    )
    work = 3.0 * h / 6.0 * 4.0 * (excess + 1.5 * rate) * rate
    assert loops.viscous_work(h, begin, end, element) == pytest.approx(work, rel=1e-6, abs=0.0)


def test_an_element_at_its_length_does_not_pull() -> None:
    """S11 = 0 where E11 = 0, however fast it lengthens, and beyond that it has the stress of the rate."""
    element = loops.ViscousElements(np.array([0]), np.array([3]), np.ones(1), np.full(1, 3.0), np.ones(1))
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
    matrix = np.zeros((5, 3, 5, 3))
    for (i, j), block in zip(net.element_nodes, blocks, strict=True):
        for a, b, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
            matrix[a, :, b] += sign * block
    found = cable.reference_tangent_stiffness(net, position, np.eye(3), 5).toarray()
    np.testing.assert_allclose(found, matrix.reshape(15, 15), rtol=1e-13, atol=1e-15)
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
    net: Any = SimpleNamespace(reference_length=np.array([2.0]), axial_stiffness=np.array([7.0]))
    law = Law.of(net, np.array([0.03]), np.array([0.2]))
    length = np.array([2.2])
    strain = (2.2**2 - 2.0**2) / (2.0 * 2.0**2) - 0.03
    assert cable.tension(length, law.natural_length, law.stiffness) == pytest.approx(7.0 * strain * 1.1)
    assert cable.elastic_energy(law, length) == pytest.approx(0.5 * 7.0 * strain**2 * 2.0)
    assert law.relaxation_time is not None
    assert law.relaxation_time.tolist() == [0.2]
    assert Law.of(net).natural_length is net.reference_length
    assert law.of_intact(None) is law
    assert law.of_intact(np.array([0.5])).stiffness == pytest.approx(0.5 * law.stiffness)


# Breaking


def breaking_pair(**limit: Any) -> tuple[Breaking, float]:
    """One element of 0.5 m and 40 N whose limit is a strain of 0.02, and its length there [m]."""
    net: Any = SimpleNamespace(
        n_nodes=2,
        element_nodes=np.array([[0, 1]]),
        reference_length=np.array([0.5]),
        axial_stiffness=np.array([40.0]),
    )
    term = CableTerm(net, ElementLaw(**({"breaking_strain": np.array([0.02])} | limit)))
    return Breaking(term), 0.5 * math.sqrt(1.04)


def places(length: float) -> np.ndarray:
    return np.array([1.0, 2.0, 3.0, 1.0, 2.0 + length, 3.0])


def test_a_broken_element_loses_what_it_held() -> None:
    breaking, limit = breaking_pair()
    length, still = 0.5 * math.sqrt(1.0 + 2.0 * 0.0201), np.zeros(6)  # a strain of 0.0201
    assert breaking.crossed(0.0, places(limit * 1.000001), still, np.ones(1)).tolist() == [0]
    assert breaking.crossed(0.0, places(limit * 0.999999), still, np.ones(1)).tolist() == []
    assert breaking.crossed(0.0, places(limit * 1.000001), still, np.zeros(1)).tolist() == []
    for at, beyond in ((limit, []), (float(np.nextafter(limit, 1.0)), [0])):
        assert breaking.crossed(0.0, np.array([0, 0, 0, 0, at, 0]), still, np.ones(1)).tolist() == beyond
    change = breaking.change(7.0, places(length), still, np.ones(1), np.array([0]), {})
    assert change.energy_lost == pytest.approx(0.5 * 40.0 * 0.5 * 0.0201**2, rel=1e-12)
    assert change.memory.tolist() == [0.0]
    (told,) = change.events
    assert told["energy_J"] == change.energy_lost
    assert told["energy_excess"] == pytest.approx(1.005**2 - 1.0, rel=1e-10)
    assert (told["element"], told["time_s"]) == (0, 7.0)


def test_steps_shorten_where_an_element_would_go_far_beyond_its_limit() -> None:
    """Halved until the straight way ends within a strain of 0.02 (1 + OVERSHOOT), else left alone."""
    breaking, limit = breaking_pair()
    least, far = 1e-15, 0.5 * math.sqrt(1.0 + 2.0 * 0.02 * (1.0 + OVERSHOOT))
    parting = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # 1 m/s

    def step(length: float, step: float, memory: float = 1.0, least: float = least) -> float:
        return breaking.step_within(step, least, places(length), parting, np.array([memory]))

    whole, gap = 1e-3, far - limit  # [s], which is as long [m] at 1 m/s
    assert gap == pytest.approx(0.5 * 0.02 * OVERSHOOT / math.sqrt(1.04), rel=1e-3)
    assert step(limit - 2e-3, whole) == whole  # does not get there
    assert step(limit - whole + 0.9 * gap, whole) == whole  # beyond the limit, but not far
    assert step(limit - whole + 1.1 * gap, whole) == whole / 2
    assert step(limit - 0.3e-3, whole) == whole / 4
    near = limit * (1.0 - 1e-12)
    assert step(near, whole) == whole / 2 ** math.ceil(math.log2(whole / gap))
    assert step(limit + gap / 2, whole) == whole  # beyond already: the next event takes it out
    assert step(near, whole, memory=0.0) == whole  # broken before
    assert step(near, whole, least=whole / 5) == whole / 8
    assert step(near, whole, least=whole / 8) == whole / 8


# Effects


def test_cross_flow_brakes_what_is_normal_to_each_element() -> None:
    quarter = RANDOM.uniform(0.5, 2.0, 6)
    flow = air_drag.CrossFlow(FIRST, SECOND, quarter, np.full(6, 1e-12))
    for x, v in random_states(5):
        x[3] = x[0] + 1e-9  # on one spot but for less than counts: the whole flow
        wanted = np.zeros((4, 3))
        for e, (i, j) in enumerate(ENDS):
            u = 0.5 * (v[i] + v[j])
            along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
            normal = u if {i, j} == {0, 3} else u - (u @ along) * along
            wanted[[i, j]] -= quarter[e] * np.linalg.norm(normal) * normal
        force = np.zeros(12)
        air_drag.add_cross_flow(0.0, x.ravel(), v.ravel(), flow, force)
        np.testing.assert_allclose(force.reshape(4, 3), wanted, rtol=1e-12, atol=1e-13)


MASS, RADIUS, RATE = np.array([2.0, 3.0, 0.5, 1.0]), 5.0, 0.7  # an orbit so small that every term shows
RADIAL, NORMAL = np.array([0.36, 0.48, 0.8]), np.array([0.8, -0.6, 0.0])
ORBIT = orbit.CircularOrbit(MASS, RATE, RADIUS, RADIAL, NORMAL)


def test_two_bodies_pull_with_the_inverse_square() -> None:
    """m [-mu (R r + x) / |R r + x|^3 + n^2 (R r + x, without its part along h)], mu = n^2 R^3."""
    for x, _ in random_states(5):
        place = RADIUS * RADIAL + x
        pull = -(RATE**2) * RADIUS**3 * place / np.linalg.norm(place, axis=1, keepdims=True) ** 3
        turned = RATE**2 * (place - np.outer(place @ NORMAL, NORMAL))
        force = np.zeros(12)
        orbit.add_two_body(0.0, x.ravel(), x.ravel(), ORBIT, force)
        np.testing.assert_allclose(force.reshape(4, 3), MASS[:, None] * (pull + turned), atol=1e-13)

        def stored(y: np.ndarray) -> float:
            return orbit.two_body_potential(y, ORBIT)

        np.testing.assert_allclose(gradient(stored, x.ravel(), 1e-3), -force, rtol=1e-9, atol=1e-10)
    assert stored(np.zeros(12)) == 0.0


BULLETS, CHASER = np.array([0, 3, 6]), 9
AXES = np.array([[0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [0.48, 0.64, 0.6]])
BEGIN, FORCE, STROKE, DEAD, EXPONENT = np.array([0.1, 0.2, -0.3]), 60.0, 0.4, 0.15, 1.4


def test_gas_does_not_push_at_the_end_of_the_stroke() -> None:
    """There its force falls to zero, from F0 (V / (V + stroke))^gamma."""
    axes, bullets = np.array([[0.0, 0.0, 1.0]]), np.array([0])
    gas = launch_force.Gas(bullets, 3, axes, np.array([0.25]), 60.0, 0.5, 0.5, 2.0)
    for way, push in ((0.5, 0.0), (0.5 - 2.0**-40, 15.0)):
        force = np.zeros(6)
        launch_force.add_gas_launch(0.0, np.array([0, 0, way + 0.25, 0, 0, 0.0]), np.zeros(6), gas, force)
        assert force[2] == pytest.approx(push, rel=1e-9)
    on_body = barrels.Barrels(bullets, np.ones(1), axes, np.array([0.25]), 3, 6, 6, 60.0, 0.5, 0.5, 2.0)
    muzzles = barrels.Muzzles(on_body)
    for way, push, left in ((0.5, 0.0, [0]), (0.5 - 2.0**-40, 15.0, [])):
        x, force = np.array([0, 0, way + 0.25, 0, 0, 0, 1.0, 0, 0, 0]), np.zeros(9)
        barrels.add_push_of_body(0.0, x, np.zeros(9), on_body, force)
        assert force[2] == pytest.approx(push, rel=1e-9)
        assert muzzles.crossed(0.0, x, np.zeros(9), np.ones(1)).tolist() == left
        assert muzzles.crossed(0.0, x, np.zeros(9), np.zeros(1)).tolist() == []


@pytest.mark.parametrize("kind", ["spring", "gas"])
def test_a_launch_pushes_along_the_barrels_by_its_law(kind: str) -> None:
    """Bullets behind their start, in the barrel and out of it; the force is the slope of the potential."""
    ways = np.array([[-0.02, 0.1, 0.39], [0.2, 0.41, 0.0], [0.5, 0.3, -0.1]]) + 1e-3
    for way in ways:
        x = RANDOM.normal(0.0, 0.1, (4, 3))
        for b in range(3):
            x[b] += (way[b] + BEGIN[b] - (x[b] - x[3]) @ AXES[b]) * AXES[b]
        data: Any = launch_force.Spring(BULLETS, CHASER, AXES, BEGIN, FORCE, STROKE)
        if kind == "spring":
            law = FORCE * (1.0 - way / STROKE)
            add, potential = launch_force.add_spring_launch, launch_force.spring_launch_potential
            left = FORCE * (STROKE - way) ** 2 / (2.0 * STROKE)
        else:
            data = launch_force.Gas(*data, DEAD, EXPONENT)
            law = FORCE * (DEAD / (DEAD + np.maximum(way, 0.0))) ** EXPONENT
            add, potential = launch_force.add_gas_launch, launch_force.gas_launch_potential
            grid = [np.linspace(s, STROKE, 20001) for s in way]
            push = [FORCE * (DEAD / (DEAD + np.maximum(s, 0.0))) ** EXPONENT for s in grid]
            left = np.array([np.trapezoid(p, s) for p, s in zip(push, grid, strict=True)])
        law = np.where(way < STROKE, law, 0.0)
        force = np.zeros(12)
        add(0.0, x.ravel(), np.zeros(12), data, force)
        found = force.reshape(4, 3)
        np.testing.assert_allclose(found[:3], law[:, None] * AXES, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found[3], -law @ AXES, rtol=1e-12)
        slope = gradient(lambda y, p=potential, d=data: p(y, d), x.ravel())
        np.testing.assert_allclose(slope, -force, rtol=1e-7, atol=1e-6)
        stored = potential(x.ravel(), data)
        assert stored == pytest.approx(float(np.where(way < STROKE, left, 0.0).sum()), rel=1e-7)
