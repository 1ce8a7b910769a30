"""A simulation that is stepped from outside: advance, read, push, fail; what it shows and what it refuses."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any, NoReturn

import numpy as np
import pytest
from restarts import COARSE, DAMPED, HOPELESS, engine, seen
from scenes import BACKENDS, CASES, every_backend, pair_of_masses, thrown

import exunet
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, RunStopped
from exunet.integrators.protocol import IntegrationFailed
from exunet.methods.method import METHODS, Kind
from exunet.scene.casefile import load
from exunet.simulation import simulation
from exunet.simulation.preparation import prepare, prepare_case
from exunet.simulation.simulation import Energies, Simulation

PLANAR = CASES / "planar_deployment.toml"
UNDAMPED = CASES / "planar_undamped.toml"
LAUNCH = CASES / "effects" / "launch_force.toml"


def through(sim: Simulation, times: Iterable[float]) -> None:
    """To each of the times, where the energy is read, so that the guards have looked."""
    for time in times:
        sim.advance_to(time)
        assert np.isfinite(sim.energy.kinetic)


def advanced(sim: Simulation, duration: float, number: int) -> Simulation:
    """Through so many equal times, without reading."""
    for _ in range(number):
        sim.advance(duration / number)
    return sim


@every_backend
def test_read_outs_are_what_a_run_stores(backend: str) -> None:
    """States and balances to the last bit; energies are sums over one state or many: to their round-off."""
    scene = thrown({"method": "DOPRI5"}, end=0.25, engine=engine(backend), effects=DAMPED)
    run, sim = exunet.run(scene), Simulation(scene)
    total = run.kinetic[0] + run.elastic[0]
    for k, time in enumerate(run.time):
        if k:
            sim.advance_to(time)
        net, energy = sim.net, sim.energy
        assert sim.time == time
        for name in ("position", "velocity", "strain", "tension"):
            assert np.array_equal(getattr(net, name), getattr(run, name)[k])
        assert energy.dissipated == run.dissipated[k]
        ours = (energy.kinetic, energy.elastic, energy.potential)
        assert ours == pytest.approx((run.kinetic[k], run.elastic[k], run.potential[k]), abs=1e-14 * total)
    assert np.array_equal(sim.net.bullets, run.net.bullet_nodes)
    assert sim.largest_tension == run.run.largest_tension
    assert sim.counts.steps == run.run.cost.steps


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_body_is_read_by_its_name(backend: str) -> None:
    sim = advanced(Simulation(LAUNCH, [BACKENDS[backend]]), 0.05, 5)
    chaser = exunet.run(load(LAUNCH, [BACKENDS[backend]])).bodies["chaser"]
    # Stored at 0.05 s; five times 0.01 s is that but for round-off, and the chaser takes up 0.05 m/s.
    assert sim.bodies["chaser"].position == pytest.approx(chaser.position[5], abs=1e-12)
    assert sim.bodies["chaser"].velocity == pytest.approx(chaser.velocity[5], abs=1e-9)
    assert sim.bodies["chaser"].attitude == pytest.approx(chaser.attitude[5], abs=1e-9)


def test_overrides_and_prepared_starts_are_what_files_are() -> None:
    overrides = ["engine.backend=compiled", "time.end = 0.1"]
    case = load(PLANAR, overrides)
    sims = [
        Simulation(PLANAR, overrides),
        Simulation(str(PLANAR), overrides),
        Simulation(case),
        Simulation(prepare_case(case)),
        Simulation(case.scene),
    ]
    for sim in sims:
        sim.advance(0.05)
    assert all(seen(sim) == seen(sims[0]) for sim in sims)


def test_what_is_shown_are_copies() -> None:
    """Writing into what was read changes nothing."""
    sim, other = (Simulation(thrown({}, engine=engine("compiled"))) for _ in range(2))
    advanced(other, 0.02, 2)
    sim.advance(0.01)
    for array in (sim.state.position, sim.state.velocity, sim.net.position, sim.net.velocity):
        array[:] = 1e6
    sim.advance(0.01)
    assert seen(sim) == seen(other)
    assert Energies(1.0, 2.0, 3.0, 4.0).total == 10.0


def test_simulations_do_not_see_each_other() -> None:
    """Two of one start, step by step in turn, share compiled code but no numbers."""
    start = prepare(thrown({"method": "DOPRI5"}, engine=engine("compiled"), effects=DAMPED))
    alone, free, pushed = (Simulation(start) for _ in range(3))
    pushed.set_force(0, [5.0, 0.0, 0.0])
    advanced(alone, 0.15, 5)
    for _ in range(5):
        pushed.advance(0.03)
        free.advance(0.03)
    assert seen(free) == seen(alone)
    assert seen(pushed)[1] != seen(alone)[1]
    assert np.array_equal(start.state.position, prepare(start.scene).state.position)


# Forces from outside


def momentum(sim: Simulation) -> Floats:
    """(3,) of net and bodies [kg m/s]."""
    system, state = sim.start.system, sim.state
    return np.asarray(system.mass @ state.velocity + system.body_mass @ state.bodies.velocity)


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize(
    ("backend", "method", "on"),
    [
        *(("compiled", method, on) for method, on in (("DOPRI5", 3), ("VelocityVerlet", 0))),
        *(("exudyn", method, 3) for method in ("DOPRI5", "RK67", "GeneralizedAlpha")),
        *(("exudyn", method, 0) for method in ("RK44", "VelocityVerlet", "ODE23")),
    ],
)
def test_a_force_changes_momentum_and_energy_by_its_impulse_and_work(
    backend: str, method: str, on: int
) -> None:
    """Impulse = change of momentum, to round-off: all methods integrate a constant force exactly.

    Work = change of the energies less what is counted as dissipated. The net is slack meanwhile, so the
    springs' error is that of the energy: within the guards' smallest bound it shows as such in `total`.
    """
    implicit = METHODS[method].kind == Kind.IMPLICIT  # type: ignore[index]
    # No implicit method has a force on a body: there the bullets have their speed at once.
    launch = ["effects.launch_force=", "launch={speed=3.5, spread_angle=0.2}", "solver.step=1e-3"]
    steps = launch if implicit else []
    sim = Simulation(LAUNCH, [BACKENDS[backend], f"solver.method={method}", *steps])
    sim.advance(0.015)
    force, duration = np.array([3.0, -2.0, 5.0]), 0.03
    before, energy, place = momentum(sim), sim.energy, sim.state.position[on]
    sim.set_force(on, force)
    assert np.array_equal(sim.state.position[on], place)
    sim.advance(duration)
    # Some hundred to 1e4 additions of steps to momenta of up to 4 kg m/s; an implicit step ends at the
    # Newton tolerance (1e-8, relative).
    round_off = 1e-9 if implicit else 1e-12
    assert np.abs(momentum(sim) - before - force * duration).max() < round_off
    work = force @ (sim.state.position[on] - place)
    assert abs(work) > 1e-4
    assert energy.dissipated - sim.energy.dissipated == pytest.approx(work, rel=1e-9)
    # 6.4 J are in the springs. The end of the stroke, in the middle of a step, costs most: at most 1e-4 of
    # that with steps of up to the stable 3.4e-4 s, and some 1e-3 with the implicit ones of 1e-3 s.
    assert sim.energy.total == pytest.approx(energy.total, abs=2e-2 if implicit else 6e-4)

    sim.set_force(on, np.zeros(3))
    before, dissipated = momentum(sim), sim.energy.dissipated
    sim.advance(duration)
    assert np.abs(momentum(sim) - before).max() < round_off
    assert sim.energy.dissipated == dissipated


@pytest.mark.slow_for("compiled")
@every_backend
def test_forces_on_several_points_add_up_and_are_each_replaced(backend: str) -> None:
    sim = Simulation(LAUNCH, [BACKENDS[backend]])
    before = momentum(sim)
    sim.set_force(3, [10.0, 0.0, 0.0])
    sim.set_force(0, [0.0, 1.0, 0.0])
    sim.set_force(sim.net.bullets[1], (0.0, 0.0, 2.0))
    sim.advance(0.01)
    sim.set_force(0, [0.0, -1.0, 0.0])
    sim.advance(0.01)
    assert momentum(sim) - before == pytest.approx([0.2, 0.0, 0.04], abs=1e-12)


def test_the_work_of_a_force_is_counted_in_each_state_of_a_long_call() -> None:
    """The compiled loop returns many states of one call, and the guards look at some of them."""
    sim = Simulation(CASES / "bodies" / "ejection.toml", ["engine.backend=compiled", "solver.retry=0"])
    before, place = sim.energy, sim.state.position[5].copy()
    sim.set_force(5, [0.0, 0.0, 20.0])
    sim.advance(0.054)
    assert 20.0 * (sim.state.position[5] - place)[2] > 0.4 * before.total
    assert sim.energy.total == pytest.approx(before.total, abs=1e-6)  # 4e-8 in the engine


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_force_on_a_node_that_is_held_does_nothing(backend: str) -> None:
    free, pushed = (
        Simulation(CASES / "verification" / "pendulum.toml", [BACKENDS[backend]]) for _ in range(2)
    )
    held = int(np.flatnonzero(~free.start.system.free)[0])
    pushed.set_force(held, [1e3, 1e3, 1e3])
    for sim in (free, pushed):
        sim.advance(0.01)
    assert np.array_equal(pushed.state.position[held], free.start.position[held])
    assert pushed.state.position == pytest.approx(free.state.position, abs=1e-12)
    assert pushed.energy.dissipated == free.energy.dissipated


# What is refused, and changes nothing


WRONG_TIMES = [0.0, -0.01, 0.05, np.nan, np.inf, 10**400, Fraction(-(10**400)), None, "a", [0.2], True]


@pytest.mark.parametrize("wrong", WRONG_TIMES, ids=lambda wrong: repr(wrong)[:9])
def test_a_duration_is_positive_and_a_time_later(wrong: Any) -> None:
    sim = Simulation(pair_of_masses())
    sim.advance_to(0.1)
    if wrong != 0.05:
        with pytest.raises(InputError, match=r"^advance: duration "):
            sim.advance(wrong)
    with pytest.raises(InputError, match=r"^advance_to: time "):
        sim.advance_to(wrong)
    with pytest.raises(InputError, match=r"^advance: duration 1e-20 s is below the round-off"):
        sim.advance(1e-20)
    assert sim.time == 0.1
    sim.advance(0.01)


def test_the_time_reached_differs_from_the_same_time_by_round_off() -> None:
    sim = Simulation(pair_of_masses())
    for _ in range(3):
        sim.advance(0.1)
    sim.advance_to(0.3)
    assert sim.time == 0.1 + 0.1 + 0.1 > 0.3
    with pytest.raises(InputError):
        sim.advance_to(0.3 - 1e-15)  # 20 units of the last place before


@pytest.mark.parametrize(
    ("on", "force"),
    [
        *((on, [1.0, 0.0, 0.0]) for on in (-1, 2, "target", "", 0.5, None)),
        *((0, force) for force in (1.0, [1.0, 2.0], [[1.0, 0.0, 0.0]], [np.nan, 0.0, 0.0], [True, 0.0, 0])),
        *((0, force) for force in ([0.0, np.inf, 0.0], "north", None)),
    ],
)
def test_a_force_is_three_finite_numbers_on_a_node_or_point_mass(on: Any, force: Any) -> None:
    sim = Simulation(pair_of_masses())
    with pytest.raises(InputError, match="set_force: "):
        sim.set_force(on, force)
    sim.advance(0.1)
    assert sim.state.position[0] == pytest.approx([-0.5, 0.0, 0.0], abs=1e-12)  # nothing pulls


def test_a_force_is_on_a_node() -> None:
    sim = Simulation(LAUNCH, ["engine.backend=compiled"])
    for on in (sim.start.net.n_nodes, "chaser"):
        with pytest.raises(InputError, match=rf"nodes: 0 to {sim.start.net.n_nodes - 1}"):
            sim.set_force(on, [1.0, 0.0, 0.0])


@pytest.mark.parametrize("wrong", [[3], None, "solver.method=RK44", 3])
def test_overrides_that_are_no_list_of_texts_are_refused(wrong: Any) -> None:
    with pytest.raises(InputError, match="override"):
        Simulation(PLANAR, wrong)


@every_backend
@pytest.mark.parametrize("duration", [1e-100, 2e-14, 1e-12])
def test_a_run_goes_on_after_an_advance_of_next_to_nothing(backend: str, duration: float) -> None:
    """Far below the round-off of the engine's sums of times, or hundreds of doublings from a sound step.

    The slack net flies freely until 0.1 s: a bullet of 5 m/s is 0.05 m away after 0.01 s.
    """
    sim = Simulation(thrown({"accuracy": 1e-2}, engine=engine(backend)))
    bullet = sim.net.bullets[0]
    begin = sim.net.position[bullet]
    sim.advance(duration)
    assert sim.time == duration
    for time in (0.005, np.nextafter(0.005, 1.0), 0.01):
        sim.advance_to(time)
    assert np.linalg.norm(sim.net.position[bullet] - begin) == pytest.approx(0.05, rel=1e-12)
    # From 1e-6 of the first step it takes 20 doublings to the first one, once after each short advance.
    assert sim.counts.steps < 100


# Failures, retries, Ctrl-C


@every_backend
def test_a_run_that_diverges_stops_out_of_advance(backend: str) -> None:
    """With the message of `run`; a snapshot from before leads there again."""
    scene = thrown(HOPELESS | {"retry": 0}, engine=engine(backend))
    with pytest.raises(RunStopped) as of_run:
        exunet.run(scene)
    sim, times = Simulation(scene), scene.time.stored_times
    sim.advance_to(times[1])
    here, before = sim.snapshot(), seen(sim)
    for _ in range(2):
        with pytest.raises(RunStopped, match="diverged at t = ") as stop:
            through(sim, times[2:])
        assert str(stop.value) == str(of_run.value)
        sim.restore(here)
        assert seen(sim) == before


@every_backend
def test_no_state_is_shown_that_the_guards_have_not_examined(backend: str) -> None:
    """They look at many states at once, so `advance` may go on from one that is wrong; nobody reads it."""
    for name in ("state", "net", "bodies", "energy", "largest_tension"):
        sim = Simulation(thrown(HOPELESS | {"retry": 0}, engine=engine(backend)))
        with pytest.raises(RunStopped, match="diverged at t = "):
            getattr(advanced(sim, 0.2, 40), name)


@pytest.mark.slow_for("exudyn")
@every_backend
def test_what_is_read_on_the_way_changes_nothing(backend: str) -> None:
    """Nor does it when steps fail on the way: the guards find the same first wrong state."""
    scene = thrown(COARSE, engine=engine(backend))
    unread, read = advanced(Simulation(scene), 0.3, 60), Simulation(scene)
    for _ in range(60):
        read.advance(0.005)
        assert read.energy.kinetic > 0.0
    *ours, counts, plan = seen(unread)
    *theirs, fewer, finer = seen(read)
    assert (ours, plan) == (theirs, finer)
    assert plan.step < COARSE["step"]
    assert counts.steps >= fewer.steps  # more of them are repeated, until something is read


@pytest.mark.slow_for("exudyn")
@every_backend
def test_retries_happen_within_advance(backend: str) -> None:
    """As in a run that stores the same times: the same plans, the same states to the last bit."""
    scene = thrown(COARSE, end=0.3, engine=engine(backend))
    run, sim = exunet.run(scene), Simulation(scene)
    assert run.run.retries
    through(sim, run.time[1:])
    assert sim.time == run.time[-1]
    assert sim.plan.step == run.run.plan.step
    assert np.array_equal(sim.net.position, run.position[-1])
    assert np.array_equal(sim.net.velocity, run.velocity[-1])
    assert sim.counts.steps <= run.run.cost.steps  # whose guards look later, and repeat more steps
    assert sim.largest_tension == run.run.largest_tension
    other = Simulation(scene)
    other.restore(sim.snapshot())
    assert other.plan == sim.plan
    for item in (sim, other):
        item.advance(0.05)
    assert seen(other) == seen(sim)


@every_backend
def test_a_retry_acts_with_each_force_when_it_acted(backend: str) -> None:
    """It goes back to 0.1 s, before the force was set: the impulse is that of the force all the same."""
    sim = Simulation(thrown(COARSE, engine=engine(backend)))
    times = 0.02 * np.arange(1, 16)
    for time in times:
        sim.advance_to(time)
        if time == times[8]:  # 0.18 s
            assert sim.plan.step == COARSE["step"]
            sim.set_force(3, [0.0, 0.0, 0.5])
        if time == times[12]:  # 0.26 s
            sim.set_force(3, np.zeros(3))
    momentum = sim.start.system.mass @ sim.state.velocity  # the guards look
    assert sim.plan.step is not None
    assert sim.plan.step < COARSE["step"]
    assert momentum == pytest.approx([0.0, 0.0, 0.5 * 0.08], abs=1e-11)  # 1e4 steps of round-off 1e-15


@every_backend
def test_after_a_failure_time_and_state_belong_together(backend: str) -> None:
    """It is back at the last good state, as if nothing had been tried since."""
    sim = Simulation(UNDAMPED, [BACKENDS[backend], "solver.retry=0"])
    sim.advance_to(0.1)
    good, energy = sim.state, sim.energy.total
    sim.set_force(0, [0.0, 0.0, 1e12])
    with pytest.raises(RunStopped):
        through(sim, [0.3])
    assert sim.time == 0.1
    np.testing.assert_array_equal(sim.state.position, good.position)
    sim.set_force(0, [0.0, 0.0, 0.0])
    sim.advance_to(0.2)
    assert sim.energy.total == pytest.approx(energy, rel=1e-6)  # nothing damps, and the force did no work


@every_backend
def test_after_ctrl_c_time_and_state_belong_together(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted on the way to 0.5 s: at 0.1 s again, and on from there as if it had not been."""
    sim = Simulation(UNDAMPED, [BACKENDS[backend]])
    sim.advance_to(0.1)
    good, energy = sim.state, sim.energy.total
    inner = sim.run.stepper.step

    def interrupted(times: list[float], *_: object) -> None:
        inner([0.5 * (sim.time + times[-1])])
        raise KeyboardInterrupt

    monkeypatch.setattr(sim.run.stepper, "step", interrupted)
    with pytest.raises(RunStopped, match=r"interrupted.*t = 0\.1 s"):
        sim.advance_to(0.5)
    assert sim.time == 0.1
    np.testing.assert_array_equal(sim.state.position, good.position)
    for _ in range(3):
        sim.advance(0.01)
        assert sim.energy.total == pytest.approx(energy, rel=1e-6)
    assert sim.run.observers.safe.state.time == sim.time


def test_a_run_that_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def gives_up(*_: object, **__: object) -> NoReturn:
        raise IntegrationFailed("no steps at all")

    monkeypatch.setattr(simulation, "stepper_of", gives_up)
    with pytest.raises(RunStopped, match=r"^not started: no steps at all") as stopped:
        exunet.run(pair_of_masses())
    assert stopped.value.result is None
