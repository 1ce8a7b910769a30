"""Runs of a study: in this process, in processes of this machine, or on a Dask cluster.

A lane takes portions of runs: short runs go in portions of about a second, at most two portions a worker in
flight. Each process of this machine is one lane, with a pool that is rebuilt if the process dies.
The process was at work on the first of the portions in flight; the others are submitted again. A run that was
in flight at two deaths has failed. Processes import exunet but not the user's script, which needs no guard.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time as clock
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from exunet.base.arguments import shown
from exunet.base.errors import ExunetError, InputError, Interrupted, MissingExtra, RunStopped
from exunet.base.machine import installed_version, memory_left
from exunet.base.version import VERSION
from exunet.results.io import save
from exunet.results.metrics import metrics_of
from exunet.results.observables import Observables
from exunet.results.outcome import Outcome, outcome
from exunet.scene.casefile import Case, case_of, parse_case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, start_of
from exunet.simulation.run import run
from exunet.studies.ensemble import MOVE, perturbed_bodies_of, perturbed_positions
from exunet.studies.inputs import OutputsConfig, as_toml
from exunet.studies.rows import FAILED, INVALID, OK, STOPPED

PORTION = 1.0  # [s] of wall time of a portion of runs
MAX_PORTION = 256  # runs of a portion
IN_FLIGHT = 2  # portions a worker
DEATHS = 2  # of processes, after which a run in flight has failed
MAX_SENT = 20_000_000  # bytes of a mesh file that is sent to a cluster
_HOPELESS = 6  # deaths before any run has ended
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_NOT_FOUND = (
    "build: worker processes cannot import {}: define it in a module beside the script, or use workers=1"
)

Meshes = dict[tuple[int, str], tuple[str, bytes]]  # name and content, by number of the case and key


class Job(NamedTuple):
    """A run to be done: row, number of its case, replicate, number of its design, overrides, inputs."""

    row: int
    run: int
    replicate: int
    design: int
    overrides: tuple[str, ...]
    values: Mapping[str, Any]


class JobData(NamedTuple):
    """Common data of all jobs: cases (text, path) or a function or its pickle, outputs, limit [s]."""

    cases: tuple[tuple[str, str], ...]
    outputs: OutputsConfig
    limit: float | None
    build: Callable[..., Any] | bytes | None = None


@dataclass
class Done:
    """Outcome of a job: columns of its row, words and unit of its metrics, content of its result."""

    job: Job
    status: str = OK
    outcome: str | None = None
    seconds: float = 0.0
    note: str = ""
    metrics: dict[str, float] = field(default_factory=dict)
    about: dict[str, tuple[str, str]] = field(default_factory=dict)
    result: bytes | None = None


class _LimitReached(Exception):
    pass


def built(build: Callable[..., Any], values: Mapping[str, Any], overrides: Sequence[str]) -> Case | Start:
    """Return the case of what a function builds from values, with overrides, or the start.

    Raises CaseError for an invalid scene, and InputError if the function fails or returns anything else.
    """
    call = f"build: {build.__qualname__}({', '.join(f'{name}={value!r}' for name, value in values.items())})"
    try:
        made = build(**values)
    except ExunetError:
        raise
    except Exception as error:
        raise InputError(f"{call} raised {type(error).__name__}: {error}") from error
    if isinstance(made, Start):
        if overrides:
            raise InputError(f"{call} returned a Start, to which set does not apply: return a Scene")
        return made
    if not isinstance(made, Scene):
        raise InputError(f"{call} must return a Scene or a Start (of exunet.prepare), got {shown(made)}")
    return replace(case_of(made, "build", overrides), is_file=False)


def pickled(build: Callable[..., Any]) -> bytes:
    """Return a function as worker processes import it; raise InputError if they cannot."""
    with suppress(AttributeError, pickle.PicklingError):
        if build.__module__ != "__main__":
            return pickle.dumps(build)
    raise InputError(_NOT_FOUND.format(build.__qualname__))


def replicate_of(case: Case | Start, replicate: int) -> Start:
    """Prepare a case, with a start perturbed by 1e-9 m for a replicate from 1 on."""
    start = start_of(case)
    if not replicate:
        return start
    seed, first = start.scene.seed, replicate - 1
    position = perturbed_positions(start, 1, MOVE, seed, first=first)[0]
    bodies = perturbed_bodies_of(start, 1, MOVE, seed, first=first)
    return start.moved(position, bodies=None if bodies is None else bodies[0])


def run_job(work: JobData, job: Job, meshes: Mapping[str, str] | None = None) -> Done:
    """Run a job; an error is a status of the row. meshes: places of mesh files, by key."""
    began = clock.perf_counter()

    def within_limit(*_: Any) -> None:
        if work.limit is not None and clock.perf_counter() - began > work.limit:
            raise _LimitReached

    found, result = Done(job), None
    try:
        if callable(work.build):
            case = built(work.build, job.values, job.overrides)
        else:
            text, path = work.cases[job.design]
            more = [f"{key}={as_toml(place)}" for key, place in (meshes or {}).items()]
            case = parse_case(text, Path(path), (*job.overrides, *more))
        start = replicate_of(case, job.replicate) if job.replicate else case
        result = run(start, None if work.limit is None else within_limit)
        observed = Observables(result)
        measured, verdict = metrics_of(observed), outcome(observed)
        found.outcome = None if verdict is None else verdict.outcome.value
        found.metrics = {key: metric.value for key, metric in measured.items()}
        found.about = {key: (metric.words, metric.unit) for key, metric in measured.items()}
    except Interrupted:
        raise KeyboardInterrupt from None
    except RunStopped as stop:
        found.status, found.note, result = STOPPED, str(stop), stop.result
        found.outcome = Outcome.UNDETERMINED.value
    except _LimitReached:
        found.status, found.note = FAILED, f"time_limit: {work.limit:g} s of wall time are over"
    except ExunetError as error:
        found.status, found.note = INVALID, str(error)
    except Exception:  # noqa: BLE001 - a defect, whose traceback is kept
        found.status, found.note = FAILED, traceback.format_exc()
    found.seconds = clock.perf_counter() - began
    if result is not None and work.outputs.keeps(job.run, found.outcome):
        with tempfile.TemporaryDirectory() as folder:
            save(result, place := Path(folder) / "result.h5")
            found.result = place.read_bytes()
    return found


def run_portion(work: JobData, jobs: Sequence[Job], meshes: Meshes | None = None) -> tuple[list[Done], int]:
    """Run jobs one after the other; returns what they led to, and the peak memory of the process [bytes]."""
    if isinstance(work.build, bytes):
        try:
            work = work._replace(build=pickle.loads(work.build))
        except (AttributeError, ImportError) as error:
            raise InputError(_NOT_FOUND.format(f"the function ({error})")) from None
    places: dict[int, dict[str, str]] = {}
    for (design, key), (name, content) in (meshes or {}).items():
        place = Path(tempfile.gettempdir()) / f"exunet-{os.getpid()}-{design}-{key}-{name}"
        if not place.exists():
            place.write_bytes(content)
        places.setdefault(design, {})[key] = str(place)
    found: list[Done] = []
    known: set[str] = set()
    for job in jobs:
        found.append(done := run_job(work, job, places.get(job.design)))
        done.about = {key: item for key, item in done.about.items() if key not in known}
        known |= set(done.about)
    return found, _peak_memory()


def _peak_memory() -> int:
    try:
        import resource
    except ImportError:  # Windows: unknown
        return 1
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


class Lane:
    """Takes portions of runs, in this process.

    flying   : jobs of the portions that are not done, by their future, in the order of submission
    capacity : number of portions in flight
    workers  : number of processes
    """

    capacity = workers = 1

    def __init__(self) -> None:
        self.flying: dict[Future[Any], list[Job]] = {}

    def submit(self, work: JobData, jobs: list[Job]) -> None:
        """Submit a portion."""
        future: Future[Any] = Future()
        future.set_result(run_portion(work, jobs))
        self.flying[future] = jobs

    def restart(self) -> None:
        """Take portions again after a death."""

    def close(self) -> None:
        """Stop, whatever is in flight."""


class ProcessLane(Lane):
    """A process of this machine."""

    capacity = IN_FLIGHT

    def __init__(self) -> None:
        super().__init__()
        self.restart()

    def submit(self, work: JobData, jobs: list[Job]) -> None:
        try:
            with _plain_process():
                future = self._pool.submit(run_portion, work, jobs)
        except BrokenProcessPool as error:  # the process has died since
            future = Future()
            future.set_exception(error)
        self.flying[future] = jobs

    def restart(self) -> None:
        context = multiprocessing.get_context("spawn")
        reader, self._alive = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(1, context, _begin_worker, (reader,))

    def close(self) -> None:
        self._alive.close()
        self._pool.shutdown(wait=False, cancel_futures=True)


def _begin_worker(alive: Any) -> None:
    """End this process with its parent, or when that closes its end of a pipe; leave Ctrl-C to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with suppress(EOFError, OSError):
            alive.recv()
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _plain_process() -> Iterator[None]:
    """Let a process that starts in the block not import the script, and have libraries with one thread."""
    before, main = dict(os.environ), sys.modules["__main__"]
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name in _THREADS:
            del os.environ[name]
        os.environ.update({name: before[name] for name in _THREADS if name in before})


class ClusterLane(Lane):
    """The workers of a Dask cluster; Dask submits a portion again where its worker dies.

    files : mesh files, by number of the case and key; larger ones than are sent are read from a common disk
    """

    def __init__(self, client: Any, files: Mapping[tuple[int, str], Path]) -> None:
        super().__init__()
        self.workers = validate_cluster(client)
        self.capacity = IN_FLIGHT * self.workers
        self._executor = client.get_executor(pure=False)
        sent = {place: file for place, file in files.items() if file.stat().st_size <= MAX_SENT}
        meshes: Meshes = {place: (file.name, file.read_bytes()) for place, file in sent.items()}
        self._meshes = client.scatter(meshes, broadcast=True, hash=False) if meshes else None

    def submit(self, work: JobData, jobs: list[Job]) -> None:
        self.flying[self._executor.submit(run_portion, work, jobs, self._meshes)] = jobs

    def close(self) -> None:
        self._executor.shutdown(wait=False)


def cluster(scheduler: str) -> Any:
    """Connect to a Dask scheduler by its address or its file; raises InputError, MissingExtra."""
    try:
        from distributed import Client
    except ImportError:
        words = "--scheduler needs dask and distributed: pip install 'exunet[cluster]'"
        raise MissingExtra(words) from None
    own = {"scheduler_file": scheduler} if Path(scheduler).is_file() else {"address": scheduler}
    try:
        return Client(**own, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler: {scheduler}: no Dask scheduler: {error}") from error


def versions() -> dict[str, str]:
    """Return the versions on which the numbers of a run depend."""
    packages = ("numpy", "scipy", "numba", "exudyn")
    return {"exunet": VERSION} | {name: installed_version(name) for name in packages}


def validate_cluster(client: Any) -> int:
    """Return the number of workers; raise InputError for one with several threads, or of other versions."""
    try:
        found = client.run(versions)
    except Exception as error:
        raise InputError(f"scheduler: a worker cannot import exunet: {error}") from error
    if not found:
        raise InputError("scheduler: there are no workers: start some (dask worker --nthreads 1)")
    for address, threads in client.nthreads().items():
        if threads != 1:
            words = f"worker {address} has {threads} threads, and a study requires one: start it with"
            raise InputError(f"scheduler: {words} --nthreads 1")
    for address, theirs in found.items():
        for name, version in versions().items():
            if version != theirs[name]:
                words = f"worker {address} has {name} {theirs[name]}, and this process {version}"
                raise InputError(f"scheduler: {words}: install the same version")
    return len(found)


def lanes_on_this_machine(workers: int, first: Lane, memory: int) -> tuple[list[Lane], str]:
    """Return as many lanes as there is memory for, with the first, and a note if these are fewer."""
    left, note = memory_left(), ""
    if left is not None and memory and (possible := 1 + left // memory) < workers:
        note = f"{possible} of {workers} workers: a run takes {memory / 1e9:.2g} GB of memory"
        workers = possible
    return [first, *(ProcessLane() for _ in range(workers - 1))], note


def run_jobs(
    work: JobData,
    jobs: Iterator[Job],
    first: Lane,
    lanes: Callable[[int], list[Lane]],
    take: Callable[[list[Done]], None],
) -> None:
    """Run jobs, the first of them alone in the first lane; `take` is called with what a portion has led to.

    lanes : function of the peak memory of the first run [bytes]; returns all lanes
    """
    again: deque[list[Job]] = deque()
    deaths: Counter[int] = Counter()
    every, size, ended = [first], 1, 0
    try:
        while True:
            for lane in every:
                while len(lane.flying) < (lane.capacity if ended else 1):
                    if not (portion := again.popleft() if again else list(islice(jobs, size))):
                        break
                    lane.submit(work, portion)
            futures = [future for lane in every for future in lane.flying]
            if not futures:
                return
            wait(futures, return_when=FIRST_COMPLETED)
            for lane in every:
                for found, memory in _ended(lane, again, deaths):
                    take(found)
                    if not ended and memory:
                        every = lanes(memory)
                    ended += len(found) if memory else 0
                    mean = sum(done.seconds for done in found) / len(found)
                    size = max(1, min(MAX_PORTION, int(PORTION / max(mean, 1e-9))))
            if deaths.total() >= _HOPELESS and not ended:
                raise InputError("worker processes end before any run has")
    finally:
        for lane in every:
            lane.close()


def _ended(lane: Lane, again: deque[list[Job]], deaths: Counter[int]) -> Iterator[tuple[list[Done], int]]:
    """Yield what portions of a lane have led to, with the peak memory [bytes], 0 after a death.

    Runs that were in flight at a death are submitted again, each alone, until they have failed.
    """
    broken: BaseException | None = None
    for future in [future for future in lane.flying if future.done()]:
        portion, error = lane.flying.pop(future), future.exception()
        if error is None:
            yield future.result()
        elif isinstance(error, InputError | CancelledError):
            raise InputError(str(error) or "the scheduler is lost: the same command goes on") from error
        elif broken is not None:  # it was behind the portion that was in work
            again.append(portion)
        else:
            broken = error if isinstance(error, BrokenProcessPool) else None
            final = broken is None and len(portion) == 1  # Dask has tried it several times
            deaths.update(job.row for job in portion)
            for job in portion:
                if final or deaths[job.row] >= DEATHS:
                    words = str(error) if final else f"the process died {DEATHS} times during this run"
                    yield [Done(job, FAILED, note=words)], 0
                else:
                    again.append([job])
    if broken is not None:
        again.extend(lane.flying.values())
        lane.flying.clear()
        lane.close()
        lane.restart()
