"""The closing line as a force term: its data under the winch's commands, its memory, bounds for the step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.cable import STRETCH_BOUND, green_lagrange_strain
from exunet.forces.closing_loops import (
    LAID,
    SMOOTH,
    Line,
    LineStatus,
    add_line,
    line_potential,
    remember_line,
)
from exunet.forces.loops import Index
from exunet.forces.reel import NOTHING_ASKED, command_name
from exunet.forces.reel_loops import winding_rate
from exunet.forces.rubbing_loops import (
    RUBBING,
    add_rubbing_line,
    remember_rubbing,
    rubbing_potential,
    settle_line,
    stretch_at,
)
from exunet.forces.terms import Change, Input, KernelTerm, Memories, Memory, Series
from exunet.net.closing import NAME, SLOWS, ClosingLine

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MEMORY = f"{NAME}/line"
_SERIES = {  # fields of the status: units
    "tension_start": "N",
    "tension_end": "N",
    "way": "m",
    "largest": "N",
    "largest_time": "s",
    "load": "1",
}
_STRAIN = 0.01  # up to which the bound for the step counts what the tension itself adds to the stiffness


def states_of(line: ClosingLine, position: Floats, ratio: float, time: float) -> tuple[FirstOrder, ...]:
    """Length wound up [m], work of the winch on the line [J]; what viscous stress has taken [J], if there is
    any; with friction what that has taken, and elastic energy [J].

    position : (n_nodes, 3) at the start [m]; ratio, time : as of `Drawstring`
    """
    states = (
        FirstOrder(f"{NAME}/wound_up", (line.wound,), "m"),
        FirstOrder(f"{NAME}/work", (0.0,), "J", gives=1.0),
    )
    if line.friction == 0.0:
        return (*states, FirstOrder(f"{NAME}/viscosity", (0.0,), "J", gives=-1.0)) if time > 0.0 else states
    natural = ratio * line.length_at_start
    strain = max(0.0, float(green_lagrange_strain(way_of(line, position).sum(), natural)))
    energy = 0.5 * ratio**3 * line.stiffness * strain**2 * natural
    taken = FirstOrder(f"{NAME}/friction", (0.0,), "J", gives=-1.0)
    return *states, taken, FirstOrder(f"{NAME}/elastic", (energy,), "J")


def way_of(line: ClosingLine, position: Floats) -> Floats:
    """(n,) way of each piece of the line [m]; position (n_nodes, 3) [m]."""
    apart = np.linalg.norm(np.diff(position[list(line.path)], axis=0), axis=1)
    u = np.minimum(apart / line.ring_diameter, 1.0)
    return np.maximum(apart, line.ring_diameter * (0.375 + u**2 * (0.75 - 0.125 * u**2)))


@dataclass(frozen=True, eq=False)
class Drawstring:
    """A closing line in a scene.

    ratio : of its length that is free of stress to that in the reference configuration, by a thermal strain
    time  : relaxation time of viscous stress [s]; 0.0: there is none. A line with friction has none
    """

    line: ClosingLine
    blocks: Blocks
    ratio: float = 1.0
    time: float = 0.0

    @property
    def rubs(self) -> bool:
        """True with friction."""
        return self.line.friction > 0.0

    @property
    def at_start(self) -> Floats:
        """The memory at time 0: line in the pieces by their ways, so that its tension is the same in all."""
        line = self.line
        way = way_of(line, self.blocks.position)
        stretch = float(way.sum()) / (self.ratio * line.length_at_start)
        strain = max(0.0, 0.5 * (stretch - 1.0) * (stretch + 1.0))
        tension = line.stiffness * self.ratio**3 * strain * stretch
        status = LineStatus(
            commands=float(np.searchsorted(line.times, 0.0, side="right")),
            tension_start=tension,
            tension_end=tension,
            way=float(way.sum()),
            largest=tension,
            largest_time=0.0,
            load=0.0 if line.strength is None else tension / line.strength,
            stretch=stretch,
        )
        if not self.rubs:
            return np.array(status)
        laid = self.ratio * line.length_at_start * way / way.sum()
        return np.concatenate([status, laid, np.zeros(len(way))])

    def data(self, memory: Floats) -> Line:
        """What the loops take at a memory."""
        line, blocks = self.line, self.blocks
        n, drive = len(line.path) - 1, line.drives[int(memory[0])]
        laid, room = np.zeros((6, n)), np.zeros((8, n if self.rubs else 0))
        return Line(
            node=(3 * np.array(line.path)).astype(Index),
            state=np.array([blocks.state(f"{NAME}/wound_up")], dtype=Index),
            rate=np.array([blocks.rate(f"{NAME}/wound_up")], dtype=Index),
            whole=self.ratio * line.length,
            ratio=self.ratio,
            stiffness=line.stiffness * self.ratio**3,
            time=self.time,
            ring=line.ring_diameter,
            friction=line.friction,
            winch=n - 1 if line.winch_at_end else 0,
            strength=np.inf if line.strength is None else line.strength,
            rate_at_most=drive.rate,
            force=drive.force,
            gives=drive.gives,
            asked=NOTHING_ASKED,
            largest_rate=line.largest_rate,
            longest_wound=line.length - line.shortest,
            slows=SLOWS * line.length,
            kept=memory,
            dx=laid[0],
            dy=laid[1],
            dz=laid[2],
            square=laid[3],
            way=laid[4],
            pull=laid[5],
            told=np.zeros(3),
            old=room[0],
            material=room[1],
            tension=room[2],
            factor=room[3],
            limit=room[4],
            slides=room[5],
            parting=room[6],
            turning=room[7],
        )

    @property
    def memory(self) -> Memory:
        """Status and, with friction, how much line is where."""
        wanted = {name: units for name, units in _SERIES.items() if name != "load" or self.line.strength}
        series = tuple(
            Series(f"{NAME}/{name}", units, LineStatus._fields.index(name)) for name, units in wanted.items()
        )
        return Memory(MEMORY, self.at_start, self.data, "kept", too_long, series)

    @property
    def rates(self) -> tuple[float, float]:
        """Bounds [1/s2], [1/s] of what the line adds to the eigenvalues, while its strain is not above 1 %.

        Along the line, EA over its least length times the sum of |dL/dx|^2 / m: a ring turns it by half a
        turn at most. Without friction the line stretches as a whole, with friction it may stretch between any
        two rings alone; there it is taken to have its even share of the least length. Across the line, its
        tension over the diameter of the rings, where they meet (3/2, the largest curvature of the way).
        """
        line, mass = self.line, self.blocks.mass
        free = np.ones(len(mass), dtype=bool)
        free[self.blocks.net.fixed_nodes] = False
        mobility = np.where(free, 1.0 / mass, 0.0)[list(line.path)]
        least = self.ratio * (line.shortest if line.has_winch else line.length)
        turns = np.full(len(line.path), 4.0)
        turns[[0, -1]] = 1.0
        slope = line.stiffness / least  # of the tension over the length
        along = slope * float(turns @ mobility)
        if self.rubs:
            slope *= len(line.path) - 1
            along = slope * 4.0 * float(mobility.max())
        across = 6.0 * _STRAIN * line.stiffness / line.ring_diameter * float(mobility.max())
        give = max(one.gives for one in (*line.drives, line.softest))
        return 2.0 * along + across, slope * give + 2.0 * self.time * along

    def term(self) -> KernelTerm:
        """Its forces, its energy, its winch and, with friction, what that takes."""
        line, memory, rates = self.line, self.memory, self.rates
        asked = Input(command_name(NAME), "asked", NOTHING_ASKED, "1, m/s, N, m/(N s)")
        helpers = (winding_rate, *LAID, *(RUBBING if self.rubs else SMOOTH))
        return KernelTerm(
            "nodes with rings",
            add_rubbing_line if self.rubs else add_line,
            self.data(memory.initial),
            potential=rubbing_potential if self.rubs else line_potential,
            helpers=helpers,
            stiffness_rate=rates[0],
            damping_rate=rates[1],
            memory=memory,
            switch=WinchCommands(line) if line.times else None,
            inputs=(asked,) if line.is_commanded else (),
            remember=remember_rubbing if self.rubs else remember_line,
            internal=True,
        )


def elastic_once_slid(x: Floats, line: Line, friction: float) -> float:
    """Energy [J] of a line with friction at x, once it has slid as far as this coefficient lets it."""
    line = line._replace(friction=friction)
    settle_line(x, line)
    stretch = np.array([stretch_at(pull / line.stiffness) for pull in line.tension.tolist()])
    strain = 0.5 * (stretch - 1.0) * (stretch + 1.0)
    return float(0.5 * line.stiffness * (strain**2 @ line.material))


def too_long(values: Floats) -> str:
    """Why a run with this memory must stop, and what to change; "" if it need not."""
    stretch = float(values[LineStatus._fields.index("stretch")])
    if stretch <= STRETCH_BOUND:
        return ""
    words = (
        f"the closing line is {stretch:.4g} times as long as when free of stress; above {STRETCH_BOUND:g} "
    )
    return f"{words}it is outside the cable law's validity: make it stiffer, or its winch weaker"


class WinchCommands:
    """The instants at which commands of the winch come in force."""

    heading = NAME

    def __init__(self, line: ClosingLine) -> None:
        self.times = line.times

    def in_steps(self, memory: Floats) -> bool:
        """The instants are known."""
        return False

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """The only item, if a command has come since the memory was set."""
        return np.flatnonzero([np.searchsorted(self.times, time, side="right") > memory[0]])

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """Steps end at known instants anyway."""
        return step

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """Count the commands; nothing else changes."""
        after = memory.copy()
        after[0] = np.searchsorted(self.times, time, side="right")
        return Change(after, events=({"time_s": time, "event": f"command {int(after[0])}"},))
