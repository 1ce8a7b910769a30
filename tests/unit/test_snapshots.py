"""Snapshots: the same again, bit for bit, also in a new process; what they belong to; damaged ones."""

from __future__ import annotations

import copy
import json
import pickle
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import h5py
import numpy as np
import pytest
from restarts import (
    COARSE,
    COARSE_CASE,
    DAMPED,
    SMALL,
    Action,
    Job,
    digest,
    end_of,
    engine,
    first_half,
    in_new_process,
    second_halves,
    seen,
    whole,
)
from scenes import BACKENDS, CASES, every_backend, pair_of_masses, thrown

import exunet
from exunet.base.errors import InputError, RunStopped
from exunet.base.files import write_arrays
from exunet.methods.method import COMPILED_METHODS, METHODS, Kind, Method
from exunet.results.run_folder import RESULT_FILE
from exunet.scene.casefile import load, parse_case
from exunet.simulation.preparation import prepare
from exunet.simulation.recorder import Recorder
from exunet.simulation.run import run_into
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import FORMAT, KIND, Snapshot

BREAKING, LAUNCH = "effects/breaking", "effects/launch_force"

# Each kind of term, of discrete state and of constraint that the shipped cases have.
WITH_TERMS = [
    *("bodies/launch", "bodies/ejection", "bodies/release", "bodies/tow", "capture/free_sphere"),
    *("capture/fixed_sphere", "effects/launch_force", "effects/breaking", "effects/bending"),
    *("missions/closed_box", "missions/drift_controlled", "verification/closing/perimeter"),
    *(
        "verification/self_contact/together",
        "verification/bodies/snap_of_bodies",
        "verification/closing/loop",
    ),
]


@pytest.mark.parametrize("name", WITH_TERMS)
def test_prepared_cases_can_be_pickled_and_copied(name: str) -> None:
    """The copies have the same initial state."""
    start = prepare(load(CASES / f"{name}.toml").scene)
    before = start.state.arrays()
    for other in (pickle.loads(pickle.dumps(start)), copy.deepcopy(start)):
        after = other.state.arrays()
        assert before.keys() == after.keys()
        for key, values in before.items():
            np.testing.assert_array_equal(after[key], values)


# The same again, in one process


@pytest.mark.slow_for("RK44-exudyn", "exudyn-RK44")
@every_backend
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
def test_the_same_again_as_often_as_one_likes(backend: str, method: str) -> None:
    """Through the snaps at 0.16 s and 0.24 s; a snapshot is not touched by what follows it."""
    sim = Simulation(thrown({"method": method}, engine=engine(backend), effects=DAMPED))
    sim.advance(0.15)
    before, here = seen(sim), sim.snapshot()
    sim.advance(0.02)
    sim.advance(0.09)
    after = seen(sim)
    for back in (here, copy.deepcopy(here), pickle.loads(pickle.dumps(here))):
        sim.restore(back)
        assert seen(sim) == before
        sim.advance(0.02)
        sim.advance(0.09)
        assert seen(sim) == after
    assert after[3].time > 0.15


def stored_rows(recorder: Recorder) -> dict[str, bytes]:
    """The stored states, as bytes: equal if nothing differs by a bit."""
    recorder.flush()
    rows = recorder.rows
    return {column.path: rows.read(column.path, 0, len(rows)).tobytes() for column in rows.columns}


@every_backend
def test_copies_of_a_simulation_that_stores_store_the_same(backend: str) -> None:
    """With drag, whose magnitude the guards compute by a compiled module."""
    start = prepare(load(CASES / "planar_deployment.toml", BACKENDS[backend].split()).scene)
    sim = Simulation(start, recorder=Recorder(start))
    sim.advance(0.01)
    stored = []
    for each in (copy.deepcopy(sim), pickle.loads(pickle.dumps(sim)), sim):
        each.advance(0.01)
        each.settle()
        assert each._recorder is not None
        stored.append(stored_rows(each._recorder))
    assert stored[0] == stored[1] == stored[2]


def test_an_event_at_the_time_of_a_snapshot_changes_the_stored_state() -> None:
    """As without the snapshot; a net is ejected at 0 s, and self-contact stores a series."""
    changes = ('script=[{name="throw", at=0.0, do="eject"}]', "engine.backend=compiled")
    contact = "effects.self_contact={stiffness=50.0, damping=0.0}"
    start = prepare(load(CASES / "bodies" / "ejection.toml", (*changes, contact)).scene)
    recorders = []
    for taken in (0, 1, 2):
        recorders.append(recorder := Recorder(start))
        sim = Simulation(start, recorder=recorder)
        snapshots = [sim.snapshot() for _ in range(taken)]
        sim.advance(0.002)
        sim.settle()
        if taken == 2:  # the event happens again
            sim.restore(snapshots[0])
            sim.advance(0.002)
        sim.settle()
    without, *others = (stored_rows(recorder) for recorder in recorders)
    assert len(recorders[0]) == 2
    assert others == [without, without]


@every_backend
def test_reset_goes_back_and_builds_nothing(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Simulation(thrown({"method": "DOPRI5"}, engine=engine(backend), effects=DAMPED))
    start = seen(sim)
    sim.advance(0.15)
    end = seen(sim)

    def never(*_arguments: Any, **_more: Any) -> NoReturn:
        pytest.fail("something was made again")

    for name in (
        "exunet.simulation.simulation.stepper_of",
        "exunet.simulation.preparation.prepare",
        "exunet.integrators.exudyn.stepper.build",
        "exunet.kernels.kernel.module_source",
        "exunet.kernels.kernel.compiled_module",
        "exunet.kernels.kernel.interpreted_module",
    ):
        monkeypatch.setattr(name, never)
    for _ in range(2):
        sim.reset()
        assert seen(sim) == start
        sim.advance(0.15)
        assert seen(sim) == end


@every_backend
@pytest.mark.parametrize("name", ["capture/free_sphere", "verification/self_contact/together"])
def test_reset_from_states_that_nobody_has_read(name: str, backend: str) -> None:
    """Discrete states of contacts wait with them; at the start none does."""
    sim = Simulation(CASES / f"{name}.toml", [f"engine.backend={backend}"])
    sim.advance(0.002)
    sim.reset()
    sim.advance(0.002)
    other = Simulation(CASES / f"{name}.toml", [f"engine.backend={backend}"])
    other.advance(0.002)
    assert seen(sim) == seen(other)


def test_an_engine_that_fails_after_a_restore_names_the_restored_state() -> None:
    """Steps collapse at once under an endless force; the last valid state is the restored one."""
    sim = Simulation(CASES / "planar_deployment.toml", ["engine.backend=compiled", "solver.retry=0"])
    sim.advance(0.1)
    sim.settle()
    here = sim.snapshot()
    sim.advance(0.1)
    sim.settle()
    sim.restore(here)
    sim.set_force(0, [1e300, 0.0, 0.0])
    with pytest.raises(RunStopped, match=r"after t = 0\.1 s"):
        sim.advance(0.01)


@pytest.mark.slow
@every_backend
def test_reset_forgets_forces_and_retries(backend: str) -> None:
    sim = Simulation(thrown(COARSE, engine=engine(backend)))
    start, plan = seen(sim), sim.plan
    sim.set_force(0, [0.1, 0.0, 0.0])
    sim.advance(0.5)
    assert sim.energy.kinetic > 0.0  # the guards look
    assert sim.plan != plan  # it was retried
    sim.reset()
    assert seen(sim) == start
    again = Simulation(thrown(COARSE, engine=engine(backend)))
    for item in (sim, again):
        item.advance(0.15)
    assert seen(sim) == seen(again)


def test_a_snapshot_does_not_change_when_the_simulation_goes_on() -> None:
    """Breaks that come later are not in it, nor reported twice after going back."""
    sim = Simulation(CASES / f"{BREAKING}.toml", ["engine.backend=compiled"])
    first, end = sim.snapshot(), sim.start.scene.time.end
    sim.advance_to(end)
    broken = len(sim.log.events)
    assert broken > 0
    sim.restore(first)
    assert sim.log.events == []
    sim.advance_to(end)
    assert len(sim.log.events) == broken


@pytest.mark.slow
def test_a_snapshot_goes_on_beyond_the_end_of_its_case() -> None:
    """The end and the stored times of the case are not what a state depends on; the plan comes with it."""
    short, longer = (Simulation(thrown({}, end=end, engine=engine("compiled"))) for end in (0.2, 0.4))
    short.advance(0.15)
    longer.restore(short.snapshot())
    for sim in (short, longer):
        sim.advance(0.1)
    assert seen(longer) == seen(short)


# Half + snapshot in a file + new process + half is bitwise the whole


def to(*times: float) -> list[Action]:
    return [("to", float(time)) for time in times]


def job(case: str, backend: str, overrides: tuple[str, ...], actions: list[Action], cut: int) -> Job:
    return Job(case, [*overrides, BACKENDS[backend]], actions, cut)


def by_method(backend: str) -> Iterator[tuple[str, Job]]:
    """Rayleigh damping through snaps, material damping, breaking, a launch by force."""
    for name in ("DOPRI5", "RK44", "VelocityVerlet"):
        method = (f"solver.method={name}",)
        # 0.166 s is in the middle of the first snap
        damped = to(0.1, 0.166, 0.2, 0.27)
        yield f"{name}, damped", job("planar_deployment", backend, SMALL + method, damped, 2)
        # taut at 0.004 s, slack from 0.007 s on
        viscous = to(0.004, 0.008, 0.012, 0.016)
        yield f"{name}, viscous", job("effects/material_damping", backend, method, viscous, 1)
        yield f"{name}, launched", job(LAUNCH, backend, method, to(0.02, 0.05, 0.1), 1)
        if not METHODS[Method(name)].remembers_acceleration:  # which a break makes wrong: it is refused
            breaks = to(0.002, 0.004, 0.006, 0.01)
            yield f"{name}, breaking", job(BREAKING, backend, method, breaks, 2)


def at_odd_moments(backend: str) -> Iterator[tuple[str, Job]]:
    """Around a break, around retries, between two looks of the guards, under a force from outside."""
    (broken,) = exunet.run(load(CASES / f"{BREAKING}.toml", [BACKENDS[backend]])).run.breaks
    time = float(broken.time_s)
    around = to(0.9 * time, np.nextafter(time, 0.0), time, np.nextafter(time, 1.0), 2.0 * time)
    for cut, words in enumerate(("well before", "just before", "at", "just after"), 1):
        yield f"{words} a break", job(BREAKING, backend, (), around, cut)
    stretches = to(*(0.01 * np.arange(1, 31)))
    yield "before steps fail", job("planar_deployment", backend, COARSE_CASE, stretches, 20)
    looked = [*stretches[:25], ("look",), *stretches[25:]]
    yield "on finer steps", job("planar_deployment", backend, COARSE_CASE, looked, 27)
    force = ("force", 3, [0.1, 0.0, 0.5])
    forced = [*stretches[:18], force, *stretches[18:26], ("force", 3, [0.0] * 3), *stretches[26:]]
    yield "retried from before a force", job("planar_deployment", backend, COARSE_CASE, forced, 21)
    many = to(*(1e-3 * np.arange(1, 41)))
    yield "not examined", job("planar_deployment", backend, SMALL, many, 20)
    pushed = [*to(0.02), ("force", 3, [5.0, 0.0, 0.0]), *to(0.03), ("force", 0, [0.0, 2.0, 0.0])]
    pushed += [*to(0.04, 0.05), ("force", 3, [0.0] * 3), *to(0.06)]
    for cut, words in ((2, "just set"), (5, "acts"), (7, "is over for one")):
        yield f"a force {words}", job(LAUNCH, backend, (), pushed, cut)
    hopeless = (*SMALL, "solver={method='RK44', step=4e-3, force=true, retry=1}")
    yield "towards a stop", job("planar_deployment", backend, hopeless, stretches, 4)


def same(jobs: dict[str, Job], folder: Path) -> dict[str, dict[str, Any]]:
    """Compare whole simulations, which are returned, with second halves in another process."""
    paths = {name: folder / f"{number}.exu" for number, name in enumerate(jobs)}
    for name, item in jobs.items():
        first_half(item, paths[name])
    second = in_new_process(second_halves, jobs, paths)
    first = {name: whole(item) for name, item in jobs.items()}
    differ = {
        name: [key for key, value in end.items() if second[name].get(key) != value]
        for name, end in first.items()
    }
    assert {name: keys for name, keys in differ.items() if keys} == {}
    return first


@pytest.mark.slow
def test_halves_are_bitwise_the_whole(tmp_path: Path) -> None:
    same({f"{form}, {name}": item for form in BACKENDS for name, item in by_method(form)}, tmp_path)


@pytest.mark.ci
@pytest.mark.slow
def test_halves_cut_at_odd_moments_are_bitwise_the_whole(tmp_path: Path) -> None:
    ends = same(
        {f"{form}, {name}": item for form in BACKENDS for name, item in at_odd_moments(form)}, tmp_path
    )
    for form in BACKENDS:
        assert ends[f"{form}, retried from before a force"]["header"]["plan"]["step"] < 2.3e-4  # it was
        assert "diverged at t = " in ends[f"{form}, towards a stop"]["message"]


@pytest.mark.slow
@every_backend
def test_all_methods_that_can_restart_exactly(tmp_path: Path, backend: str) -> None:
    """Of the engine, all explicit ones; at three cuts each, of which the second is in a snap."""
    methods = [name for name in METHODS if METHODS[name].kind != Kind.IMPLICIT]
    jobs = {}
    for name in COMPILED_METHODS if backend == "compiled" else methods:
        # 1e-5 s is stable with each, 1e-6 s the weak ones: their fastest mode grows by less than 1 % a step
        step = "" if METHODS[name].kind == Kind.ADAPTIVE else f", step={1e-6 if METHODS[name].weak else 1e-5}"
        solver = (f"solver={{method='{name}'{step}}}",)
        times = to(*((0.02 if METHODS[name].weak else 0.2) * np.array([0.3, 0.83, 0.9, 1.0])))
        for cut in (1, 2, 3):
            jobs[f"{name}, cut {cut}"] = job("planar_deployment", backend, SMALL + solver, times, cut)
    same(jobs, tmp_path)


@pytest.mark.slow
@every_backend
def test_every_effect_restarts_exactly(tmp_path: Path, backend: str) -> None:
    """At three moments drawn at random of each shipped effect; the case's own end, or 0.5 s of it."""
    jobs = {}
    for path in sorted((CASES / "effects").glob("*.toml")):
        end = min(0.5, load(path).scene.time.end)
        random = np.random.default_rng(sum(path.stem.encode()))
        times = to(*(end * np.sort(random.random(6))), end)
        for cut in (1, 3, 6):
            jobs[f"{path.stem}, cut {cut}"] = job(f"effects/{path.stem}", backend, (), times, cut)
    same(jobs, tmp_path)


def test_what_is_compared_shows_a_bit() -> None:
    """A force of 1e-12 N, or an interval in two halves, is seen in what is compared."""

    def state(actions: list[Action]) -> dict[str, object]:
        end = whole(job("planar_deployment", "compiled", SMALL, actions, 1))
        return {name: end[name] for name in ("position", "velocity")}

    plain = state(to(0.1, 0.17))
    assert state(to(0.1, 0.17)) == plain
    assert state([*to(0.1), ("force", 0, [1e-12, 0.0, 0.0]), *to(0.17)]) != plain
    assert state(to(0.1, 0.13, 0.17)) != plain


def test_a_file_gives_the_snapshot_back_and_changes_nothing(tmp_path: Path) -> None:
    item = job("planar_deployment", "compiled", SMALL, to(0.1, 0.166, 0.2), 2)
    sim = first_half(item, tmp_path / "half.exu")
    here, back = sim.snapshot(), Snapshot.load(tmp_path / "half.exu")
    assert (back.time, back.of, back.header) == (here.time, here.of, json.loads(json.dumps(here.header)))
    assert {name: digest(values) for name, values in back.arrays.items()} == {
        name: digest(values) for name, values in here.arrays.items()
    }
    again = item.simulation()
    again.restore(back)
    for each in (sim, again):
        each.advance_to(0.2)
    assert end_of(sim, "") == end_of(again, "") == whole(item)


# What is refused


def others() -> dict[str, Simulation]:
    """Simulations that the snapshot of the undamped pair does not belong to."""
    start = prepare(pair_of_masses())
    return {
        "another case": Simulation(pair_of_masses(effects=DAMPED)),
        "another backend": Simulation(pair_of_masses(engine=engine("compiled"))),
        "another start": Simulation(start.moved(start.position, start.velocity + 1e-9)),
    }


@pytest.mark.parametrize("which", ["another case", "another backend", "another start"])
def test_the_snapshot_of_something_else_is_refused(which: str) -> None:
    here, sim = Simulation(pair_of_masses()).snapshot(), others()[which]
    before = seen(sim)
    with pytest.raises(InputError, match=which):
        sim.restore(here)
    assert seen(sim) == before


@pytest.mark.parametrize("of", ["exunet", "numpy"])
def test_the_snapshot_of_another_version_is_refused(of: str) -> None:
    sim = Simulation(pair_of_masses())
    here = sim.snapshot()
    with pytest.raises(InputError, match=r"another version of .* \(0\.0\.1, not "):
        sim.restore(replace(here, of=here.of | {of: "0.0.1"}))


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    """Cut short, a bit turned anywhere, of another kind or form, or no file at all."""
    path = tmp_path / "here.exu"
    Simulation(pair_of_masses()).snapshot().save(path)
    sound = path.read_bytes()
    random = np.random.default_rng(7)
    damaged = [sound[:length] for length in [0, 10, *random.integers(11, len(sound), 20).tolist()]]
    for at in random.integers(0, len(sound), 40).tolist():
        wrong = bytearray(sound)
        wrong[at] ^= 1 << int(random.integers(8))
        damaged.append(bytes(wrong))
    for content in damaged:
        path.write_bytes(content)
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


@pytest.mark.parametrize("lost", ["stepper:x", "acting", "balance:gained", "plan"])
def test_an_incomplete_snapshot_is_refused_whole(lost: str) -> None:
    sim = Simulation(CASES / "planar_undamped.toml", ["engine.backend=compiled"])
    sim.advance(0.01)
    here = sim.snapshot()
    header = {key: value for key, value in here.header.items() if key != lost}
    arrays = {key: value for key, value in here.arrays.items() if key != lost}
    with pytest.raises(InputError, match=lost):
        sim.restore(Snapshot(here.of, header, arrays))
    short = dict(here.arrays) | {"acting": np.zeros(1)}
    with pytest.raises(InputError, match="acting"):
        sim.restore(Snapshot(here.of, here.header, short))
    assert sim.snapshot().time == here.time


def test_the_snapshot_of_a_plain_simulation_is_not_that_of_a_run_that_stores() -> None:
    start = prepare(pair_of_masses())
    storing, plain = Simulation(start, recorder=Recorder(start, {})), Simulation(start)
    with pytest.raises(InputError, match="stored states"):
        storing.restore(plain.snapshot())
    storing.advance(0.05)
    plain.restore(storing.snapshot())  # the other way nothing is missing
    assert plain.time == 0.05


@pytest.mark.parametrize("method", [name for name in METHODS if METHODS[name].kind == Kind.IMPLICIT])
def test_implicit_methods_cannot_go_back(method: Method) -> None:
    sim = Simulation(pair_of_masses(solver={"method": method, "step": 1e-3}))
    assert not sim.can_restart
    sim.advance(0.05)
    for call in (sim.snapshot, sim.reset):
        with pytest.raises(InputError, match=f"^{call.__name__}: {method} of Exudyn cannot "):
            call()
    sim.advance(0.05)
    assert sim.time == pytest.approx(0.1)


# Cases that name files: what is in the files counts, not how or from where they are named

CABLE = """
format = 1
title = "a cable"
time = { end = 0.1, output_step = 0.05 }
initial.packing = 1.0
[net]
topology = "explicit"
nodes = [[-0.5, 5.0, 0.0], [0.5, 5.0, 0.0]]
elements = [[0, 1]]
node_masses = [0.5, 0.5]
cable = { area = 1e-4, density = 10.0, youngs_modulus = 1e5 }
"""
BALL = """
[bodies.ball]
shape = "mesh"
file = "ball.stl"
unit = "m"
mass = 1.0
inertia = [0.1, 0.1, 0.1]
centre_of_mass = [0.0, 0.0, 0.0]
angular_velocity = [0.1, 1.0, 0.2]
"""


def ball(folder: Path, radius: float) -> None:
    """ball.stl, 80 triangles; mass and inertia of the body are given: the radius changes the shape alone."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(subdivisions=1, radius=radius).export(folder / "ball.stl")


def test_a_mesh_may_have_another_name_and_place_but_not_another_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    ball(own, 0.3)
    (own / "case.toml").write_text(CABLE + BALL)
    shutil.copytree(own, tmp_path / "other")
    monkeypatch.chdir(own)
    sim = Simulation("case.toml")
    sim.advance(0.01)
    sim.snapshot().save("here.exu")
    sim.advance(0.01)
    for name, overrides in (
        (own / "case.toml", []),
        ("../other/case.toml", []),
        ("case.toml", ["bodies.ball.file='../other/ball.stl'"]),
    ):
        again = Simulation(name, overrides)
        again.restore(Snapshot.load("here.exu"))
        again.advance(0.01)
        assert np.array_equal(again.bodies["ball"].attitude, sim.bodies["ball"].attitude)
    ball(own, 0.4)
    with pytest.raises(InputError, match="files"):
        Simulation("case.toml").restore(Snapshot.load("here.exu"))


def test_the_result_that_a_case_starts_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under any name the same; the same state out of another file is another content."""
    folder = tmp_path / "first"
    folder.mkdir()
    run_into(folder, parse_case(CABLE, tmp_path / "first.toml"))
    monkeypatch.chdir(folder)

    def simulation(path: Path, named: str) -> Simulation:
        return Simulation(parse_case(CABLE, path, ["initial.packing=", f"initial.restart={named!r}"]))

    here = simulation(Path("../second.toml"), "first").snapshot()
    simulation(tmp_path / "second.toml", "first/result.h5@0.1").restore(here)
    shutil.copytree(folder, tmp_path / "moved")
    simulation(tmp_path / "moved" / "second.toml", "result.h5@end").restore(here)
    with h5py.File(folder / RESULT_FILE, "r+") as file:
        file.attrs["remark"] = "changed"
    with pytest.raises(InputError, match="files"):
        simulation(tmp_path / "second.toml", "first").restore(here)
