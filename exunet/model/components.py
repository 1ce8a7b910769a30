"""Components of a scene beside net, bodies and effects: the first-order states and forces that each adds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import LARGEST, Fault
from exunet.base.record import Record
from exunet.bodies.kinematics import Kinematics
from exunet.forces import closing, corner_units, perimeter, reel
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.closing import Drawstring, way_of
from exunet.forces.control_config import Control
from exunet.forces.effects import thrust
from exunet.forces.perimeter import Shortening
from exunet.forces.reel import Winding, reel_term
from exunet.forces.terms import KernelTerm, Memories
from exunet.forces.total import Forces
from exunet.model.drum import Drum
from exunet.model.script import with_inputs
from exunet.model.system import Layout
from exunet.net.closing import ClosingLine, Perimeter
from exunet.net.reel import Reel
from exunet.scene.script import Entry, begins_a_thrust, begins_control

Floats = NDArray[np.float64]


class Component(Protocol):
    """Part of a scene.

    states : first-order states
    """

    @property
    def states(self) -> tuple[FirstOrder, ...]: ...

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        """Return the forces with those of the component; `faults` receives faults of its numbers."""


def _with_kernels(forces: Forces, *kernels: KernelTerm) -> Forces:
    return replace(forces, kernels=(*forces.kernels, *kernels))


@dataclass(frozen=True, eq=False)
class Reels:
    """Reels of tethers, which replace the cable law of their outlets."""

    reels: tuple[Reel, ...]
    kinematics: Kinematics

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return tuple(state for item in self.reels for state in reel.states_of(item))

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        windings = tuple(Winding(item, blocks, forces.cable.law) for item in self.reels)
        terms = (reel_term(winding, Drum(winding, self.kinematics)) for winding in windings)
        return _with_kernels(replace(forces, cable=replace(forces.cable, reels=windings)), *terms)


@dataclass(frozen=True, eq=False)
class ShorterEdge:
    """Edge of the net that becomes shorter."""

    edge: Perimeter

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return perimeter.states_of(self.edge)

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        shortening = Shortening(self.edge, blocks, forces.cable.law)
        cable = replace(forces.cable, shortening=shortening)
        return _with_kernels(replace(forces, cable=cable), shortening.term())


@dataclass(frozen=True, eq=False)
class DrawnLine:
    """Closing line through rings, with free strain and viscous stress as of all cables.

    states : of the line at its path at time 0
    ratio, time : as `Drawstring`
    """

    line: ClosingLine
    states: tuple[FirstOrder, ...]
    ratio: float
    time: float

    @classmethod
    def of(cls, line: ClosingLine, effects: Record, position: Floats) -> DrawnLine:
        """Return the line of a net with nodes at position (n_nodes, 3) [m]."""
        warm, damped = (getattr(effects, name, None) for name in ("thermal_strain", "material_damping"))
        ratio = 1.0 if warm is None else float(np.sqrt(1.0 + 2.0 * warm.free_strain))
        rubs = line.friction > 0.0
        time = 0.0 if damped is None or rubs else float(damped.relaxation_time)
        return cls(line, closing.states_of(line, position, ratio, time), ratio, time)

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        """Return the forces; unchanged for numbers outside the range of floating point, with a fault."""
        path = float(way_of(self.line, blocks.position).sum())
        if not path <= STRETCH_BOUND * self.ratio * self.line.length_at_start:
            faults.append(Fault("closing.length", self._too_short(path)))
        drawstring = Drawstring(self.line, blocks, self.ratio, self.time)
        if not max(drawstring.rates) <= LARGEST:
            words = "leads to numbers outside the range of floating-point: use realistic values"
            faults.append(Fault("closing", words, beyond_floats=True))
            return forces
        return _with_kernels(forces, drawstring.term())

    def _too_short(self, path: float) -> str:
        """Describe a line that is too short for its path through the rings [m]."""
        stretch, wound = path / (self.ratio * self.line.length_at_start), self.line.wound
        words = f"its path through the rings of {path:.6g} m at the start requires a stretch of {stretch:.4g}"
        words += f" ({wound:.6g} m are wound up)" if wound > 0.0 else ""
        return f"{words}, above {STRETCH_BOUND:g}, the limit of the cable law: use a longer line"


def _completed(
    layout: Layout, kinematics: Kinematics, time: float, x: Floats, v: Floats, memory: Memories
) -> tuple[Floats, Floats]:
    """Return x and v with what has no equations of motion put in."""
    return layout.pack(layout.unpack(x, v).completed(kinematics, time, memory)) if kinematics else (x, v)


@dataclass(frozen=True, eq=False)
class CornerUnits:
    """Corner units with thrusters.

    counted : integrate their impulses
    """

    control: Control
    kinematics: Kinematics
    script: tuple[Entry, ...]
    counted: bool

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return corner_units.states_of(self.control)

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        completed = partial(_completed, Layout(blocks), self.kinematics)
        waits = begins_control(self.script)
        term = corner_units.term_of(self.control, blocks, completed, waits=waits, counted=self.counted)
        return _with_kernels(forces, term)


@dataclass(frozen=True, eq=False)
class ScriptedForces:
    """What the script of a case does to forces: thrusts wait, threads may be cut, coefficients are inputs."""

    script: tuple[Entry, ...]
    states: tuple[FirstOrder, ...] = ()

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        if begins_a_thrust(self.script):
            kernels = (thrust.waiting(term) if _is_thrust(term) else term for term in forces.kernels)
            forces = replace(forces, kernels=tuple(kernels))
        if any(entry.do == "cut" for entry in self.script):
            forces = replace(forces, cable=replace(forces.cable, may_be_cut=True))
        return with_inputs(forces, self.script)


def _is_thrust(term: KernelTerm) -> bool:
    return term.memory is not None and term.memory.name == thrust.MEMORY
