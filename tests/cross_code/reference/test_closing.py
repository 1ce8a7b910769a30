"""What closes a mouth, in reference_impl: known answers, balances, the way through the rings, bad input."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from reference_impl import acceleration, elements, energy, prepare, read_document
from reference_impl.closing import Edge
from reference_impl.forces import Whole, response
from reference_impl.run import Diverged

EA, D = 200.0, 0.02
LINE = {
    "kind": "line",
    "length": 3.0,
    "stiffness": EA,
    "linear_density": 0.0,
    "ring_diameter": D,
    "friction": 0.0,
}


def nothing(places, masses, fixed=(), velocities=None, **closing):
    """Points (n, 3) [m] that nothing joins but a closing line; an element far away makes it a net."""
    n = len(places)
    return {
        "format": 1,
        "title": "beads",
        "time": {"end": 1.0, "output_step": 0.1},
        "net": {
            "topology": "explicit",
            "nodes": [*places, [100.0, 0.0, 0.0], [101.0, 0.0, 0.0]],
            "elements": [[n, n + 1]],
            "node_masses": [*masses, 1.0, 1.0],
            "fixed": [*fixed, n, n + 1],
            "cable": {"diameter": 0.001, "density": 1000.0, "youngs_modulus": 1e9},
        },
        "initial": {
            "packing": 1.0,
            "node_velocities": [*(velocities or [[0.0] * 3] * n), [0.0] * 3, [0.0] * 3],
        },
        "closing": {**LINE, **closing},
    }


def beads(*args, **closing):
    return prepare(read_document(nothing(*args, **closing)))


CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.3], [0.9, 1.1, -0.2], [0.9, 1.11, -0.195], [-0.2, 0.8, 0.1]]
LOOP = {"nodes": [0, 1, 2, 3, 4]}  # the third piece is 0.011 m long, less than D


def forces(made, x, v, wound_up=0.0, t=0.0):
    a = acceleration(made.system, t, x, v, drawn=np.array([wound_up]))
    return made.net.mass[:, None] * a


# forces


def test_one_tension_along_the_line():
    """On each ring the tension acts along both pieces; a piece of d < D pulls with N dw/dd."""
    made = beads(CORNERS, [1.0] * 5, **LOOP)
    x = made.x0
    found = forces(made, x, np.zeros_like(x))[:5]
    around = np.roll(x[:5], -1, axis=0) - x[:5]
    d = np.linalg.norm(around, axis=1)
    u = d / D
    w, slope = (
        np.where(u < 1, D * (3 / 8 + 3 * u**2 / 4 - u**4 / 8), d),
        np.where(u < 1, 1.5 * u - u**3 / 2, 1),
    )
    assert np.sum(u < 1) == 1
    stretch = w.sum() / 3.0
    tension = EA * (stretch**2 - 1.0) / 2.0 * stretch
    pull = (tension * slope / d)[:, None] * around
    assert found == pytest.approx(pull - np.roll(pull, 1, axis=0), abs=1e-12 * tension)


@pytest.mark.parametrize("free", [0.0, 1e-2])
def test_forces_are_the_gradient_of_the_energy(free):
    """Central differences of U; also against the length outside, which gives the winch's force."""
    case = nothing(CORNERS, [1.0] * 5, **LOOP)
    if free:  # alpha dT + (alpha dT)^2/2 = free
        change = {"temperature_change": math.sqrt(1.0 + 2.0 * free) - 1.0, "expansion_coefficient": 1.0}
        case["effects"] = {"thermal_strain": change}
    made = prepare(read_document(case))
    line, x, h = made.system.closing, made.x0, 1e-6
    still = np.zeros_like(x)
    found = forces(made, x, still)

    def stored(places, wound_up=0.0):
        return float(line.energy(places, np.array([wound_up]), free))

    for node in range(5):
        for axis in range(3):
            step = np.zeros_like(x)
            step[node, axis] = h
            slope = (stored(x + step) - stored(x - step)) / (2.0 * h)
            assert -slope == pytest.approx(found[node, axis], abs=1e-7 * EA)
    wound = (stored(x, h) - stored(x, -h)) / (2.0 * h)
    case["closing"]["winch"] = {"shortest": 1.0, "commands": [{"at": 0.0, "mode": "rate", "rate": -1.0}]}
    turned = prepare(read_document(case)).system
    whole = Whole(x, still, np.zeros((0, 3, 3)), np.zeros((0, 3)), drawn=np.array([0.5]))
    rate, power = response(turned, 0.0, whole).drawing
    wound = (stored(x, 0.5 + h) - stored(x, 0.5 - h)) / (2.0 * h)
    assert rate == -1.0
    assert power == pytest.approx(-wound, rel=1e-8)


def test_no_force_and_no_torque_in_sum():
    """With viscous stress too, at places and velocities of no symmetry."""
    case = nothing(CORNERS, [1.0] * 5, **LOOP)
    case["effects"] = {"material_damping": {"relaxation_time": 0.01}}
    made, rng = prepare(read_document(case)), np.random.default_rng(1)
    x, v = made.x0 + 0.1 * rng.normal(size=made.x0.shape), 0.1 * rng.normal(size=made.x0.shape)
    found = forces(made, x, v)[:5]
    scale = np.abs(found).max()
    assert scale > 1.0
    assert found.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-13 * scale)
    assert np.cross(x[:5], found).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-13 * scale)


def test_slack_line_and_rings_that_meet():
    made = beads([[0.0] * 3, [1.0, 0.0, 0.0], [0.5, 0.1, 0.0]], [1.0] * 3, nodes=[0, 1, 2])
    assert not forces(made, made.x0, np.zeros_like(made.x0)).any()
    made = beads([[0.0] * 3, [2.0, 0.0, 0.0], [2.0, 0.0, 0.0]], [1.0] * 3, nodes=[0, 1, 2])
    found = forces(made, made.x0, np.zeros_like(made.x0))
    stretch = (4.0 + 0.375 * D) / 3.0
    tension = EA * (stretch**2 - 1.0) / 2.0 * stretch
    assert found[:3, 0] == pytest.approx([2.0 * tension, -tension, -tension], rel=1e-14)


def test_viscous_stress():
    """A straight line of two pieces whose end moves: N = E A (E11 + tau l l') l, and it takes N_v L'."""
    tau, speed = 0.03, 0.4
    places = [[0.0] * 3, [1.5, 0.0, 0.0], [3.3, 0.0, 0.0]]
    case = nothing(places, [1.0] * 3, nodes=[1], start={"node": 0}, end={"node": 2})
    case["effects"] = {"material_damping": {"relaxation_time": tau}}
    made = prepare(read_document(case))
    v = np.zeros_like(made.x0)
    v[2, 0] = speed
    stretch, rate = 1.1, speed / 3.0
    viscous = EA * tau * stretch * rate * stretch
    tension = EA * (stretch**2 - 1.0) / 2.0 * stretch + viscous
    assert forces(made, made.x0, v)[:3, 0] == pytest.approx([tension, 0.0, -tension], abs=1e-12 * tension)
    whole = Whole(made.x0, v, np.zeros((0, 3, 3)), np.zeros((0, 3)), drawn=np.zeros(1))
    assert response(made.system, 0.0, whole).power == pytest.approx(viscous * speed, rel=1e-12)


# motion


@pytest.mark.slow
def test_bead_keeps_to_its_ellipse():
    """Of a line that hardly stretches, fixed at both foci: 0.03 N of 4e4 N are 1e-6 of its length."""
    foci = [[-0.6, 0.0, 0.0], [0.6, 0.0, 0.0]]
    made = beads(
        [*foci, [0.0, 0.8, 0.0]],
        [1.0, 1.0, 0.3],
        [0, 1],
        [[0.0] * 3, [0.0] * 3, [0.3, 0.0, 0.0]],
        nodes=[2],
        start={"node": 0},
        end={"node": 1},
        length=2.0,
        stiffness=4e4,
    )
    run = made.integrate(np.linspace(0.0, 2.0, 31), rtol=1e-8, atol=1e-10)
    bead = run.x[:, 2]
    sum_of_distances = sum(np.linalg.norm(bead - focus, axis=1) for focus in np.array(foci))
    assert sum_of_distances == pytest.approx(np.full(31, 2.0), abs=1e-5)
    assert bead[:, 0].max() > 0.5  # it went far along
    # without gravity the speed along the ellipse stays what it is
    assert np.linalg.norm(run.v[:, 2], axis=1) == pytest.approx(np.full(31, 0.3), abs=1e-3)


def turning():
    """A triangle of beads that turns at about the rate at which the tension of 8.3 N holds 0.6 kg each."""
    angle = 2.0 * np.pi * np.arange(3) / 3.0
    places = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(3)))
    velocities = np.cross([0.0, 0.0, 4.9], places)
    velocities[0] += [0.1, 0.0, 0.2]
    return beads(places.tolist(), [0.6, 0.6, 0.7], (), velocities.tolist(), nodes=[0, 1, 2], length=5.0)


def test_energy_of_a_locked_line(unbalanced):
    made = turning()
    run = made.integrate(np.linspace(0.0, 1.0, 11))
    assert np.all(made.system.closing.tension(run.x, run.drawn.amount, 0.0) > 0.1)
    assert unbalanced(made, run) < 1e-10
    assert run.drawn.amount[-1] == run.drawn.work[-1] == 0.0


def held(commands, **winch):
    """A line of 3 m between fixed points 3.15 m apart by way of a fixed ring: stretch 1.05."""
    return beads(
        [[0.0] * 3, [1.0, 0.0, 0.0], [1.0, 2.15, 0.0]],
        [1.0] * 3,
        [0, 1, 2],
        nodes=[1],
        start={"node": 0},
        end={"node": 2},
        winch={"shortest": 2.0, "commands": commands, **winch},
    )


def stored(stretch, outside):
    """E A E11^2 L0/2 [J], E11 = (stretch^2 - 1)/2."""
    return EA / 8.0 * (stretch**2 - 1.0) ** 2 * outside


def test_winch_at_a_constant_rate():
    """The length outside falls by rate t; what the winch does is what the line then stores; it is locked."""
    made = held([{"at": 0.2, "mode": "rate", "rate": 0.5}, {"at": 1.0, "mode": "lock"}])
    run = made.integrate([0.0, 0.2, 0.7, 1.0, 1.3])
    wound = np.array([0.0, 0.0, 0.25, 0.4, 0.4])
    assert run.drawn.amount[:, 0] == pytest.approx(wound, abs=1e-12)
    outside = 3.0 - wound
    work = stored(3.15 / outside, outside) - stored(1.05, 3.0)
    assert run.drawn.work[:, 0] == pytest.approx(work, abs=1e-9 * work[-1])
    stretch = 3.15 / outside
    tension = made.system.closing.tension(run.x, run.drawn.amount, 0.0)
    assert tension == pytest.approx(EA / 2 * (stretch**2 - 1) * stretch, rel=1e-11)
    potential = energy.books(made.system, run).potential
    assert potential == pytest.approx(stored(stretch, outside), rel=1e-10)


def test_winch_near_the_shortest_length_slows_down():
    """ds/dt = rate d/(length/100), d the way left: from there on it falls as exp(-rate t/(length/100))."""
    rate, ramp = 0.5, 0.03
    made = held([{"at": 0.0, "mode": "rate", "rate": rate}], shortest=2.8)
    reached = (0.2 - ramp) / rate
    run = made.integrate([0.0, reached, reached + 0.1])
    left = 0.2 - run.drawn.amount[1:, 0]
    assert left == pytest.approx([ramp, ramp * math.exp(-rate * 0.1 / ramp)], rel=1e-6)


@pytest.mark.ci
@pytest.mark.slow
def test_winch_at_a_constant_force():
    """Two pieces side by side pull a bead: m x'' = 2 N, N = F - c s', s' = 2 x', in a stiff line.

    N follows in L0 c/E A = 6e-4 s, so that speeds are late by that times F/m.
    """
    mass, force, damping = 2.0, 3.0, 4.0
    made = beads(
        [[0.0] * 3, [1.5, 0.0, 0.0]],
        [1.0, mass],
        [0],
        nodes=[1],
        start={"node": 0},
        end={"node": 0},
        stiffness=2e4,
        winch={
            "shortest": 0.5,
            "damping": damping,
            "commands": [{"at": 0.0, "mode": "tension", "force": force}],
        },
    )
    times = np.linspace(0.0, 0.6, 7)
    run = made.integrate(times)
    limit, rate = force / (2.0 * damping), 4.0 * damping / mass
    speed = limit * (1.0 - np.exp(-rate * times))
    assert -run.v[:, 1, 0] == pytest.approx(speed, abs=2e-3)
    assert run.drawn.work[:, 0] == pytest.approx(0.5 * mass * speed**2, abs=2e-3)


def test_brake_pays_out_against_too_strong_a_pull():
    """ds/dt = -(N - F)/c at first; in the end N = F."""
    force, damping = 2.0, 50.0
    commands = [
        {"at": 0.0, "mode": "rate", "rate": 0.5},
        {"at": 0.4, "mode": "brake", "force": force},
    ]
    made = held(commands, damping=damping)
    run = made.integrate([0.0, 0.4, 0.4 + 1e-6, 20.0])
    line = made.system.closing
    tension = line.tension(run.x, run.drawn.amount, 0.0)
    paid = np.diff(run.drawn.amount[1:3, 0])[0] / 1e-6
    assert paid == pytest.approx(-(tension[1] - force) / damping, rel=1e-4)
    # the tension at s = 0 is above the force, so that all is paid out in the end
    assert tension[0] > force
    assert run.drawn.amount[-1, 0] == pytest.approx(0.0, abs=1e-6)


def test_a_run_stops_where_the_line_is_too_long():
    places = [[0.0] * 3, [1.0, 0.0, 0.0]]
    # half the reduced mass takes 900 J; at twice its length the line would hold E A 9 L0/8 = 675 J
    made = beads(places, [1.0, 1.0], (), [[0.0] * 3, [60.0, 0.0, 0.0]], nodes=[0, 1])
    with pytest.raises(Diverged, match="closing line is more than twice as long"):
        made.integrate()


# nets


def closed(document, closing, topology="square", **net):
    case = document(topology, **net)
    case["closing"] = copy.deepcopy(closing)
    return case


@pytest.fixture
def bag(document):
    """bag(closing, effects): a square net of 2 m, loosely packed, that a line or its edge closes."""

    def make(closing, **effects):
        cable = {"diameter": 0.001, "density": 1390.0, "youngs_modulus": 1e8}
        case = closed(document, closing, size=2.0, cable=cable, strings={**cable, "length": 0.5})
        case["initial"] = {"packing": 0.97}
        case["launch"] = {"radial_speed": 0.3, "axial_speed": 1.0}
        return {**case, "effects": effects, "time": {"end": 0.3, "output_step": 0.05}}

    return make


ROUND = {**LINE, "rings": "edge", "length": 7.9, "linear_density": 2e-3}
PULL = {"at": 0.05, "mode": "tension", "force": 5.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    "closing",
    [
        {**ROUND, "winch": {"shortest": 1.0, "damping": 1.0, "commands": [PULL]}},
        {"kind": "perimeter", "at": 0.03, "rate": 2.0, "part": 0.7},
    ],
    ids=["line", "perimeter"],
)
def test_books_close(bag, closing, unbalanced):
    """With viscous stress and thermal strain: the work of what closes is what all else gains."""
    warm = {"temperature_change": 50.0, "expansion_coefficient": -1e-4}
    made = prepare(
        read_document(bag(closing, material_damping={"relaxation_time": 1e-3}, thermal_strain=warm))
    )
    run = made.integrate()
    assert run.drawn.work[-1, 0] > 0.05  # J; the kinetic energy at the start is about 1 J
    assert unbalanced(made, run) < 1e-7
    books = energy.books(made.system, run)
    assert books.momentum == pytest.approx(np.tile(books.momentum[0], (len(run.t), 1)), abs=1e-9)
    assert books.angular_momentum == pytest.approx(np.zeros((len(run.t), 3)), abs=1e-9)


@pytest.mark.slow
def test_perimeter_keeps_its_pace(bag):
    """p = 1 until 0.03 s, then 1 - 2 (t - 0.03) until 0.7 is reached, at 0.18 s."""
    made = prepare(read_document(bag({"kind": "perimeter", "at": 0.03, "rate": 2.0, "part": 0.7})))
    run = made.integrate([0.0, 0.03, 0.1, 0.18, 0.2])
    part = np.array([1.0, 1.0, 0.86, 0.7, 0.7])
    assert run.drawn.amount[:, 0] == pytest.approx(part, abs=1e-12)
    edge = made.system.closing
    assert isinstance(edge, Edge)
    assert len(edge.element) == 8
    i, j = made.net.element_nodes[edge.element].T
    length = np.linalg.norm(run.x[:, j] - run.x[:, i], axis=2)
    strain = ((length / part[:, None]) ** 2 - 1.0) / 2.0  # the mesh is 1 m
    lengths = energy.lengths(made.system, run.reels, run.drawn)
    found = elements.strain(made.system, run.x, lengths)
    assert found[:, edge.element] == pytest.approx(strain, abs=1e-12)
    area, modulus = np.pi / 4.0 * 1e-6, 1e8
    energy_of_edge = (0.5 * modulus * area * np.maximum(strain, 0.0) ** 2 * part[:, None]).sum(axis=1)
    potential = energy.books(made.system, run).potential
    assert potential == pytest.approx(energy_of_edge, rel=1e-9, abs=1e-15)


COUNTS = {  # nodes of the edge, corners; lengths of the edge [m]
    "square": ({"size": 5.0, "mesh": 1.0}, 20, 4, 20.0),
    "rectangular": ({}, 20, 4, 8.0),
    "hexagonal": ({}, 30, 12, 15.0),  # 12 R + 6 sides of 0.5 m
    "radial": ({}, 8, 8, 32.0 * math.sin(math.pi / 8)),
}


@pytest.mark.parametrize("topology", COUNTS)
@pytest.mark.parametrize("divisions", [1, 3])
def test_way_round_a_net(document, topology, divisions):
    net, nodes, corners, length = COUNTS[topology]
    case = closed(document, ROUND, topology, divisions=divisions, **net)
    made = prepare(read_document(case, {"closing.length": 100.0}))
    line = made.system.closing
    assert line.nodes[0] == line.nodes[-1]
    place = made.net.reference_position[line.nodes]
    assert len(place) == nodes * divisions + 1
    assert np.linalg.norm(np.diff(place, axis=0), axis=1).sum() == pytest.approx(length)
    enclosed = np.cross(place[:-1], place[1:])[:, 2].sum() / 2.0  # positive: anticlockwise
    assert enclosed > 0.2 * length**2 / (4.0 * math.pi)
    case["closing"]["rings"] = "corners"
    few = prepare(read_document(case, {"closing.length": 100.0})).system.closing
    assert len(few.nodes) == corners + 1
    assert few.nodes[0] == line.nodes[0]
    assert set(few.nodes) <= set(line.nodes)
    first = {"square": [-2.5, -2.5, 0], "rectangular": [-1.5, -0.5, 0], "radial": [2, 0, 0]}
    if topology in first:
        assert place[0] == pytest.approx(first[topology])
    else:  # of the two corners of ray 0, the one below it
        assert place[0] == pytest.approx([2.5 * math.sqrt(3.0) * 0.5, -0.25, 0.0])


def test_open_line_and_its_mass(document):
    """From bullet 2 to the first corner, all round, and to bullet 3; of n pieces each end has half."""
    case = closed(document, {**ROUND, "start": {"bullet": 2}, "end": {"bullet": 3}})
    without = copy.deepcopy(case)
    del without["closing"]
    made, bare = prepare(read_document(case)), prepare(read_document(without))
    line = made.system.closing
    assert len(line.nodes) == 1 + 20 + 1 + 1
    assert line.nodes[[0, -1]] == pytest.approx(made.net.numbered_bullets[[2, 3]])
    assert line.nodes[1] == line.nodes[-2]
    piece = 7.9 * 2e-3 / 22
    more = np.zeros(len(bare.net.mass))
    more[line.nodes[1:-1]] = piece
    more[line.nodes[1]] = 2.0 * piece
    more[line.nodes[[0, -1]]] = 0.5 * piece
    assert made.net.mass - bare.net.mass == pytest.approx(more, abs=1e-16)


# bad input
