"""Stepped simulations for tests: what they show, cut in two, and runs that are killed in new processes."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from exunet.base.errors import RunStopped
from exunet.results import io
from exunet.results.run_folder import has_result, has_unfinished
from exunet.results.store import STORE_FILE, FileStore
from exunet.scene.casefile import load
from exunet.simulation import recorder
from exunet.simulation.integrate import Integration
from exunet.simulation.run import resume, run_into
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

CASES = Path(__file__).parents[1] / "cases"
Action = Sequence[Any]  # ["to", time], ["force", node or name, three numbers], or ["look"]
# The net of scenes.thrown as overrides of the paper's, which is damped (alpha, beta): snaps at 0.16 s and
# 0.24 s.
SMALL = ("net.size=2.0", "net.strings.length=1.0", "initial.packing=0.5", "launch.radial_speed=5.0")
# With steps that are too long for the snaps: the energy is off by a tenth of the bound from 0.16 s on, by the
# whole bound at 0.23 s, and a retry goes back to 0.1 s.
COARSE_CASE = (*SMALL, "effects.rayleigh_damping.beta=0.0", "solver={method='RK44', step=2.3e-4}")

DAMPED = {"rayleigh_damping": {"alpha": 0.2, "beta": 1e-6}}
COARSE: dict[str, Any] = {"method": "RK44", "step": 2.3e-4}  # 0.9 of the stable step; snaps spoil it
HOPELESS = {"method": "RK44", "step": 4e-3, "force": True}  # 15 stable steps


def engine(backend: str) -> dict[str, str]:
    """The table of a backend."""
    return {"backend": backend}


def seen(sim: Simulation) -> tuple[Any, ...]:
    """All that a simulation shows, the arrays as bytes: equal if nothing differs by a bit."""
    state, net = sim.state, sim.net
    arrays = (*state.arrays().items(), *vars(net).items())
    bytes_of = {name: np.asarray(values).tobytes() for name, values in arrays}
    return sim.time, bytes_of, sim.energy, sim.largest_tension, sim.counts, sim.plan


def in_new_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function of a module in tests/ returns, in a process that has computed nothing before."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


# Simulations that are cut in two


@dataclass(frozen=True)
class Job:
    """A case, what is done with it, and after how many actions it is cut in two."""

    case: str
    overrides: Sequence[str]
    actions: Sequence[Action]
    cut: int

    def simulation(self) -> Simulation:
        """Return the simulation at its start."""
        return Simulation(CASES / f"{self.case}.toml", self.overrides)


def act(sim: Simulation, actions: Sequence[Action]) -> str:
    """Carry out the actions; returns the message with which the simulation stopped, if it did."""
    try:
        for what, *how in actions:
            if what == "to":
                sim.advance_to(*how)
            elif what == "force":
                sim.set_force(*how)
            else:
                assert what == "look"
                assert np.isfinite(sim.energy.total)
    except RunStopped as stop:
        return str(stop)
    return ""


def end_of(sim: Simulation, message: str) -> dict[str, Any]:
    """All that the simulation depends on, and all that it shows: digests of arrays, numbers as written."""
    here = sim.snapshot()  # before anything is read: with what the guards have not examined
    message = message or act(sim, [("look",)])
    found: dict[str, Any] = {"message": message, "header": here.header}
    found |= {f"snapshot {name}": digest(values) for name, values in here.arrays.items()}
    if not message:
        found["energy"] = list(sim.energy)
        found |= {name: digest(values) for name, values in sim.state.arrays().items()}
        found["tension"] = digest(sim.net.tension)
        found["largest_tension"] = vars(sim.largest_tension)
    found["counts"] = asdict(sim.counts)
    return dict(json.loads(json.dumps(found)))


def digest(values: Any) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def whole(job: Job) -> dict[str, Any]:
    """Return the end of the simulation that is not cut."""
    sim = job.simulation()
    return end_of(sim, act(sim, job.actions))


def first_half(job: Job, path: Path) -> Simulation:
    """Return the simulation at the cut, with its snapshot in a file."""
    sim = job.simulation()
    act(sim, job.actions[: job.cut])
    sim.snapshot().save(path)
    return sim


def second_halves(jobs: Mapping[str, Job], paths: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """Return the ends of the simulations that go on from their files."""
    ends = {}
    for name, job in jobs.items():
        sim = job.simulation()
        sim.restore(Snapshot.load(paths[name]))
        ends[name] = end_of(sim, act(sim, job.actions[job.cut :]))
    return ends


# Runs that kill themselves at a call, and are resumed

# Elsewhere nothing changes that survives the process.
POINTS: dict[str, tuple[Any, str]] = {
    "attempt": (Integration, "_advance"),
    "retry": (Integration, "_retry"),
    "append": (FileStore, "append"),
    "drop": (FileStore, "drop_after"),
    "checkpoint": (FileStore, "keep_checkpoint"),
    "rename": (os, "replace"),
    "discard": (FileStore, "discard"),
    "write": (io._Sink, "write"),
}
Kill = tuple[str, int, bool, str]  # point, number of the call, after it or before it, what follows


class KilledScene(NamedTuple):
    """A case with overrides, the time between checkpoints [s], and the kills."""

    case: str
    overrides: tuple[str, ...]
    every: float
    kills: tuple[Kill, ...]


_END = "time={end=0.26, output_step=0.005}"
KILLED_SCENES = {
    "snaps": KilledScene("planar_deployment", (*SMALL, _END, "engine.backend=compiled"), 0.04, (
        ("rename", 1, False, "run again"), ("attempt", 4, False, "resumed from its start"),
        ("checkpoint", 2, True, "resumed"), ("append", 2, True, "resumed"),
        ("append", 1, False, "resumed from its start"),
        ("write", 5, False, "resumed"), ("rename", 2, True, "resumed"), ("discard", 1, True, "was whole"),
    )),
    "retries": KilledScene("planar_deployment", (*COARSE_CASE, _END, "engine.backend=exudyn"), 0.04, (
        ("retry", 1, True, "resumed"), ("drop", 1, False, "resumed"), ("drop", 1, True, "resumed"),
    )),
    "breaks": KilledScene("effects/breaking", ("engine.backend=exudyn",), 0.002, (
        ("checkpoint", 2, True, "resumed"),
    )),
    "launched": KilledScene("effects/launch_force", ("engine.backend=compiled",), 0.05, (
        ("append", 2, True, "resumed"),
    )),
}  # fmt: skip


def kill_at(point: str, number: int, after: bool) -> None:
    """Let this process end at a call."""
    owner, name = POINTS[point]
    function, calls = getattr(owner, name), 0

    def call(*arguments: Any, **more: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == number and not after:
            os.kill(os.getpid(), signal.SIGKILL)
        try:
            return function(*arguments, **more)
        finally:
            if calls == number:
                os.kill(os.getpid(), signal.SIGKILL)

    setattr(owner, name, call)


def in_a_child(task: Callable[[], Any], *kill: Any) -> bool:
    """Run a task in a forked process; False if it was killed, AssertionError if it failed."""
    child = os.fork()
    if child == 0:
        try:
            if kill:
                kill_at(*kill)
            with suppress(RunStopped):  # which leaves a result like any other
                task()
        except BaseException:  # noqa: BLE001 - reported by the parent
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return False
    assert os.waitstatus_to_exitcode(status) == 0, "a run failed"
    return True


def killed_and_resumed(scene: str, folder: Path) -> list[str]:
    """Run a scene whole, and once for each kill; return what followed each kill."""
    name, overrides, every, kills = KILLED_SCENES[scene]
    recorder._BATCH = 4  # several batches a run
    case = load(CASES / f"{name}.toml", overrides)
    Simulation(case).advance(1e-9)  # compiles, so that the children need not

    def begin(into: Path) -> Any:
        into.mkdir(exist_ok=True)
        return run_into(into, case, checkpoint_every=every)

    followed = []
    assert in_a_child(lambda: begin(folder / "whole"))
    for number, (*kill, _) in enumerate(kills):
        into = folder / f"kill{number}"
        if in_a_child(lambda: begin(into), *kill):  # noqa: B023 - called at once
            followed.append("finished")
        elif has_unfinished(into):
            store = FileStore(into / STORE_FILE, read_only=True)
            followed.append("resumed from its start" if store.checkpoint is None else "resumed")
            store.close()
            assert in_a_child(lambda: resume(into))  # noqa: B023
        elif has_result(into):
            followed.append("was whole")
        else:
            followed.append("run again")
            assert in_a_child(lambda: begin(into))  # noqa: B023
    return followed
