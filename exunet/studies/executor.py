"""Runs of a study: in this process, in processes of this machine, or on a Dask cluster.

A lane takes portions of runs: short runs go in portions of about a second, at most two portions a worker in
flight. Each process of this machine is a lane of its own, with a pool that is rebuilt if the process dies.
The process was at work on the first of the portions in flight; the others are submitted again. A run that was
in flight at two deaths has failed. Processes import exunet but not the user's script, which needs no guard.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
import threading
import time as clock
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from exunet.base.errors import ExunetError, InputError, Interrupted, MissingExtra, RunStopped
from exunet.base.machine import installed_version, memory_left
from exunet.base.version import VERSION
from exunet.results.io import save
from exunet.results.metrics import metrics_of
from exunet.results.observables import Observables
from exunet.results.outcome import Outcome, outcome
from exunet.scene.casefile import Case, parse_case
from exunet.simulation.preparation import Start, prepare_case
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


@dataclass(frozen=True)
class Job:
    """A run to be done.

    row       : number of its row
    design    : number of the case among `Work.cases`
    run       : number of its case; replicate : of the perturbed start, 0: the case's own
    overrides : of the case
    """

    row: int
    run: int
    replicate: int
    design: int
    overrides: tuple[str, ...]


@dataclass(frozen=True)
class Work:
    """What all jobs have in common.

    cases   : text and path of the case of each design
    outputs : which results are kept
    limit   : wall time of a run [s]; None: any
    """

    cases: tuple[tuple[str, str], ...]
    outputs: OutputsConfig
    limit: float | None


@dataclass
class Done:
    """What a job has led to; see `exunet.studies.rows.Row`."""

    job: Job
    status: str
    outcome: str | None = None
    seconds: float = 0.0
    note: str = ""
    metrics: dict[str, float] = field(default_factory=dict)
    about: dict[str, tuple[str, str]] = field(default_factory=dict)
    result: bytes | None = None


class _LimitReached(Exception):
    pass


def replicate_of(case: Case, replicate: int) -> Start:
    """Prepare a case, with a start perturbed by 1e-9 m for a replicate from 1 on."""
    start = prepare_case(case)
    if not replicate:
        return start
    seed, first = start.scene.seed, replicate - 1
    position = perturbed_positions(start, 1, MOVE, seed, first=first)[0]
    bodies = perturbed_bodies_of(start, 1, MOVE, seed, first=first)
    return start.moved(position, bodies=None if bodies is None else bodies[0])


def run_job(work: Work, job: Job, files: Mapping[str, str] | None = None) -> Done:
    """Run a job; an error is a status of the row.

    files : further overrides, of the places of mesh files
    """
    began = clock.perf_counter()

    def within_limit(*_: Any) -> None:
        if work.limit is not None and clock.perf_counter() - began > work.limit:
            raise _LimitReached

    found, result = Done(job, OK), None
    try:
        text, path = work.cases[job.design]
        more = [f"{key}={as_toml(place)}" for key, place in (files or {}).items()]
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


def run_portion(
    work: Work, jobs: Sequence[Job], files: Mapping[tuple[int, str], tuple[str, bytes]] | None = None
) -> tuple[list[Done], int]:
    """Run jobs one after the other; returns what they led to, and the peak memory of the process [bytes].

    files : name and content of mesh files, by number of the design and key of the case
    """
    places: dict[int, dict[str, str]] = {}
    for (design, key), (name, content) in (files or {}).items():
        folder = Path(tempfile.gettempdir()) / f"exunet-{os.getpid()}"
        folder.mkdir(exist_ok=True)
        place = folder / f"{design}-{key}-{name}"
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
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


# Lanes


class Lane:
    """Takes portions of runs, in this process.

    flying : jobs of the portions that are not done, by their future, in the order of submission
    """

    def __init__(self) -> None:
        self.flying: dict[Future[Any], list[Job]] = {}

    @property
    def capacity(self) -> int:
        """Number of portions in flight."""
        return 1

    def submit(self, work: Work, jobs: list[Job]) -> None:
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

    def __init__(self) -> None:
        super().__init__()
        self.restart()

    @property
    def capacity(self) -> int:
        """Number of portions in flight."""
        return IN_FLIGHT

    def submit(self, work: Work, jobs: list[Job]) -> None:
        """Submit a portion."""
        try:
            with _plain_process():
                future = self._pool.submit(run_portion, work, jobs)
        except BrokenProcessPool as error:  # the process has died since
            future = Future()
            future.set_exception(error)
        self.flying[future] = jobs

    def restart(self) -> None:
        """Start another process."""
        context = multiprocessing.get_context("spawn")
        reader, self._alive = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(1, context, _begin_worker, (reader,))

    def close(self) -> None:
        """End the process at once."""
        self._alive.close()
        self._pool.shutdown(wait=False, cancel_futures=True)


def _begin_worker(alive: Any) -> None:
    """End this process with its parent, or when that closes its end of a pipe; leave Ctrl-C to the parent."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with suppress(EOFError, OSError):
            alive.recv()
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _plain_process() -> Iterator[None]:
    """Let a process that starts in the block not import the script, and have libraries with one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    main = sys.modules["__main__"]
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


class ClusterLane(Lane):
    """The workers of a Dask cluster; Dask submits a portion again where its worker dies."""

    def __init__(self, client: Any, work: Work) -> None:
        super().__init__()
        self._client = client
        validate_cluster(client)
        self._executor = client.get_executor(pure=False)
        meshes = meshes_of(work)
        self._files = client.scatter(meshes, broadcast=True, hash=False) if meshes else None

    @property
    def capacity(self) -> int:
        """Number of portions in flight."""
        return max(1, IN_FLIGHT * len(self._client.nthreads()))

    def submit(self, work: Work, jobs: list[Job]) -> None:
        """Submit a portion."""
        self.flying[self._executor.submit(run_portion, work, jobs, self._files)] = jobs

    def close(self) -> None:
        """Cancel what is in flight."""
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


def validate_cluster(client: Any) -> None:
    """Raise InputError for a worker with several threads, or of other versions."""
    try:
        found = client.run(versions)
    except Exception as error:
        raise InputError(f"scheduler: a worker cannot import exunet: {error}") from error
    if not found:
        raise InputError("scheduler: there are no workers: start some (dask worker --nthreads 1)")
    for address, threads in client.nthreads().items():
        if threads != 1:
            raise InputError(
                f"scheduler: worker {address} has {threads} threads, and a study requires one: start it with "
                "--nthreads 1"
            )
    own = versions()
    for address, theirs in found.items():
        for name, version in theirs.items():
            if version != own[name]:
                words = f"worker {address} has {name} {version}, and this process {own[name]}"
                raise InputError(f"scheduler: {words}: install the same version")


def mesh_files(case: Case) -> dict[str, Path]:
    """Return the mesh files of a case, by key."""
    bodies = case.scene.bodies.items()
    return {f"bodies.{name}.file": Path(keys.file) for name, keys in bodies if keys.file}


def meshes_of(work: Work) -> dict[tuple[int, str], tuple[str, bytes]]:
    """Return name and content of mesh files that are sent; workers need a disk in common for larger files."""
    found = {}
    for design, (text, path) in enumerate(work.cases):
        for key, file in mesh_files(parse_case(text, Path(path))).items():
            if file.is_file() and file.stat().st_size <= MAX_SENT:
                found[design, key] = (file.name, file.read_bytes())
    return found


# The loop


def run_jobs(
    work: Work,
    jobs: Iterator[Job],
    lane: Lane,
    lanes: Callable[[float, int], list[Lane]],
    take: Callable[[list[Done]], None],
) -> None:
    """Run jobs; the first of them alone.

    Parameters
    ----------
    lane : for the first run
    lanes : function of the wall time [s] and the peak memory [bytes] of the first run; returns all lanes
    take : called with what a portion has led to
    """
    again: deque[list[Job]] = deque()
    deaths: dict[int, int] = {}
    ended = lost = 0
    seconds, every, begun = PORTION, [lane], False

    def next_portion() -> list[Job]:
        if again:
            return again.popleft()
        number = max(1, min(MAX_PORTION, int(PORTION / max(seconds, 1e-9)))) if begun else 1
        return [job for _, job in zip(range(number), jobs, strict=False)]

    try:
        while True:
            for one in every:
                while len(one.flying) < (one.capacity if begun else 1) and (portion := next_portion()):
                    one.submit(work, portion)
            futures = [future for one in every for future in one.flying]
            if not futures:
                return
            wait(futures, return_when=FIRST_COMPLETED)
            for one in every:
                broken = False
                for future in [future for future in one.flying if future.done()]:
                    portion = one.flying.pop(future)
                    error = future.exception()
                    if error is None:
                        found, memory = future.result()
                        take(found)
                        ended += len(found)
                        seconds = sum(item.seconds for item in found) / len(found)
                        if not begun:
                            every, begun = lanes(seconds, memory), True
                        continue
                    if isinstance(error, InputError | CancelledError):
                        words = str(error) or "the scheduler is lost: go on with the same command"
                        raise InputError(words) from error
                    if broken:  # they were behind the portion that was in work
                        again.append(portion)
                        continue
                    broken = isinstance(error, BrokenProcessPool)
                    lost += 1
                    if lost >= _HOPELESS and not ended:
                        raise InputError(f"worker processes end before any run has: {error}") from error
                    take(_after_death(portion, deaths, again, error, final=not broken))
                if broken:
                    for portion in one.flying.values():
                        again.append(portion)
                    one.flying.clear()
                    one.close()
                    one.restart()
    finally:
        for one in every:
            one.close()


def _after_death(
    portion: list[Job], deaths: dict[int, int], again: deque[list[Job]], error: BaseException, *, final: bool
) -> list[Done]:
    """Submit the runs of a portion one by one again, but for those that have failed; returns these.

    final : a run alone is not submitted again
    """
    failed = []
    for job in portion:
        deaths[job.row] = deaths.get(job.row, 0) + 1
        if deaths[job.row] >= DEATHS or (final and len(portion) == 1):
            words = f"the process died {deaths[job.row]} times during this run"
            failed.append(Done(job, FAILED, note=str(error) if final else words))
        else:
            again.append([job])
    return failed


def lanes_on_this_machine(workers: int, first: Lane, memory: int) -> tuple[list[Lane], str]:
    """Return as many lanes as there is memory for, with the first, and a note if these are fewer."""
    left, note = memory_left(), ""
    if left is not None and memory:
        possible = max(1, 1 + left // memory)
        if possible < workers:
            note = f"{possible} of {workers} workers: a run takes {memory / 1e9:.2g} GB of memory"
            workers = possible
    return [first, *(ProcessLane() for _ in range(workers - 1))], note
