"""What the compiled loop sees, keeps and adds up of its steps, as plain Python on a few nodes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import no_table
from seen_elements import seen_of

from exunet.forces import cable
from exunet.forces.cable import Law
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.loop import StepExtremes, least_energy_beyond
from exunet.integrators.compiled.workspace import (
    EqualSteps,
    Kept,
    Motion,
    ObservedSteps,
    Run,
    Samples,
    StepLimits,
    clock_at,
    motion_at,
    no_samples,
)
from exunet.kernels.kernel import Takes

ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
LENGTH, STIFFNESS = np.array([0.7, 0.6, 0.9, 0.8]), np.array([30.0, 20.0, 50.0, 40.0])
TWICE_TAU = np.array([0.04, 0.1, 0.0, 0.06])
NET: Any = SimpleNamespace(element_nodes=ENDS)
FIRST, LAST = 1.5, 2.7  # [s]


def seen_so_far(
    look_above: float = 0.0,
    twice: np.ndarray | None = None,
    n_v: int = 12,
    bounds: tuple[int, ...] = (0, 4),
) -> ObservedSteps:
    half, times = np.linspace(0.2, 1.3, n_v), np.zeros(4) if twice is None else twice
    return seen_of(ENDS, LENGTH, STIFFNESS, times, half=half, look_above=look_above, bounds=bounds)


def states(number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(3)
    return [(random.normal(0.0, 0.5, (4, 3)), random.normal(0.0, 1.0, (4, 3))) for _ in range(number)]


@pytest.mark.parametrize("n_v", range(9, 14))
def test_the_kinetic_energy_is_summed_over_all_coordinates(n_v: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "BODIES", False, raising=False)
    v = np.random.default_rng(n_v).normal(size=n_v)
    seen = seen_so_far(np.inf, n_v=n_v)
    motion = motion_at(np.zeros(n_v), np.zeros(n_v), np.ones(n_v), no_table(), np.zeros((0, 3)), n_v)
    steps.stages_of(motion.work).v1[:] = v
    assert steps.accept(motion, seen.half) == pytest.approx((seen.half * v**2).sum(), rel=1e-14)
    assert (motion.v == v).all()


def test_the_largest_elastic_and_the_least_kinetic_energy_are_kept() -> None:
    seen, v = seen_so_far(np.inf), np.zeros(12)
    for elastic, kinetic in ((7.0, 3.0), (6.0, 4.0), (5.0, 2.0)):
        steps.see(0.5, elastic, kinetic, v, v, seen)
    assert (seen.peaks["elastic"][0], seen.peaks["kinetic"][0]) == (7.0, 2.0)


@pytest.mark.parametrize("viscous", [False, True])
def test_the_largest_tension_is_that_of_the_law(viscous: bool) -> None:
    law = Law(LENGTH, STIFFNESS, 0.5 * TWICE_TAU if viscous else None)
    seen = seen_so_far(twice=TWICE_TAU if viscous else None)
    largest, every = 0.0, []
    for time, (x, v) in enumerate(states(8)):
        steps.observe_tensions(float(time), x.ravel(), v.ravel(), seen)
        tension = cable.element_tension(NET, law, x, v)
        if tension.max() > largest:
            largest, when, where = tension.max(), time, int(np.argmax(tension))
        told = seen.largest[0]
        assert told["tension"] == pytest.approx(largest, rel=1e-13)
        assert (told["time"], told["element"]) == (when, where)
        every.append(np.maximum(tension, 0.0))
        assert seen.of_elements == pytest.approx(np.max(every, axis=0), rel=1e-13)
    assert largest > 0.0
    assert (seen.peaks["look_above"][0] == 0.0) == viscous


def test_no_tension_is_larger_below_the_energy_from_which_states_are_looked_at() -> None:
    """That of the strain e with EA e (1 + e) = N, in the element that needs least; near to it for small N."""
    for scale in (1.0, 1e-3):
        x = np.array(
            [[0.0, 0.0, 0.0], [0.7 * (1.0 + 0.05 * scale), 0.0, 0.0], [0.6, 0.1, 0.0], [0.1, 0.0, 0.0]]
        )
        seen = seen_so_far()
        steps.observe_tensions(0.0, x.ravel(), np.zeros(12), seen)
        tension = float(seen.largest["tension"][0])
        strain = np.array([np.roots([1.0, 1.0, -tension / ea]).max() for ea in STIFFNESS])
        least = 0.5 * STIFFNESS * LENGTH * strain**2
        assert seen.peaks["look_above"][0] == pytest.approx(least.min(), rel=1e-9)
        taut = 0.5 * 30.0 * 0.7 * cable.green_lagrange_strain(0.7 * (1.0 + 0.05 * scale), 0.7) ** 2
        assert least[0] < taut < least[0] * (1.0 + 0.1 * scale)


@pytest.mark.parametrize("viscous", [False, True])
def test_each_group_has_the_largest_tension_of_its_own(viscous: bool) -> None:
    """The first two elements, and the last two; none may be missed below the energy that is looked for."""
    law = Law(LENGTH, STIFFNESS, 0.5 * TWICE_TAU if viscous else None)
    seen = seen_so_far(twice=TWICE_TAU if viscous else None, bounds=(0, 2, 4))
    every = []
    for time, (x, v) in enumerate(states(8)):
        elastic = float(cable.elastic_energy(law, cable.lengths(NET, x[None]))[0])
        steps.see(float(time), elastic, 1.0, x.ravel(), v.ravel(), seen)
        every.append(cable.element_tension(NET, law, x, v))
        for told, group in zip(seen.largest, (slice(0, 2), slice(2, 4)), strict=True):
            own = np.array(every)[:, group]
            when, where = np.unravel_index(own.argmax(), own.shape)
            assert told["tension"] == pytest.approx(own.max(), rel=1e-13)
            assert (told["time"], told["element"]) == (when, group.start + where)
    assert seen.largest["tension"][0] != seen.largest["tension"][1]


@pytest.mark.parametrize("viscous", [False, True])
def test_of_tensions_that_are_the_same_the_first_is_told(viscous: bool) -> None:
    """Of the first time, and of the first element of those that are the same to the bit."""
    length, stiffness, twice = np.full(4, 0.5), np.full(4, 8.0), np.full(4, 0.25 if viscous else 0.0)
    seen = seen_of(ENDS, length, stiffness, twice, half=np.ones(12))
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]).ravel()
    for time in (1.0, 2.0):
        steps.observe_tensions(time, x, np.zeros(12), seen)
        assert seen.largest[0]["tension"] > 0.0
        assert (seen.largest[0]["time"], seen.largest[0]["element"]) == (1.0, 0)


def test_what_is_watched_of_a_step_goes_into_its_row() -> None:
    """Some entries, the mean place and velocity of the first points, what memories tell; until rows end."""
    random = np.random.default_rng(9)
    motion = motion_at(*random.normal(size=(2, 15)), np.ones(15), no_table(), np.zeros((0, 3)), 15)
    weights, memory = random.uniform(size=4), random.normal(size=6)
    of_x, of_v, of_memory = np.array([2, 7]), np.array([1, 14]), np.array([5, 0, 3])
    looks = Samples(
        np.array([0, 2]), of_x, of_v, of_memory, memory, weights, np.zeros(3),
        *(np.full((15, 3), 7.0) for _ in "xv"), np.zeros((3, 3)), np.zeros((3, 6)),
    )  # fmt: skip
    assert [steps.look(time, motion, looks) for time in (0.5, 0.75)] == [False, True]
    assert looks.at.tolist() == [2, 2]
    assert looks.time.tolist() == [0.5, 0.75, 0.0]
    for found, entries, known in ((looks.x, of_x, motion.x), (looks.v, of_v, motion.v)):
        others = np.setdiff1d(np.arange(15), entries)
        np.testing.assert_array_equal(found[entries, :2], np.tile(known[entries, None], (1, 2)))
        assert (found[others] == 7.0).all()
        assert (found[:, 2] == 7.0).all()
    np.testing.assert_array_equal(looks.reported[:2], np.tile(memory[of_memory], (2, 1)))
    mean = [weights @ item[:12].reshape(4, 3) for item in (motion.x, motion.v)]
    np.testing.assert_allclose(looks.mean[:2], np.tile(np.concatenate(mean), (2, 1)), rtol=1e-13)


@pytest.fixture
def dissipating(monkeypatch: pytest.MonkeyPatch) -> None:
    """One coordinate of 1 kg under the force t, and a power 4 t^3 v that is taken out."""

    def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
        out[0] += t
        return float(t), 0.0

    def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float:
        return 4.0 * t**3 + float(x[0]) ** 2 + 3.0 * float(v[0]) ** 2

    monkeypatch.setattr(steps, "add_forces", add_forces, raising=False)
    monkeypatch.setattr(steps, "borrowed", lambda value: value, raising=False)
    monkeypatch.setattr(steps, "power", power, raising=False)
    monkeypatch.setattr(steps, "has_power", lambda rows: True, raising=False)
    monkeypatch.setattr(steps, "extra_work", lambda h, *state: 0.5 * h, raising=False)
    for name in ("BODIES", "FIRST_ORDER"):
        monkeypatch.setattr(steps, name, False, raising=False)
    monkeypatch.setattr(steps, "remember", lambda *state: None, raising=False)


def moving() -> tuple[Motion, np.ndarray, ObservedSteps, Kept]:
    """At FIRST where x = t^3 / 6, v = t^2 / 2, which the force t continues."""
    state = (np.array([FIRST**3 / 6.0]), np.array([FIRST**2 / 2.0]))
    motion = motion_at(*state, np.ones(1), no_table(Takes.INTEGRATED), np.zeros((0, 3)), 1)
    seen = seen_of(np.zeros((0, 2), dtype=int), half=np.ones(1), look_above=np.inf)
    steps.begin(FIRST, False, motion)
    kept = Kept(np.zeros(90), np.zeros((90, 1)), np.zeros((90, 1)), np.zeros(90))
    return motion, clock_at(FIRST, 0.01), seen, kept


def taken(t: float) -> float:
    """The integral from FIRST of 4 t^3 + (t^3 / 6)^2 + 3 (t^2 / 2)^2, and 1/2 for each second."""
    t, s = np.array(t), FIRST
    return float(t**4 - s**4 + (t**7 - s**7) / 252.0 + 0.15 * (t**5 - s**5) + 0.5 * (t - s))


@pytest.mark.usefixtures("dissipating")
@pytest.mark.parametrize("verlet", [False, True])
def test_equal_steps_add_up_work_wherever_they_are_interrupted(verlet: bool) -> None:
    """Simpson's rule over the Hermite polynomial, of order 4: exact for t^3 and nearly so for the rest."""
    found = []
    for parts in ((60,), (17, 43)):
        motion, clock, seen, kept = moving()
        row = done = 0
        for part in parts:
            equal = EqualSteps(FIRST, LAST, 60, done, part)
            row = steps.equal_steps(verlet, equal, row, 7, Run(motion, clock, seen, kept, no_samples()))
            done += part
        times = FIRST + (LAST - FIRST) / 60.0 * np.array([7, 14, 21, 28, 35, 42, 49, 56, 60])
        assert row == 9
        np.testing.assert_allclose(kept.time[:row], times, rtol=1e-14)
        allowed = 1e-3 if verlet else 1e-8  # Verlet's own path is of order 2
        np.testing.assert_allclose(kept.taken[:row], [taken(t) for t in times], rtol=allowed)
        found.append((motion.x[0], motion.v[0], motion.taken[0], *kept.taken))
    assert found[0] == found[1]


@pytest.mark.usefixtures("dissipating")
def test_steps_of_much_energy_are_all_kept() -> None:
    """The elastic energy told here is the time; above 2 s each step is kept, below one in twenty."""
    motion, clock, seen, kept = moving()
    seen.peaks["keep_above"] = 2.0 + 1e-9
    run = Run(motion, clock, seen, kept, no_samples())
    rows = steps.equal_steps(False, EqualSteps(FIRST, LAST, 60, 0, 60), 0, 20, run)
    numbers = np.rint((kept.time[:rows] - FIRST) / 0.02).astype(int)
    assert numbers.tolist() == [20, *range(26, 61)]


@pytest.mark.usefixtures("dissipating")
def test_chosen_and_equal_steps_pass_through_given_times() -> None:
    times = np.array([FIRST, 1.6, 2.05, LAST])
    for equal in (False, True):
        motion, clock, seen, kept = moving()
        rows = kept._replace(time=np.zeros(4))
        run = Run(motion, clock, seen, rows, no_samples())
        if equal:
            reached = steps.through_equal(False, times, 0.02, run)
            assert clock["steps"][0] == 5 + 23 + 33  # no step longer than 0.02 s
        else:
            control = StepLimits(tolerance=1e-9, longest=0.05, least=1e-9)
            reached = steps.through_chosen(times, control, 10.0, 10**6, run)
            assert clock["time"][0] == LAST
        assert reached == 4
        np.testing.assert_array_equal(rows.time, times)
        np.testing.assert_allclose(rows.x[:4, 0], times**3 / 6.0, rtol=1e-12)
        np.testing.assert_allclose(rows.v[:4, 0], times**2 / 2.0, rtol=1e-12)
        np.testing.assert_allclose(rows.taken[:4], [taken(t) for t in times], rtol=1e-6, atol=1e-12)


def test_below_an_energy_no_element_is_stretched_too_far() -> None:
    """That of the element which has the least where it alone is as long as the law holds."""
    system: Any = SimpleNamespace(
        forces=SimpleNamespace(cable=SimpleNamespace(law=Law(LENGTH, STIFFNESS, None)))
    )
    each = []
    for e in range(4):
        long = LENGTH.copy()
        long[e] *= cable.STRETCH_BOUND
        each.append(float(cable.elastic_energy(Law(LENGTH, STIFFNESS, None), long[None])[0]))
    assert least_energy_beyond(system) == pytest.approx(min(each), rel=1e-12)
    assert min(each) > 0.0


@pytest.mark.parametrize(("locked", "wound"), [(True, 0.25), (True, 0.9), (False, 0.25)])
def test_the_outlet_of_a_reel_is_an_element_while_it_is_locked(locked: bool, wound: float) -> None:
    """From the drum to the node that is out, as long as what is out, ratio (base - wound), or the least."""
    seen = seen_of(ENDS, LENGTH + 9.0, STIFFNESS.copy(), TWICE_TAU)._replace(jumps=np.full(4, 7.0))
    seen.first[:], seen.second[:] = 77, 78  # as another outlet has left them
    outlet = SimpleNamespace(
        state=np.array([3]), drum=np.array([15]), far=np.array([6]), ratio=0.8, base=1.0, least=0.3,
        stiffness=123.0,
    )  # fmt: skip
    winding: Any = SimpleNamespace(
        reel=SimpleNamespace(elements=(1, 2)),
        is_locked=lambda memory: locked,
        outlet_now=lambda memory: (2, outlet),
    )
    law = Law(LENGTH, STIFFNESS, None)
    sight: Any = SimpleNamespace(
        _seen=seen, _system=SimpleNamespace(net=NET, forces=SimpleNamespace(cable=SimpleNamespace(law=law)))
    )
    StepExtremes._see_outlet(sight, winding, {}, np.array([5.0, 5.0, 5.0, wound, 5.0]))
    length, first, second = LENGTH + 9.0, np.full(4, 77), np.full(4, 78)
    stiffness, jumps = STIFFNESS.copy(), np.array([7.0, 0.1, 0.0, 7.0])
    length[1:3], first[1:3], second[1:3] = LENGTH[1:3], [3, 6], [6, 9]
    if locked:
        first[2], second[2], length[2] = 15, 6, 0.8 * max(1.0 - wound, 0.3)
        stiffness[2], jumps[2] = 123.0, 0.0
    found = (seen.first, seen.second, seen.length, seen.stiffness, seen.jumps)
    for one, known in zip(found, (first, second, length, stiffness, jumps), strict=True):
        np.testing.assert_allclose(one, known, rtol=1e-14)
