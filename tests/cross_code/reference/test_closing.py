"""What closes a mouth, in reference_impl: known answers and balances."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from reference_impl import acceleration, energy, prepare, read_document
from reference_impl.forces import Whole, response

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


@pytest.mark.ci_for("perimeter")
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
