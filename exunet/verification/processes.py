"""Steps of the ladder in several processes at the same time; their findings come in the steps' order."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from exunet.plots.style import drawing
from exunet.verification.check import Evidence
from exunet.verification.one_step import Step

Followed = tuple[Step, Iterable[Evidence]]
# A new interpreter: the engine has threads, which a fork would not survive.
_CONTEXT = multiprocessing.get_context("spawn")


def one_by_one(steps: Iterable[Step]) -> Iterator[Followed]:
    """Each step with its findings, in this process."""
    return ((step, step.run()) for step in steps)


def followed(plan: Callable[[], list[Step]], processes: int) -> Iterator[Followed]:
    """Each step with its findings, which are calculated ahead of being asked for.

    plan      : makes the steps, which do not depend on each other; each process makes its own, as cases hold
                functions that cannot be sent
    processes : 1: all in this process
    An interrupt, or leaving off, ends the processes. A process that dies fails the step it had.
    """
    if processes == 1:
        yield from one_by_one(plan())
        return
    crew = _Crew(plan, processes)
    try:
        for number, step in enumerate(crew.steps):
            yield step, crew.findings(number)
    finally:
        crew.end()


class _Crew:
    """Processes with one step each, and what they have found."""

    def __init__(self, plan: Callable[[], list[Step]], processes: int) -> None:
        self._plan, self.steps = plan, plan()
        steps = self.steps
        self._todo = deque(range(len(steps)))
        self._found: list[deque[Evidence]] = [deque() for _ in steps]
        self._done: set[int] = set()
        self._from_first: set[int] = set()
        self._at_work: dict[Connection, tuple[BaseProcess, int]] = {}
        for _ in range(min(processes, len(steps))):
            self._start_one()

    def findings(self, number: int) -> Iterator[Evidence]:
        """Those of a step, as they come."""
        while True:
            while self._found[number]:
                yield self._found[number].popleft()
            if number in self._done:
                return
            for connection in wait(list(self._at_work)):
                assert isinstance(connection, Connection)
                self._hear(connection)

    def end(self) -> None:
        """Stop the processes, whatever they are at."""
        for process, _ in self._at_work.values():
            process.terminate()
        for connection, (process, _) in self._at_work.items():
            process.join()
            connection.close()
        self._at_work.clear()

    def _start_one(self) -> None:
        here, there = _CONTEXT.Pipe()
        process = _CONTEXT.Process(target=_work, args=(self._plan, there), daemon=True)
        process.start()
        there.close()
        self._hand_on(here, process)

    def _hand_on(self, connection: Connection, process: BaseProcess) -> None:
        """The next step to a process; without one it ends."""
        if not self._todo:
            connection.close()
            process.join()
            return
        # One process goes on from the first step, so that findings come; the others from the last, where
        # whole runs are: none of these is then left to one process alone at the end.
        if any(number in self._from_first for _, number in self._at_work.values()):
            number = self._todo.pop()
        else:
            number = self._todo.popleft()
            self._from_first.add(number)
        self._at_work[connection] = process, number
        with suppress(OSError):  # it has died, as `_hear` will find
            connection.send(number)

    def _hear(self, connection: Connection) -> None:
        """Take a finding, or that there is no further one."""
        process, number = self._at_work[connection]
        try:
            finding = connection.recv()
        except (EOFError, OSError):
            process.join()
            why = f"its process ended with exit code {process.exitcode} (-9: killed, as for lack of memory)"
            self._found[number].append(self.steps[number].stopped(why))
            self._done.add(number)
            del self._at_work[connection]
            connection.close()
            if self._todo:
                self._start_one()
            return
        if finding is not None:
            self._found[number].append(finding)
            return
        self._done.add(number)
        del self._at_work[connection]
        self._hand_on(connection, process)


def _work(plan: Callable[[], list[Step]], connection: Connection) -> None:
    """In a process of its own: the findings of each step whose number comes, and None after the last."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process ends this one
    steps = plan()
    with drawing():
        while True:
            try:
                number = connection.recv()
            except EOFError:
                return
            for finding in steps[number].run():
                connection.send(finding)
            connection.send(None)


def cores() -> int:
    """How many processes may run at the same time."""
    return os.cpu_count() or 1
