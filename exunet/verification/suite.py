"""The verification suite: its items, and their run in one or several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import reference_impl as reference
from exunet.base.cases import CASES, shipped
from exunet.base.errors import ExunetError, Interrupted
from exunet.integrators.protocol import IntegrationFailed
from exunet.plots.style import drawing
from exunet.studies.both_codes import BothCodes, read_both
from exunet.verification.answers import ANSWERS
from exunet.verification.answers.orders import orders
from exunet.verification.check import Check, Finding
from exunet.verification.cross_code import STATES, at_states
from exunet.verification.horizon import beyond
from exunet.verification.random_states import random_topologies, topology
from exunet.verification.tolerances import RAN
from exunet.verification.trajectories import boosted_run, closing_run, contact_run, whole_run

NETS, AT_STATES, RUNS, BEYOND, KNOWN, ORDERS = SECTIONS = (
    "Net, masses and start",
    "Forces, energies and momenta at random states",
    "Trajectories up to the horizon",
    "Statistics beyond the horizon",
    "Known answers",
    "Orders of the integrators",
)
MOST_ELEMENTS = 2000  # of a net that is followed over a run
RANDOM_NETS = 60
# Ends [s] of runs that take the reference long to follow further: what a case shows has started by then, and
# the known answers have each command of a reel. No compared instant of `release` is its throw, 0.4 s.
ENDS = {
    "bodies/dumbbell": 600.0, "bodies/ejection": 0.3, "bodies/frame": 0.2, "bodies/launch": 0.5,
    "bodies/release": 0.65, "bodies/tow": 2.0,
}  # fmt: skip
# Cases with the topology and the effects of others that are followed.
NOT_FOLLOWED = ("planar_deployment_006", "trajectories/thrown_fine", "trajectories/thrown_undamped")
PAPER = "planar_deployment"
Follow = Callable[[BothCodes, float | None], Iterable[Finding]]
# Shipped cases by folder: what follows a run.
FOLDERS: dict[str, Follow | None] = {
    "": whole_run,
    "verification/trajectories": whole_run,
    "bodies": whole_run,
    "effects": None,
    "verification/bodies": None,
    "verification/contact": contact_run,
    "verification/self_contact": None,
    "verification/closing": closing_run,
}


@dataclass(frozen=True)
class Item:
    """Checks of one kind on one case.

    Parameters
    ----------
    section : str
        Section of the report.
    subject : str
        Case, or what else is compared.
    work : callable
        Yields the findings; can be sent to another process.
    quick : bool
        True if it takes about a second.
    """

    section: str
    subject: str
    work: Callable[[], Iterable[Finding]]
    quick: bool = False

    def run(self) -> list[Finding]:
        """Return the findings; a run that stops gives a failing check."""
        found: list[Finding] = []
        try:
            with drawing():
                found.extend(self._signed(finding) for finding in self.work())
        except Interrupted:
            raise KeyboardInterrupt from None
        except (ExunetError, IntegrationFailed, reference.Diverged) as stop:
            found.append(self.failed(str(stop).split("\n")[0]))
        return found

    def _signed(self, finding: Finding) -> Finding:
        return replace(finding, subject=finding.subject or self.subject, section=self.section)

    def failed(self, why: str) -> Check:
        """Return the failing check of an item that did not come to its end."""
        return Check("ran to its end", float("inf"), RAN, why, subject=self.subject, section=self.section)


@cache
def _case(path: Path) -> BothCodes:
    return read_both(path)


def _on(path: Path, check: Callable[..., Iterable[Finding]], *how: object) -> Iterable[Finding]:
    return check(_case(path), *how)


def suite(paths: Sequence[Path] = (), states: int = STATES, *, compiled: bool = True) -> list[Item]:
    """Return the items of distinct cases; without any those of the shipped cases and the known answers.

    states: random states of each kind
    compiled: compare the compiled loop at random states too, whose kernels take seconds to compile

    Raises
    ------
    InputError
        If the reference does not cover a case, or shipped cases are missing.
    """
    if paths:
        distinct = {path.resolve(): path for path in paths}
        return [item for path in distinct.values() for item in _named(path, states, compiled)]
    items = [Item(NETS, f"{RANDOM_NETS} random nets", partial(random_topologies, RANDOM_NETS))]
    for folder, follow in FOLDERS.items():
        for name, path in shipped(folder).items():
            subject = f"{folder.removeprefix('verification/')}/{name}".lstrip("/")
            items += _at_states(path, subject, states, compiled)
            if follow and subject not in NOT_FOLLOWED:
                items.append(Item(RUNS, subject, partial(_on, path, follow, ENDS.get(subject))))
    for case, answer, quick in ANSWERS:
        subject, path = (
            f"{case}: {answer.__name__.replace('_', ' ')}",
            CASES / "verification" / f"{case}.toml",
        )
        items.append(Item(KNOWN, subject, partial(_on, path, answer), quick))
    paper, smooth = shipped()[PAPER], CASES / "verification" / "smooth.toml"
    items.append(Item(RUNS, f"{PAPER}, moving frame", partial(_on, paper, boosted_run)))
    items.append(Item(BEYOND, PAPER, partial(_on, paper, beyond)))
    return [*items, Item(ORDERS, "smooth", partial(_on, smooth, orders))]


def _at_states(path: Path, subject: str, states: int, compiled: bool) -> Iterator[Item]:
    yield Item(NETS, subject, partial(_on, path, topology), quick=True)
    yield Item(AT_STATES, subject, partial(_on, path, at_states, states, compiled), quick=not compiled)


def _named(path: Path, states: int, compiled: bool) -> Iterator[Item]:
    """Yield the items of a case that the user names."""
    case, subject = _case(path), path.stem
    yield from _at_states(path, subject, states, compiled)
    of_points = not (case.moves_bodies or case.closes or case.touches_itself or case.in_contact)
    if case.start.net.n_elements > MOST_ELEMENTS or case.touches_itself:
        return
    if of_points:
        yield Item(BEYOND, subject, partial(_on, path, beyond))
    closes = case.closes and not case.moves_bodies
    follow = contact_run if case.in_contact else closing_run if closes else whole_run
    yield Item(RUNS, subject, partial(_on, path, follow))


def run(items: Sequence[Item], processes: int | None = None) -> Iterator[tuple[Item, list[Finding]]]:
    """Run items in some processes (None: one for each core); yield each with its findings as they come.

    Whole runs start first. An interrupt, or leaving the iteration, ends the processes. If a process dies, the
    items without findings fail.
    """
    processes = processes or os.cpu_count() or 1
    if processes == 1:
        yield from ((item, item.run()) for item in items)
        return
    others = set(multiprocessing.active_children())
    # New interpreters: the engine has threads, which a fork would not survive.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, _ignore_interrupts)
    try:
        ordered = sorted(items, key=lambda item: item.section not in (RUNS, BEYOND, ORDERS))
        futures = {pool.submit(item.run): item for item in ordered}
        for future in as_completed(futures):
            item = futures[future]
            try:
                yield item, future.result()
            except BrokenProcessPool:
                yield item, [item.failed("a process ended, as if killed or out of memory")]
        pool.shutdown()
    finally:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)  # the pool's own thread joins the processes


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the first process, which ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
