"""A simulation that is stepped from outside: advance, look, push, go back, start again."""

from __future__ import annotations

import copy
import hashlib
import json
import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from scenes import pair_of_masses, thrown

import exunet
from exunet.base.errors import InputError, RunStopped
from exunet.base.files import write_arrays
from exunet.integrators.protocol import IntegrationFailed
from exunet.methods.method import METHODS, Kind
from exunet.scene.casefile import load
from exunet.simulation import rollback
from exunet.simulation.preparation import prepare, prepare_case
from exunet.simulation.recorder import Recorder
from exunet.simulation.simulation import Energies, Simulation
from exunet.simulation.snapshot import FORMAT, KIND, Snapshot

CASES = Path(__file__).parents[1] / "cases"
PLANAR = CASES / "planar_deployment.toml"
LAUNCH = CASES / "effects" / "launch_force.toml"
BACKENDS: dict[str, dict[str, str]] = {
    "exudyn": {"backend": "exudyn"},
    "compiled": {"backend": "compiled"},
}
form_of_net = pytest.mark.parametrize("form", BACKENDS)
DAMPED = {"rayleigh_damping": {"alpha": 0.2, "beta": 1e-6}}
COARSE = {"method": "RK44", "step": 2.3e-4}  # below the stable step 2.6e-4 s; snaps spoil it
HOPELESS = {"method": "RK44", "step": 4e-3, "force": True}  # 15 stable steps


def seen(sim: Simulation) -> tuple[Any, ...]:
    """All that a simulation shows, the arrays as bytes: equal if nothing differs by a bit."""
    state, net = sim.state, sim.net
    arrays = (*state.arrays().items(), *vars(net).items())
    bytes_of = {name: np.asarray(values).tobytes() for name, values in arrays}
    return sim.time, bytes_of, sim.energy, sim.largest_tension, sim.counts, sim.plan


def through(sim: Simulation, times: Iterable[float]) -> None:
    """To each of the times, where the energy is read, so that the guards have looked."""
    for time in times:
        sim.advance_to(time)
        assert np.isfinite(sim.energy.kinetic)


def of_launch(form: str, *overrides: str) -> Simulation:
    """The net that springs throw out of a chaser of 50 kg."""
    ((key, value),) = BACKENDS[form].items()
    return Simulation(LAUNCH, [f"engine.{key}={value}", *overrides])


@pytest.mark.ci
@pytest.mark.slow
def test_the_example_of_the_issue(capsys: pytest.CaptureFixture[str]) -> None:
    sim = exunet.Simulation(PLANAR)
    while sim.time < 1.0:
        sim.advance(0.01)
        print(sim.time, sim.energy.kinetic, sim.net.position[sim.net.bullets])  # noqa: T201 - the example
    assert capsys.readouterr().out.count("[[") == 100  # 1.0 s in hundredths
    assert sim.time == pytest.approx(1.0, abs=1e-12)
    here = sim.snapshot()
    sim.advance(0.5)
    once = seen(sim)
    sim.restore(here)
    assert sim.time == here.time
    sim.advance(0.5)
    assert seen(sim) == once
    assert once[3]["time_s"] > 1.0  # threads snapped in between


@pytest.mark.slow_for("RK44-exudyn")
@form_of_net
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
def test_the_same_again_as_often_as_one_likes(form: str, method: str) -> None:
    """Through the snaps at 0.16 s and 0.24 s; a snapshot is not touched by what follows it."""
    sim = Simulation(thrown({"method": method}, engine=BACKENDS[form], effects=DAMPED))
    sim.advance(0.15)
    before, here = seen(sim), sim.snapshot()
    sim.advance(0.02)
    sim.advance(0.09)
    after = seen(sim)
    for _ in range(2):
        sim.restore(here)
        assert seen(sim) == before
        sim.advance(0.02)
        sim.advance(0.09)
        assert seen(sim) == after
    assert after[3]["time_s"] > 0.15


@form_of_net
def test_read_outs_are_what_a_run_stores(form: str) -> None:
    """States and books to the last bit; energies are sums over one state or many, so to their round-off."""
    scene = thrown({"method": "DOPRI5"}, end=0.25, engine=BACKENDS[form], effects=DAMPED)
    run, sim = exunet.run(scene), Simulation(scene)
    total = run.kinetic[0] + run.elastic[0]
    for k, time in enumerate(run.time):
        if k:
            sim.advance_to(time)
        net, energy = sim.net, sim.energy
        assert sim.time == time
        assert np.array_equal(net.position, run.position[k])
        assert np.array_equal(net.velocity, run.velocity[k])
        assert np.array_equal(net.strain, run.strain[k])
        assert np.array_equal(net.tension, run.tension[k])
        assert energy.dissipated == run.dissipated[k]
        ours = (energy.kinetic, energy.elastic, energy.potential)
        assert ours == pytest.approx((run.kinetic[k], run.elastic[k], run.potential[k]), abs=1e-14 * total)
    assert np.array_equal(sim.net.bullets, run.net.bullet_nodes)
    assert sim.largest_tension == run.provenance["largest_tension"]
    assert sim.counts.steps == run.provenance["steps"]


@pytest.mark.slow_for("compiled")
@form_of_net
def test_a_body_is_read_by_its_name(form: str) -> None:
    sim = of_launch(form)
    chaser = exunet.run(load(LAUNCH, [f"engine.{k}={v}" for k, v in BACKENDS[form].items()])).bodies["chaser"]
    for _ in range(5):
        sim.advance(0.01)
    # Stored at 0.05 s; five times 0.01 s is that but for round-off, and the chaser takes up 0.05 m/s.
    assert sim.bodies["chaser"].position == pytest.approx(chaser.position[5], abs=1e-12)
    assert sim.bodies["chaser"].velocity == pytest.approx(chaser.velocity[5], abs=1e-9)
    assert sim.bodies["chaser"].attitude is None
    assert sim.bodies["chaser"].rotation is None


def _cases_of_forces() -> list[Any]:
    methods = {"compiled": ["DOPRI5", "RK44", "VelocityVerlet"]}
    methods["exudyn"] = [*methods["compiled"], "ODE23", "RK67", "GeneralizedAlpha"]
    return [
        pytest.param(form, method, on, id=f"{form}-{method}-{on}")
        for form, names in methods.items()
        for method in names
        for on in (3, "chaser")
    ]


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize(("form", "method", "on"), _cases_of_forces())
def test_a_force_changes_momentum_and_energy_by_its_impulse_and_work(
    form: str, method: str, on: int | str
) -> None:
    """Impulse = change of momentum, to round-off: all methods integrate a constant force exactly.

    Work = change of the energies less what is booked as dissipated. The net is slack meanwhile, so the
    springs' error is that of the energy: within the guards' least bound it shows as such in `total`.
    """
    implicit = METHODS[method].kind == Kind.IMPLICIT  # type: ignore[index]
    sim = of_launch(form, f"solver.method={method}", *(["solver.step=1e-3"] if implicit else []))
    sim.advance(0.015)
    force, duration = np.array([3.0, -2.0, 5.0]), 0.03
    number = sim.start.system.blocks.body[on] if isinstance(on, str) else on
    mass = sim.start.system.mass

    def momentum() -> np.ndarray:
        return mass @ sim.state.velocity

    before, energy, place = momentum(), sim.energy, sim.state.position[number]
    sim.set_force(on, force)
    assert np.array_equal(sim.state.position[number], place)
    sim.advance(duration)
    impulse = force * duration
    # Some hundred to 1e4 additions of steps to momenta of up to 4 kg m/s; an implicit step ends at the
    # Newton tolerance (1e-8, relative).
    assert np.abs(momentum() - before - impulse).max() < (1e-9 if implicit else 1e-12)
    work = force @ (sim.state.position[number] - place)
    assert abs(work) > 1e-4
    assert energy.dissipated - sim.energy.dissipated == pytest.approx(work, rel=1e-9)
    # 6.4 J are in the springs. The end of the stroke, in the middle of a step, costs most: at most 1e-4 of
    # that with steps of up to the stable 3.4e-4 s, and some 1e-3 with the implicit ones of 1e-3 s.
    assert sim.energy.total == pytest.approx(energy.total, abs=2e-2 if implicit else 6e-4)

    sim.set_force(on, np.zeros(3))
    before, booked = momentum(), sim.energy.dissipated
    sim.advance(duration)
    assert np.abs(momentum() - before).max() < (1e-9 if implicit else 1e-12)
    assert sim.energy.dissipated == booked


@pytest.mark.slow_for("compiled")
@form_of_net
def test_forces_on_several_points_add_up_and_are_each_replaced(form: str) -> None:
    sim = of_launch(form)
    mass = sim.start.system.mass
    before = mass @ sim.state.velocity
    sim.set_force("chaser", [10.0, 0.0, 0.0])
    sim.set_force(0, [0.0, 1.0, 0.0])
    sim.set_force(sim.net.bullets[1], (0.0, 0.0, 2.0))
    sim.advance(0.01)
    sim.set_force(0, [0.0, -1.0, 0.0])
    sim.advance(0.01)
    change = mass @ sim.state.velocity - before
    assert change == pytest.approx([0.2, 0.0, 0.04], abs=1e-12)


def test_the_work_of_a_force_is_booked_in_each_state_of_a_long_call() -> None:
    """The compiled loop hands over many states of one call, and the guards look at some of them."""
    sim = Simulation(CASES / "bodies" / "ejection.toml", ["engine.backend=compiled", "solver.retry=0"])
    before, place = sim.energy, sim.state.position[5].copy()
    sim.set_force(5, [0.0, 0.0, 20.0])
    sim.advance(0.054)
    work = 20.0 * (sim.state.position[5] - place)[2]
    assert work > 0.4 * before.total
    assert sim.energy.total == pytest.approx(before.total, abs=1e-6)  # 4e-8 in the engine


@pytest.mark.slow_for("compiled")
@form_of_net
def test_a_force_on_a_node_that_is_held_does_nothing(form: str) -> None:
    case = CASES / "verification" / "pendulum.toml"
    engine = [f"engine.{key}={value}" for key, value in BACKENDS[form].items()]
    free, pushed = Simulation(case, engine), Simulation(case, engine)
    held = int(np.flatnonzero(~free.start.system.free)[0])
    pushed.set_force(held, [1e3, 1e3, 1e3])
    for sim in (free, pushed):
        sim.advance(0.01)
    assert np.array_equal(pushed.state.position[held], free.start.position[held])
    assert pushed.state.position == pytest.approx(free.state.position, abs=1e-12)
    assert pushed.energy.dissipated == free.energy.dissipated


@form_of_net
def test_reset_goes_back_and_builds_nothing(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Simulation(thrown({"method": "DOPRI5"}, engine=BACKENDS[form], effects=DAMPED))
    start = seen(sim)
    sim.advance(0.15)
    end = seen(sim)

    def never(*_arguments: Any, **_more: Any) -> NoReturn:
        pytest.fail("something was made again")

    for name in (
        "exunet.simulation.rollback.integrator",
        "exunet.simulation.preparation.prepare",
        "exunet.integrators.exudyn.stepper.build",
        "exunet.kernels.kernel.module_source",
        "exunet.kernels.kernel.compiled_module",
        "exunet.kernels.kernel.compiled_module",
        "exunet.kernels.kernel.interpreted_module",
    ):
        monkeypatch.setattr(name, never)
    for _ in range(2):
        sim.reset()
        assert seen(sim) == start
        sim.advance(0.15)
        assert seen(sim) == end


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@form_of_net
def test_reset_forgets_forces_and_retries(form: str) -> None:
    sim = Simulation(thrown(COARSE, engine=BACKENDS[form]))
    start, plan = seen(sim), sim.plan
    sim.set_force(0, [0.1, 0.0, 0.0])
    sim.advance(0.5)
    assert sim.energy.kinetic > 0.0  # the guards look
    assert sim.plan != plan  # it was retried
    sim.reset()
    assert seen(sim) == start
    again = Simulation(thrown(COARSE, engine=BACKENDS[form]))
    for item in (sim, again):
        item.advance(0.15)
    assert seen(sim) == seen(again)


def test_simulations_do_not_see_each_other() -> None:
    """Two of one start, step by step in turn, share compiled code but no numbers."""
    start = prepare(thrown({"method": "DOPRI5"}, engine=BACKENDS["compiled"], effects=DAMPED))
    alone, free, pushed = (Simulation(start) for _ in range(3))
    pushed.set_force(0, [5.0, 0.0, 0.0])
    for _ in range(5):
        alone.advance(0.03)
    for _ in range(5):
        pushed.advance(0.03)
        free.advance(0.03)
    assert seen(free) == seen(alone)
    assert seen(pushed)[1] != seen(alone)[1]
    assert np.array_equal(start.state.position, prepare(start.scene).state.position)


@pytest.mark.parametrize("duration", [0.0, -0.01, np.nan, np.inf, -np.inf])
def test_only_a_positive_finite_duration_is_accepted(duration: float) -> None:
    sim = Simulation(pair_of_masses())
    with pytest.raises(InputError, match=r"^advance: duration must be positive and finite"):
        sim.advance(duration)
    assert sim.time == 0.0
    sim.advance(0.01)


@pytest.mark.parametrize("until", [0.1, 0.05, -1.0, np.nan, np.inf])
def test_only_a_later_time_can_be_gone_to(until: float) -> None:
    sim = Simulation(pair_of_masses())
    sim.advance_to(0.1)
    with pytest.raises(InputError, match=r"^advance_to: time must be greater than the present 0\.1 s, got"):
        sim.advance_to(until)
    assert sim.time == 0.1


def test_a_time_too_short_to_be_told_apart_is_refused() -> None:
    sim = Simulation(pair_of_masses())
    sim.advance(0.1)
    with pytest.raises(InputError, match=r"^advance: duration 1e-20 s is below the round-off"):
        sim.advance(1e-20)


@form_of_net
@pytest.mark.parametrize("duration", [1e-100, 1e-25, 2e-14, 1e-13, 1e-12])
def test_a_run_goes_on_after_an_advance_of_next_to_nothing(form: str, duration: float) -> None:
    """Far below the round-off of the engine's sums of times, or hundreds of doublings away from a sound step.

    The slack net flies freely until 0.1 s: a bullet of 5 m/s is 0.05 m away after 0.01 s.
    """
    sim = Simulation(thrown({}, engine=BACKENDS[form]))
    bullet = sim.net.bullets[0]
    begin = sim.net.position[bullet]
    sim.advance(duration)
    assert sim.time == duration
    sim.advance_to(0.005)
    sim.advance_to(np.nextafter(0.005, 1.0))
    sim.advance_to(0.01)
    assert np.linalg.norm(sim.net.position[bullet] - begin) == pytest.approx(0.05, rel=1e-12)
    # From 1e-6 of the first step it takes 20 doublings to the first one, once after each short advance.
    assert sim.counts.steps < 100


@pytest.mark.parametrize("on", [-1, 2, "target", "", 0.5, None])
def test_a_force_on_nothing_is_refused(on: Any) -> None:
    sim = Simulation(pair_of_masses())
    with pytest.raises(
        InputError, match=r"set_force: unknown node .* \(nodes are 0 to 1, point masses: none\)"
    ):
        sim.set_force(on, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "force",
    [
        1.0,
        [1.0, 2.0],
        [[1.0, 0.0, 0.0]],
        [np.nan, 0.0, 0.0],
        [0.0, np.inf, 0.0],
        [True, 0.0, 0],
        "north",
        None,
    ],
)
def test_a_force_is_three_finite_numbers(force: Any) -> None:
    sim = Simulation(pair_of_masses())
    with pytest.raises(InputError, match="set_force: force must be three finite numbers, got"):
        sim.set_force(0, force)
    sim.advance(0.1)
    assert sim.state.position[0] == pytest.approx([-0.5, 0.0, 0.0], abs=1e-12)  # nothing pulls


def others() -> dict[str, tuple[Simulation, str]]:
    """Simulations that the snapshot of the undamped pair does not belong to, and the words for it."""
    scene = pair_of_masses()
    start = prepare(scene)
    other_form = pair_of_masses(engine=BACKENDS["compiled"])
    return {
        "case": (Simulation(pair_of_masses(effects=DAMPED)), "another case"),
        "form": (Simulation(other_form), "another engine or form of the net"),
        "start": (Simulation(start.moved(start.position, start.velocity + 1e-9)), "another start"),
    }


@pytest.mark.parametrize("which", ["case", "form", "start"])
def test_the_snapshot_of_something_else_is_refused(which: str) -> None:
    here = Simulation(pair_of_masses()).snapshot()
    sim, words = others()[which]
    before = seen(sim)
    with pytest.raises(InputError, match=f"the snapshot of t = 0 s is of {words}.*: run the case from its"):
        sim.restore(here)
    assert seen(sim) == before


@pytest.mark.parametrize("of", ["exunet", "numpy"])
def test_the_snapshot_of_another_version_is_refused(of: str) -> None:
    sim = Simulation(pair_of_masses())
    here = sim.snapshot()
    with pytest.raises(InputError, match=r"is of another version of .* \(0\.0\.1, not "):
        sim.restore(replace(here, of=here.of | {of: "0.0.1"}))


@pytest.mark.slow
def test_a_snapshot_goes_on_beyond_the_end_of_its_case() -> None:
    """The end and the stored times of the case are not what a state depends on; the plan comes with it."""
    short, longer = (Simulation(thrown({}, end=end, engine=BACKENDS["compiled"])) for end in (0.2, 0.4))
    short.advance(0.15)
    longer.restore(short.snapshot())
    for sim in (short, longer):
        sim.advance(0.1)
    assert seen(longer) == seen(short)


def test_a_snapshot_in_a_file_is_the_same(tmp_path: Path) -> None:
    sim = Simulation(thrown({}, engine=BACKENDS["compiled"], effects=DAMPED))
    sim.advance(0.15)
    here = sim.snapshot()
    here.save(tmp_path / "here.exu")
    back = Snapshot.load(tmp_path / "here.exu")
    assert back.time == here.time
    assert (back.of, back.header) == (here.of, json.loads(json.dumps(here.header)))
    assert bits(back.arrays) == bits(here.arrays)
    again = Simulation(thrown({}, engine=BACKENDS["compiled"], effects=DAMPED))
    again.restore(back)
    for item in (sim, again):
        item.advance(0.1)
    assert seen(again) == seen(sim)


def test_a_snapshot_is_pickled_and_copied() -> None:
    sim = Simulation(thrown({}, engine=BACKENDS["compiled"]))
    sim.advance(0.05)
    here = sim.snapshot()
    sim.advance(0.1)
    for back in (pickle.loads(pickle.dumps(here)), copy.deepcopy(here)):
        again = Simulation(thrown({}, engine=BACKENDS["compiled"]))
        again.restore(back)
        again.advance(0.1)
        assert seen(again) == seen(sim)


def bits(arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
    return {name: hashlib.sha256(np.ascontiguousarray(a).tobytes()).hexdigest() for name, a in arrays.items()}


def test_a_damaged_snapshot_is_refused(tmp_path: Path) -> None:
    """Cut short, a bit turned anywhere, of another kind or form, or no file at all."""
    path = tmp_path / "here.exu"
    Simulation(pair_of_masses()).snapshot().save(path)
    whole = path.read_bytes()
    random = np.random.default_rng(7)
    for length in [0, 10, *random.integers(11, len(whole), 20).tolist()]:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"here\.exu"):
            Snapshot.load(path)
    for at in random.integers(0, len(whole), 40).tolist():
        wrong = bytearray(whole)
        wrong[at] ^= 1 << int(random.integers(8))
        path.write_bytes(wrong)
        with pytest.raises(InputError, match=r"here\.exu"):
            Snapshot.load(path)
    for kind, form in (("exunet run", FORMAT), (KIND, FORMAT + 1)):
        write_arrays(path, kind, form, {"of": {}}, {})
        with pytest.raises(InputError, match=r"here\.exu"):
            Snapshot.load(path)
    path.unlink()
    with pytest.raises(InputError, match=r"here\.exu"):
        Snapshot.load(path)
    with pytest.raises(InputError, match="cannot be written"):
        Simulation(pair_of_masses()).snapshot().save(tmp_path / "absent" / "here.exu")


def test_the_snapshot_of_a_plain_simulation_is_not_one_of_a_run_that_stores() -> None:
    start = prepare(pair_of_masses())
    recorder = Recorder(start, {})
    storing = Simulation(start, recorder=recorder)
    with pytest.raises(InputError, match="stored states"):
        storing.restore(Simulation(start).snapshot())
    plain = Simulation(start)
    storing.advance(0.05)
    plain.restore(storing.snapshot())  # the other way there is nothing that is missing
    assert plain.time == 0.05


@form_of_net
def test_methods_that_cannot_go_back_say_so(form: str) -> None:
    if form == "compiled":
        pytest.skip("has explicit methods only")
    solver = {"method": "GeneralizedAlpha", "step": 1e-3}
    sim = Simulation(pair_of_masses(solver=solver, engine=BACKENDS[form]))
    assert not sim.can_restart
    sim.advance(0.05)
    with pytest.raises(InputError, match=r"^snapshot: GeneralizedAlpha of Exudyn cannot .*DOPRI5, RK44"):
        sim.snapshot()
    with pytest.raises(InputError, match=r"^reset: GeneralizedAlpha of Exudyn cannot .* new Simulation"):
        sim.reset()
    sim.advance(0.05)
    assert sim.time == pytest.approx(0.1)


@form_of_net
def test_a_run_that_diverges_stops_out_of_advance(form: str) -> None:
    """With the words of `run`; a snapshot from before leads there again."""
    scene = thrown(HOPELESS | {"retry": 0}, engine=BACKENDS[form])
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


@form_of_net
def test_no_state_is_shown_that_the_guards_have_not_seen(form: str) -> None:
    """They look at many states at once, so `advance` may go on from one that is wrong; nobody reads it."""
    read_outs = ("state", "net", "bodies", "energy", "largest_tension")
    for name in read_outs:
        sim = Simulation(thrown(HOPELESS | {"retry": 0}, engine=BACKENDS[form]))
        with pytest.raises(RunStopped, match="diverged at t = "):
            getattr(advanced(sim, 0.2, 40), name)


def advanced(sim: Simulation, duration: float, number: int) -> Simulation:
    """Through so many equal times, without a look."""
    for _ in range(number):
        sim.advance(duration / number)
    return sim


@pytest.mark.slow_for("exudyn")
@form_of_net
def test_what_is_read_on_the_way_changes_nothing(form: str) -> None:
    """Nor does it when steps fail on the way: the guards find the same first wrong state."""
    scene = thrown(COARSE, engine=BACKENDS[form])
    unread, read = advanced(Simulation(scene), 0.3, 60), Simulation(scene)
    for _ in range(60):
        advanced(read, 0.005, 1)
        assert read.energy.kinetic > 0.0
    *ours, counts, plan = seen(unread)
    *theirs, fewer, finer = seen(read)
    assert (ours, plan) == (theirs, finer)
    assert plan.step < COARSE["step"]  # type: ignore[operator]
    assert counts.steps >= fewer.steps  # more of them in vain, until somebody looked


def test_a_stretch_beyond_the_law_stops_out_of_advance() -> None:
    """Not the steps' doing, so there is no retry: masses that part at 12 m/s on a cable of EA = 10 N."""
    scene = pair_of_masses(initial={"packing": 1.0, "node_velocities": [[-6, 0, 0], [6, 0, 0]]})
    sim = Simulation(scene)
    plan = sim.plan
    with pytest.raises(RunStopped, match="element is longer than 2 times"):
        through(sim, [0.5])
    assert sim.plan == plan


@pytest.mark.slow_for("exudyn")
@form_of_net
def test_retries_happen_within_advance(form: str) -> None:
    """As in a run that stores the same times: the same plans, the same states to the last bit."""
    scene = thrown(COARSE, end=0.3, engine=BACKENDS[form])
    run, sim = exunet.run(scene), Simulation(scene)
    assert run.provenance["retries"]
    through(sim, run.time[1:])
    assert sim.time == run.time[-1]
    assert sim.plan.step == run.provenance["step"]
    assert np.array_equal(sim.net.position, run.position[-1])
    assert np.array_equal(sim.net.velocity, run.velocity[-1])
    assert sim.counts.steps <= run.provenance["steps"]  # whose guards look later, after more steps in vain
    assert sim.largest_tension == run.provenance["largest_tension"]

    here = sim.snapshot()
    other = Simulation(scene)
    other.restore(here)
    assert other.plan == sim.plan
    for item in (sim, other):
        item.advance(0.05)
    assert seen(other) == seen(sim)


@form_of_net
def test_a_retry_acts_with_each_force_when_it_acted(form: str) -> None:
    """It goes back to 0.1 s, before the force was set: the impulse is that of the force all the same."""
    sim = Simulation(thrown(COARSE, engine=BACKENDS[form]))
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
    assert sim.plan.step < 2.3e-4
    assert momentum == pytest.approx([0.0, 0.0, 0.5 * 0.08], abs=1e-11)  # 1e4 steps of round-off 1e-15


def test_overrides_and_prepared_starts_are_what_files_are() -> None:
    overrides = ['engine.backend = "compiled"', "time.end = 0.1"]
    case = load(PLANAR, overrides)
    sims: Sequence[Simulation] = [
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
    sim, other = (Simulation(thrown({}, engine=BACKENDS["compiled"])) for _ in range(2))
    for item in (sim, other):
        item.advance(0.01)
    for array in (sim.state.position, sim.state.velocity, sim.net.position, sim.net.velocity):
        array[:] = 1e6
    for entry in (sim, other):
        entry.advance(0.01)
    assert seen(sim) == seen(other)
    assert Energies(1.0, 2.0, 3.0, 4.0).total == 10.0


def test_a_snapshot_does_not_change_when_the_simulation_goes_on():
    """Breaks that come later are not in it, nor told twice after going back."""
    sim = exunet.Simulation(CASES / "effects" / "breaking.toml", ["engine.backend=compiled"])
    first = sim.snapshot()
    end = sim.start.scene.time.end
    sim.advance_to(end)
    broken = len(sim.monitor.events)
    assert broken > 0
    assert first.header["events"] == []
    sim.restore(first)
    assert sim.monitor.events == []
    sim.advance_to(end)
    assert len(sim.monitor.events) == broken


@pytest.mark.parametrize("form", ["engine.backend=compiled", "engine.backend=exudyn"])
def test_after_a_failure_time_and_state_belong_together(form):
    """It is back at the last good state: the same as if nothing had been tried since."""
    sim = exunet.Simulation(CASES / "planar_undamped.toml", [form, "solver.retry=0"])
    sim.advance_to(0.1)
    good, energy = sim.state, sim.energy.total
    sim.set_force(0, [0.0, 0.0, 1e12])

    def until_it_is_looked_at():
        sim.advance_to(0.3)
        return sim.state

    with pytest.raises(exunet.RunStopped):
        until_it_is_looked_at()
    assert sim.time == 0.1
    np.testing.assert_array_equal(sim.state.position, good.position)
    sim.set_force(0, [0.0, 0.0, 0.0])
    sim.advance_to(0.2)
    assert sim.energy.total == pytest.approx(energy, rel=1e-6)  # nothing damps, and the force did no work


@pytest.mark.parametrize("form", ["engine.backend=compiled", "engine.backend=exudyn"])
def test_after_ctrl_c_time_and_state_belong_together(form, monkeypatch):
    """Interrupted on the way to 0.5 s: at 0.1 s again, and on from there as if it had not been."""
    sim = exunet.Simulation(CASES / "planar_undamped.toml", [form])
    sim.advance_to(0.1)
    good, energy = sim.state, sim.energy.total
    inner = sim._integrator.advance

    def interrupted(until):
        inner(0.5 * (sim.time + until))
        raise KeyboardInterrupt

    monkeypatch.setattr(sim._integrator, "advance", interrupted)
    with pytest.raises(exunet.RunStopped, match=r"interrupted.*t = 0\.1 s"):
        sim.advance_to(0.5)
    assert sim.time == 0.1
    np.testing.assert_array_equal(sim.state.position, good.position)
    for _ in range(3):
        sim.advance(0.01)
        assert sim.energy.total == pytest.approx(energy, rel=1e-6)
    assert sim.monitor.safe.time == sim.time


@pytest.mark.parametrize("given", [None, "a", [0.1], np.array([0.1]), True, float("nan"), 0.0])
def test_a_duration_is_a_positive_number(given):
    sim = exunet.Simulation(CASES / "planar_undamped.toml", ["engine.backend=compiled"])
    with pytest.raises(exunet.InputError, match="positive and finite"):
        sim.advance(given)
    with pytest.raises(exunet.InputError, match="greater than the present"):
        sim.advance_to(given)
    sim.advance(0.01)


@pytest.mark.parametrize("lost", ["integrator:x", "acting", "monitor:gained", "plan"])
def test_an_incomplete_snapshot_is_refused_whole(lost):
    sim = exunet.Simulation(CASES / "planar_undamped.toml", ["engine.backend=compiled"])
    sim.advance(0.01)
    whole = sim.snapshot()
    header = {key: value for key, value in whole.header.items() if key != lost}
    arrays = {key: value for key, value in whole.arrays.items() if key != lost}
    with pytest.raises(exunet.InputError, match=lost):
        sim.restore(exunet.Snapshot(whole.of, header, arrays))
    short = dict(whole.arrays) | {"acting": np.zeros(1)}
    with pytest.raises(exunet.InputError, match="acting"):
        sim.restore(exunet.Snapshot(whole.of, whole.header, short))
    with pytest.raises(exunet.InputError, match="needs what"):
        sim.restore(None)
    assert sim.snapshot().time == whole.time


@pytest.mark.parametrize("huge", [10**400, Fraction(10**400, 1), -(10**400)])
def test_numbers_beyond_floats_are_refused_in_words(huge: Any) -> None:
    sim = Simulation(prepare(pair_of_masses()))
    with pytest.raises(InputError, match=r"^advance: duration must be positive and finite"):
        sim.advance(huge)
    with pytest.raises(InputError, match=r"^advance_to: time must be greater than"):
        sim.advance_to(huge)


@pytest.mark.parametrize("wrong", [None, 3, [PLANAR]])
def test_what_is_no_case_and_no_file_is_refused_in_words(wrong: Any, tmp_path: Path) -> None:
    sim = Simulation(prepare(pair_of_masses()))
    for what, call in (
        ("Simulation", Simulation),
        ("load", exunet.load),
        ("load_result", exunet.load_result),
        ("Snapshot.load", Snapshot.load),
        ("Snapshot.save", sim.snapshot().save),
    ):
        with pytest.raises(InputError, match=rf"^{what}: needs the name of a file, got"):
            call(wrong)


@pytest.mark.parametrize("wrong", [[3], None, "solver.method=RK44", 3])
def test_overrides_that_are_no_list_of_texts_are_refused_in_words(wrong: Any) -> None:
    with pytest.raises(InputError, match=r"^load: .*override"):
        Simulation(PLANAR, wrong)


def test_a_number_is_a_node_and_a_point_mass_has_a_name() -> None:
    sim = of_launch("compiled")
    chaser = sim.start.system.blocks.body["chaser"]
    with pytest.raises(InputError, match=rf"nodes are 0 to {chaser - 1}, point masses: chaser"):
        sim.set_force(chaser, [1.0, 0.0, 0.0])
    sim.set_force("chaser", [1.0, 0.0, 0.0])


def test_a_run_that_does_not_even_start_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def gives_up(*_: object) -> NoReturn:
        raise IntegrationFailed("no steps at all")

    monkeypatch.setattr(rollback, "integrator", gives_up)
    with pytest.raises(RunStopped, match=r"^not started: no steps at all") as stopped:
        exunet.run(pair_of_masses())
    assert stopped.value.result is None
