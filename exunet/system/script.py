"""A script as a term without forces, over the system that it looks at and acts on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.case.script import Entry
from exunet.forces.kernel_call import KernelCall
from exunet.forces.reel import command_name
from exunet.forces.terms import Input, Memories, Memory
from exunet.net.closing import NAME as CLOSING
from exunet.system.quantities import Sight
from exunet.system.script_events import ScriptEvents
from exunet.system.script_rows import WAITING, Row
from exunet.system.set_parameters import inputs_of
from exunet.system.system import System

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Script:
    """The entries of a case; the system of `sight` is without the script.

    damping : of each drive [N s/m]
    """

    entries: tuple[Entry, ...]
    sight: Sight
    damping: dict[str, float | None]
    acts_on: str = field(default="nothing", init=False)
    calls: tuple[KernelCall, ...] = field(default=(), init=False)
    inputs: tuple[Input, ...] = field(default=(), init=False)
    dissipates: bool = field(default=False, init=False)
    has_potential: bool = field(default=False, init=False)
    damping_rate: float = field(default=0.0, init=False)

    def data_at(self, memory: Memories) -> tuple[tuple[Any, ...], ...]:
        """It has no calls."""
        return ()

    def numbers(self) -> Iterator[Any]:
        """It has no numbers of its own."""
        yield from ()

    @property
    def memory(self) -> Memory:
        """A `Row` of each entry, and 1.0 once the run has been ended."""
        rows = [Row(WAITING, 0.0, 0.0, 0.0) for _ in self.entries]
        return Memory("script/entries", np.append(np.array(rows).ravel(), 0.0), in_steps=True)

    @property
    def switch(self) -> ScriptEvents:
        """Made anew, for one run."""
        return ScriptEvents(self.entries, self.sight, self.damping)

    @property
    def acts_with(self) -> frozenset[str]:
        """The inputs that it gives."""
        drives = frozenset(command_name(one.drive) for one in self.entries if one.drive is not None)
        return drives | inputs_of(self.entries)


def script_of(entries: tuple[Entry, ...], system: System, target: str | None) -> Script:
    """The script of a scene over its system; target : name of the body that is to be captured."""
    drives: dict[str, float | None]
    drives = {one.reel.name: one.reel.damping for one in system.forces.cable.reels}
    if system.line is not None and system.line.has_winch:
        drives[CLOSING] = system.line.damping
    return Script(entries, Sight.of(system, target), drives)
