"""Which step is taken: stable steps, the control of adaptive steps, jumps of the force on the way, events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import listed, no_table, observed, one_thread, without_events
from scipy.sparse import csr_array, diags_array

from exunet.forces import cable_term
from exunet.forces.cable import (
    AxialLaw,
    assemble_pairs,
    reference_blocks,
    reference_spans,
    reference_tangent_stiffness,
)
from exunet.forces.cable_term import Jump
from exunet.forces.linear_term import LinearTerm
from exunet.forces.total import Forces
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.steps import TINY_IN_A_ROW
from exunet.integrators.compiled.workspace import (
    Kept,
    StepInterval,
    StepLimits,
    clock_at,
    motion_at,
    no_samples,
)
from exunet.integrators.exudyn.stepper import StepChoice
from exunet.integrators.protocol import StepsCollapsed
from exunet.methods.method import METHODS, Method
from exunet.model.limits import (
    _largest_eigenvalue,
    largest_damping_rate,
    largest_frequency,
    stable_step,
    step_limit,
)
from exunet.model.system import System
from exunet.scene.scene import Scene
from exunet.simulation import pilot
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.studies.ensemble import wall_times

# The stable step of methods, from frequencies and damping rates

E, RHO, D = 70e9, 1390.0, 0.002
AREA = math.pi / 4 * D**2


CABLE = {"diameter": D, "density": RHO, "youngs_modulus": E}


def square_net(cells: int, **more: Any) -> Scene:
    net = {"topology": "square", "size": float(cells), "mesh": 1.0, "cable": CABLE}
    return Scene.model_validate(listed([], [], 1.0) | {"net": net} | more)


def oscillator(**more: Any) -> Scene:
    """A mass of 1 kg on a massless-looking cable of 1 m, tied to the ground and kept taut by its start."""
    cable = {"area": 1e-6, "density": 2e-6, "youngs_modulus": 1e8}
    net = {"node_masses": [0.0, 1.0], "fixed": [0], "cable": cable}
    return Scene.model_validate(one_thread(1.0, net=net, **more))


def test_the_largest_eigenvalue_is_found_from_above() -> None:
    """Of a chain of masses and springs, 2 + 2 cos(pi / (n + 1)); Lanczos' method adds its tolerance, 1e-6."""
    size = 400
    chain = diags_array([-np.ones(size - 1), 2.0 * np.ones(size), -np.ones(size - 1)], offsets=[-1, 0, 1])
    known = 2.0 + 2.0 * math.cos(math.pi / (size + 1))
    assert known * (1.0 - 1e-12) <= _largest_eigenvalue(csr_array(chain)) <= known * (1.0 + 2e-6)


def test_frequency_of_one_mass_on_a_cable():
    start = prepare(oscillator())
    assert largest_frequency(start.system) == pytest.approx(math.sqrt(1e8 * 1e-6 / 1.0), rel=1e-12)


def tied(way: list[float], thread: list[float], *, divisions: int = 1) -> Scene:
    """A light node on a thread of 1 m along `thread`, tied to a heavy body by a tether along `way`."""
    cable = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e8}
    tether = {**cable, "length": 1.0, "divisions": divisions, "start": {"node": 0}, "end": {"body": "b"}}
    body = {"mass": 10.0, "inertia": [0.1, 0.1, 0.1], "position": way}
    net = {"node_masses": [0.0, 1.0], "cable": cable}
    case = listed([[0.0, 0.0, 0.0], thread], [[0, 1]], 1.0, net=net)
    return Scene.model_validate(case | {"bodies": {"b": body}, "tethers": {"a": tether}})


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


def test_forces_on_points_of_bodies_accelerate_them_no_more_than_inert_masses() -> None:
    """The mobility of the points of two free bodies, 1/m + [p]x^T J^-1 [q]x, is below that of such masses."""
    arms = {"a": [[0.3, 0.1, -0.2]], "b": [[-0.1, 0.1, 0.2], [0.2, 0.4, 0.1], [0.0, -0.3, 0.5]]}
    inertia, number, bodies, mobility = np.array([0.2, 0.3, 0.4]), 0, {}, np.zeros((12, 12))
    for x, (name, points) in enumerate(arms.items()):
        ties = {f"p{k}": {"point": p, "node": number + k} for k, p in enumerate(points)}
        own = {"mass": 2.0, "inertia": inertia.tolist(), "position": [3.0 * x, 0.0, 0.0]}
        bodies[name] = own | {"attachments": ties}
        turns = np.concatenate([np.cross(np.eye(3), p) for p in points])
        same = np.tile(np.eye(3), (len(points), 1))
        rows = slice(3 * number, 3 * (number + len(points)))
        mobility[rows, rows] = same @ same.T / 2.0 + turns @ np.diag(1.0 / inertia) @ turns.T
        number += len(points)
    nodes = [[3.0 * (k > 0) + p[0], *p[1:]] for k, p in enumerate(p for ps in arms.values() for p in ps)]
    case = listed(nodes, [[0, 1], [1, 2], [2, 3]], 1.0, net={"cable": CABLE | {"density": 1e-9}})
    mass = prepare(Scene.model_validate(case | {"bodies": bodies})).system.inert_mass
    room = np.linalg.eigvalsh(np.diag(np.repeat(1.0 / mass, 3)) - mobility)
    assert room.min() > -1e-9  # threads of 1e-14 kg hang on the bodies
    assert mass[0] == pytest.approx(1.0 / np.linalg.eigvalsh(mobility[:3, :3]).max(), rel=1e-9)


def test_threads_that_a_tether_turns_count_with_all_their_stiffness():
    """As in a tow, where both threads of a corner hang behind it in one line with the tether."""
    tether = {**CABLE, "length": 1.0, "start": {"node": 0}, "end": {"body": "b"}}
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


def test_weak_methods_have_a_practical_limit():
    """Where |R(iy)| = 1.01: sqrt(1 + y^2) of Euler's method, sqrt(1 + y^4 / 4) of the mid-point rule."""
    assert step_limit("ExplicitEuler", 10.0) == pytest.approx(math.sqrt(0.0201) / 10.0, rel=1e-6)
    assert step_limit("ExplicitMidpoint", 10.0) == pytest.approx(0.0804**0.25 / 10.0, rel=1e-6)
    assert stable_step("RK67", 10.0) < step_limit("RK67", 10.0)
    assert step_limit("RK44", 10.0) == stable_step("RK44", 10.0)
    assert stable_step("ExplicitEuler", 10.0) == stable_step("ExplicitMidpoint", 10.0) == 0.0
    assert math.isinf(step_limit("GeneralizedAlpha", 1e5))
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


# The control of the compiled loop, by hand: errors and jumps are given

TOLERANCE, LONGEST, LEAST = 1e-3, 0.5, 2.0**-10
LIMITS = StepLimits(TOLERANCE, LONGEST, LEAST)
NO_JUMP = (math.inf, math.inf)


class Control:
    """A control whose attempts have errors of so many tolerances, and whose looks for jumps find these."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        errors: Sequence[float],
        jumps: Sequence[tuple[float, float]] = (),
        step: float = 0.1,
    ) -> None:
        self.tried: list[float] = []
        self.looked: list[float] = []
        left, ahead = iter(errors), iter(jumps)

        def attempt(t: float, h: float, m: Any) -> tuple[float, float]:
            self.tried.append(h)
            steps.stages_of(m.work).x1[0] = m.x[0] + h
            steps.stages_of(m.work).a7[0] = t
            return next(left) * TOLERANCE, t

        def jump_ahead(within: float, tolerance: float, t: float, m: Any, seen: Any) -> tuple[float, float]:
            assert tolerance == TOLERANCE
            self.looked.append(within)
            return next(ahead)

        monkeypatch.setattr(steps, "dormand_prince_step", attempt)
        monkeypatch.setattr(steps, "jump_ahead", jump_ahead)
        monkeypatch.setattr(steps, "borrowed", lambda value: value, raising=False)
        monkeypatch.setattr(steps, "BODIES", False, raising=False)
        monkeypatch.setattr(steps, "remember", lambda *state: None, raising=False)
        without_events(monkeypatch)
        motion = motion_at(np.zeros(1), np.zeros(1), np.ones(1), no_table(), np.zeros((0, 3)), 1)
        seen = observed(np.zeros((0, 2), dtype=int), half=np.ones(1), look_above=np.inf)
        self.kept = Kept(np.zeros(50), np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(50))
        self.clock = clock_at(0.0, step)
        self.run = StepInterval(motion, self.clock, seen, self.kept, no_samples())

    def go(self, until: float = 100.0, attempts: int = 1, every: int = 1) -> int:
        return steps.chosen_steps(LIMITS, until, attempts, 0, every, self.run)

    def at(self, name: str) -> float:
        return float(self.clock[name][0])


SHRUNK = 0.9 / 2.0  # after an error of 32 tolerances
TRIED: dict[str, tuple[float, list[float], list[float]]] = {
    # first step, errors; the steps that are tried, and what comes after them
    "at most twice as long": (0.1, [0.0, 1e-9], [0.1, 0.2, 0.4]),
    "by the fifth root": (0.1, [1.0, 2.0**-5], [0.1, 0.09, 0.09 * 1.8]),
    "no longer than the longest": (0.4, [0.0, 0.0], [0.4, 0.5, 0.5]),
    "rejected": (0.1, [32.0, 1.0], [0.1, 0.1 * SHRUNK, 0.1 * SHRUNK * 0.9]),
    "not longer at once": (0.1, [32.0, 0.0, 0.0], [0.1, 0.045, 0.045, 0.09]),
    "rejected twice": (0.1, [32.0, 32.0, 0.0], [0.1, 0.045, 0.045 * SHRUNK, 0.045 * SHRUNK]),
    "at most a fifth": (0.1, [1e9, 0.0], [0.1, 0.02, 0.02]),
    "beyond numbers": (0.1, [math.inf, 0.0], [0.1, 0.02, 0.02]),
    "not a number": (0.1, [math.nan, 0.0], [0.1, 0.02, 0.02]),
    "just the tolerance": (0.1, [1.0], [0.1, 0.09]),
    "no less than the least": (2.0 * LEAST, [1e9, 1e9, 0.0], [2.0 * LEAST, LEAST, LEAST, 2.0 * LEAST]),
}


@pytest.mark.parametrize("name", TRIED)
def test_steps_follow_from_errors(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first, errors, steps = TRIED[name]
    control = Control(monkeypatch, errors, [NO_JUMP] * 9, first)
    control.go(attempts=len(errors))
    follows = min(control.at("step"), LONGEST)
    assert [*control.tried, follows] == pytest.approx(steps, rel=1e-12)
    taken = [h for h, error in zip(steps, errors, strict=False) if error <= 1.0 or h <= LEAST]
    assert control.at("time") == pytest.approx(sum(taken), rel=1e-12)
    assert (control.at("steps"), control.at("rejections")) == (len(taken), len(errors) - len(taken))
    assert control.run.motion.x[0] == pytest.approx(sum(taken), rel=1e-12)


LAST_STEPS: dict[str, tuple[float, float, list[float], float]] = {
    # first step, end, the steps to it with errors of the tolerance / 2, and the step that is kept for later
    "cut short": (0.3, 0.1, [0.1], 0.3),
    "as long": (0.25, 0.25, [0.25], 0.25 * 0.9 * 2.0**0.2),
    "all but as long": (0.25, 0.25 * (1.0 + 5e-8), [0.25 * (1.0 + 5e-8)], 0.25 * 0.9 * 2.0**0.2),
    "a little longer": (0.25, 0.25 * (1.0 + 2e-7), [0.125 * (1.0 + 2e-7)] * 2, 0.25),
    "two of equal length": (0.3, 0.5, [0.25, 0.25], 0.3),
    "twice as long": (0.25, 0.5, [0.25, 0.25], 0.25 * 0.9 * 2.0**0.2),
}


@pytest.mark.parametrize("name", LAST_STEPS)
def test_the_last_steps_end_where_they_must(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first, until, steps, later = LAST_STEPS[name]
    control = Control(monkeypatch, [0.5] * 9, step=first)
    rows = control.go(until, attempts=9, every=100)
    assert control.tried == pytest.approx(steps, rel=1e-12)
    assert control.at("time") == until
    assert control.at("step") == pytest.approx(later, rel=1e-6)
    assert (rows, control.kept.time[0]) == (1, until)


def test_steps_of_the_least_length_in_a_row_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to four times as long; one that is longer ends the row, and one that is not finite all."""
    control = Control(monkeypatch, [1.0, 0.0, 0.0, 0.0, 1e9, 1e9], step=4.0 * LEAST)
    counts = []
    for _ in range(3):
        control.go()
        counts.append(control.at("tiny"))
    assert control.tried == pytest.approx(LEAST * np.array([4.0, 3.6, 7.2]), rel=1e-12)
    assert counts == [1.0, 2.0, 0.0]
    control = Control(monkeypatch, [2.0, 2.0, math.inf], [NO_JUMP], step=LEAST)
    for known in (1.0, 2.0, math.inf):
        control.go()
        assert control.at("tiny") == known
    assert (control.at("steps"), control.at("rejections")) == (2, 1)


# Jumps of the forces, of which steps end just before one, and one goes across. A step of 0.1 s is rejected at
# first, with an error of 32 tolerances, after which 0.045 s would be tried.
FAR, NEAR = (0.03, 0.001), (0.0005, 0.001)
JUMPS: dict[str, tuple[list[float], list[tuple[float, float]], list[float], list[float]]] = {
    # errors, what looks find; the steps that are tried, and within what time is looked
    "none": ([32.0, 1.0], [NO_JUMP], [0.1, 0.045], [0.1]),
    "to it, across and on": (
        [32.0, 1.0, 1e9, 1.0, 1.0],
        [FAR, FAR, NEAR, NO_JUMP],
        [0.1, 0.0295, 0.0015, 0.1, 0.09],
        [0.1, 0.1, 0.1, 0.1],
    ),
    "by a hundredth of the way": ([32.0, 1.0], [(0.05, 1e-5)] * 2, [0.1, 0.05 - 5e-4], [0.1, 0.1]),
    "just as near": ([32.0, 1e9], [FAR, (0.001, 0.001)], [0.1, 0.002], [0.1, 0.1]),
    "the way is too long": (
        [32.0, 32.0, 1.0, 1.0],
        [FAR, FAR, FAR],
        [0.1, 0.0295, 0.0295 * 0.45, 0.0295 * 0.45 * 0.9],
        [0.1, 0.1, 0.1],
    ),
    "gone when looked at again": ([32.0, 1.0, 1.0], [FAR, NO_JUMP], [0.1, 0.045, 0.0405], [0.1, 0.1]),
    "across is not finite": (
        [32.0, math.inf, 1.0],
        [NEAR, NEAR, FAR],
        [0.1, 0.0015, LEAST],
        [0.1, 0.1, 0.1],
    ),
}


@pytest.mark.parametrize("name", JUMPS)
def test_jumps_are_approached_and_crossed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    errors, jumps, steps, looks = JUMPS[name]
    control = Control(monkeypatch, errors, jumps)
    control.go(attempts=len(errors))
    assert control.tried == pytest.approx(steps, rel=1e-12)
    assert control.looked == pytest.approx(looks, rel=1e-12)
    if name == "to it, across and on":
        assert control.at("time") == pytest.approx(0.0295 + 0.0015 + 0.19, rel=1e-12)
        assert (control.at("beyond"), control.at("towards")) == (0.0, 0.0)


def test_a_collapse_ends_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once more of the least length came in a row than may; a thousand are tried before that is looked at."""
    control = Control(monkeypatch, [2.0] * 3000, step=LEAST)
    times = np.array([0.0, 1e9])
    assert steps.through_chosen(times, LIMITS, 1000.0, 10**9, control.run) == 1
    assert len(control.tried) == 2000
    control = Control(monkeypatch, [2.0] * 3000, step=LEAST)
    assert steps.through_chosen(times, LIMITS, 999.0, 10**9, control.run) == 1
    assert len(control.tried) == 1000


# The control of Exudyn's adaptive methods


def choice(attempt: float = 0.01, error: float = 1.0, jumps: list[Jump | None] | None = None) -> Any:
    """The control of DOPRI5, after a step from 1 s that was tried with `attempt` and had an error estimate.

    jumps : what a search for the next jump finds, one after the other
    """
    progress = SimpleNamespace(
        currentTime=1.0,
        currentStepSize=attempt,
        automaticStepSizeError=error,
        minStepSize=1e-4,
        maxStepSize=0.05,
        initialStepSize=0.0,
    )
    integration = SimpleNamespace(stepSizeMaxIncrease=2.0, stepSizeSafety=0.9, absoluteTolerance=1e-6)
    left = None if jumps is None else iter(jumps)
    found = StepChoice(
        SimpleNamespace(  # type: ignore[arg-type]
            method=Method.DOPRI5, tolerance=1e-6, first_step=0.005, least_step=1e-5
        ),
        SimpleNamespace(it=progress),
        SimpleNamespace(timeIntegration=integration),
        None if left is None else lambda within: next(left),
    )
    found.attempt = attempt
    found.begin_stretch(2.0)
    return found, progress, integration


@pytest.mark.parametrize(
    ("attempt", "error", "step"),
    [
        (0.01, 32.0, 0.9 * 0.01 / 2.0),  # error^(-1/5), times the safety
        (0.01, 1.0, 0.9 * 0.01),
        (0.01, 0.5, 0.9 * 0.01 * 2.0**0.2),
        (0.01, 1e-3, 0.02),  # not more than twice the step
        (0.01, 0.0, 0.02),
        (0.04, 1e-3, 0.05),  # nor than the longest
        (0.01, 1e15, 1e-4),  # nor less than the least
    ],
)
def test_the_next_stretch_begins_with_the_step_of_the_engines_own_control(
    attempt: float, error: float, step: float
) -> None:
    found, _, _ = choice(attempt, error)
    assert found.numbers() == pytest.approx([1.0, 0.005])  # before the first stretch ends: the plan's
    found.end_stretch(1.5)
    assert found.numbers() == pytest.approx([1.5, step], rel=1e-14)
    again, progress, _ = choice()
    again.restore(found.numbers())
    assert np.array_equal(again.numbers(), found.numbers())
    assert [progress.currentTime, progress.initialStepSize] == found.numbers().tolist()


def test_a_jump_is_approached_crossed_with_a_lifted_tolerance_and_left_with_the_step_of_before() -> None:
    far, near = Jump(0.004, 8.0, 1e-5), Jump(2e-6, 8.0, 1e-5)
    found, progress, integration = choice(0.01, 40.0, [far, near, None])
    found.choose(1.004, True, True)  # rejected: to just before the jump
    assert progress.currentStepSize == pytest.approx(0.004 - 0.01 * 0.004, rel=1e-14)
    assert integration.absoluteTolerance == 1e-6
    found.choose(1.004, True, False)  # across it, with the error that this costs
    assert progress.currentStepSize == pytest.approx(1.2e-5, rel=1e-14)
    assert integration.absoluteTolerance == pytest.approx(8.0 * 1.2e-5, rel=1e-14)
    found.choose(1.004, True, False)  # none ahead: the step that had been tried before
    assert progress.currentStepSize == 0.01
    assert integration.absoluteTolerance == 1e-6


def test_steps_that_are_no_longer_than_four_of_the_least_collapse_in_a_row() -> None:
    """One that is longer, or a new stretch, ends the row."""
    found, progress, _ = choice()
    least, tiny = 1e-5, int(TINY_IN_A_ROW)
    for size, number in ((4.0 * least, tiny), (4.1 * least, 1), (least, tiny)):
        progress.currentStepSize = size
        for _ in range(number):
            found.refuse_collapse(1.5)
    found.begin_stretch(2.0)
    for _ in range(tiny):
        found.refuse_collapse(1.5)
    with pytest.raises(StepsCollapsed):
        found.refuse_collapse(1.5)


# The next jump of the force: both searches against the roots of a polynomial

RING = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
LENGTH, STIFFNESS = np.array([1.0, 1.2, 0.9, 1.1]), np.array([30.0, 20.0, 50.0, 40.0])
TAU, MASS = np.array([0.02, 0.05, 0.01, 0.03]), np.array([0.5, 2.0, 1.0, 0.7])
WITHIN = 0.4  # [s]
ROUND_OFF = 64.0 * 2.0**-52


def motions(number: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Positions, velocities, accelerations (4, 3) at which most elements are slack."""
    random = np.random.default_rng(7)
    return [
        (random.normal(0.0, 0.3, (4, 3)), random.normal(0.0, 1.0, (4, 3)), random.normal(0.0, 0.7, (4, 3)))
        for _ in range(number)
    ]


def first_crossing(e: int, state: Any) -> float:
    """When an element that is slack becomes taut, from the roots of its squared length; infinite if never."""
    (i, j), (x, v, a) = RING[e], state
    d, u, b = x[j] - x[i], v[j] - v[i], a[j] - a[i]
    if np.linalg.norm(d) > LENGTH[e]:
        return math.inf
    roots = np.roots([b @ b / 4.0, u @ b, u @ u + d @ b, 2.0 * d @ u, d @ d - LENGTH[e] ** 2])
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= WITHIN)]
    return float(real.min(initial=math.inf))


def by_hand(state: Any, tolerance: float, time: float) -> tuple[float, float, float] | None:
    """Time until the first jump that matters [s], the step across it [s], and the jumps within that step."""
    found = []
    for e in range(4):
        after = first_crossing(e, state)
        if math.isfinite(after):
            (i, j), (x, v, a) = RING[e], state
            u = v[j] - v[i] + after * (a[j] - a[i])
            d = x[j] - x[i] + after * (v[j] - v[i]) + 0.5 * after**2 * (a[j] - a[i])
            rate = float(d @ u / np.linalg.norm(d))
            size = STIFFNESS[e] * TAU[e] / LENGTH[e] * rate / min(MASS[RING[e]])
            if size * WITHIN > tolerance:
                place = np.abs(state[0][RING[e]]).max() + LENGTH[e]
                step = min(WITHIN, max(tolerance / size, ROUND_OFF * max(time, place / rate)))
                found.append((after, step, size))
    if not found:
        return None
    after, step, _ = min(found)
    return after, step, sum(size for when, _, size in found if when <= after + step)


def compiled(state: Any, tolerance: float, time: float, **changed: Any) -> tuple[float, float]:
    x, v, a = (part.ravel().copy() for part in state)
    inverse = np.repeat(1.0 / MASS, 3)
    motion = motion_at(x, v, inverse, no_table(), np.zeros((0, 3)), 12)
    motion.work[0] = a
    seen = observed(RING, LENGTH, STIFFNESS, 2.0 * TAU)._replace(**changed)
    return steps.jump_ahead(WITHIN, tolerance, time, motion, seen)


def of_arrays(
    state: Any, tolerance: float, time: float, fixed: tuple[int, ...] = ()
) -> cable_term.Jump | None:
    blocks: Any = SimpleNamespace(
        mass=MASS, net=SimpleNamespace(element_nodes=RING, fixed_nodes=np.array(fixed, dtype=int))
    )
    return cable_term.jump_ahead(blocks, AxialLaw(LENGTH, STIFFNESS, TAU), WITHIN, tolerance, time, state)


@pytest.mark.parametrize(("tolerance", "time"), [(1e-3, 0.0), (0.3, 1.0), (1e-13, 0.0), (1e-13, 5.0)])
def test_both_forms_find_the_first_jump_that_matters(tolerance: float, time: float) -> None:
    met = 0
    for state in motions(120):
        wanted = by_hand(state, tolerance, time)
        found, (after, across) = of_arrays(state, tolerance, time), compiled(state, tolerance, time)
        if wanted is None:
            assert found is None
            assert after == across == math.inf
            continue
        assert found is not None
        assert [found.after, found.step] == pytest.approx(wanted[:2], rel=1e-9)
        assert [after, across] == pytest.approx(wanted[:2], rel=1e-9)
        assert found.size == pytest.approx(wanted[2], rel=1e-9)
        assert found.to_it == pytest.approx(after - max(0.5 * across, 0.01 * after), rel=1e-9)
        met += 1
    assert met > 30


def test_elements_that_do_not_count_have_no_jump() -> None:
    """Without viscosity, broken, or between nodes that are held still."""
    state = next(s for s in motions(50) if by_hand(s, 1e-3, 0.0) is not None)
    assert compiled(state, 1e-3, 0.0)[0] < math.inf
    assert compiled(state, 1e-3, 0.0, jumps=np.zeros(4)) == (math.inf, math.inf)
    assert compiled(state, 1e-3, 0.0, stiffness=np.zeros(4)) == (math.inf, math.inf)
    assert of_arrays(state, 1e-3, 0.0, fixed=(0, 1, 2, 3)) is None


def test_the_pilot_of_a_large_net_is_that_of_a_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """A net above the bound has the step of the whole net to 5 %, from the forces of a part of its nodes."""
    system = prepare(square_net(24, effects={"material_damping": {"relaxation_time": 1e-6}})).system
    whole = pilot.part_of_stable_step(system)
    monkeypatch.setattr(pilot, "LARGEST_NET", 800)  # of 1200 elements
    seen, tension = set[int](), pilot.element_tension

    def counted(net: Any, law: Any, x: Any, *more: Any) -> Any:
        seen.add(len(x))
        return tension(net, law, x, *more)

    monkeypatch.setattr(pilot, "element_tension", counted)
    part = pilot.part_of_stable_step(system)
    assert part == pytest.approx(whole, rel=0.05)
    assert pilot.SAFETY < part < pilot.LARGEST_PART
    assert max(seen) < 500  # of 625 nodes


def test_the_wall_time_of_a_run_is_estimated() -> None:
    """Of a fixed step in the compiled loop; none of adaptive steps."""
    start = prepare(square_net(4, solver={"method": "VelocityVerlet"}, engine={"backend": "compiled"}))
    simulate(start)  # compiles, if need be
    times = wall_times(start)
    assert not isinstance(times, str)
    assert min(times) > 0.0
    assert isinstance(wall_times(prepare(square_net(4, solver={"method": "DOPRI5"}))), str)
