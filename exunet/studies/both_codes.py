"""One case in both codes: read by each with its own reader, woven by each, and matched node by node.

This is where exunet imports reference_impl. The two share the case file and nothing else.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.backends import integrator
from exunet.backends.exudyn.build import build
from exunet.backends.exudyn.probe import Probe
from exunet.backends.protocol import Batch, Extremes
from exunet.base.errors import InputError
from exunet.case.casefile import Case, load
from exunet.case.fault_location import located_faults
from exunet.case.scene import Scene
from exunet.codegen.compile import numba_installed
from exunet.forces.effects import switched_on
from exunet.forces.terms import Change
from exunet.methods.method import Form, Method, NetForm
from exunet.methods.plan import Plan
from exunet.results.comparison import ComparedRun, match_nodes
from exunet.simulation.preparation import Start, prepare
from exunet.studies.neighbours import launch_speed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Trajectory:
    """A trajectory in exunet's numbering: time (t,) [s], position and velocity (t, n, 3), steps taken."""

    time: Floats
    position: Floats
    velocity: Floats
    steps: int


@dataclass(frozen=True)
class BothCodes:
    """A case as both codes see it; all states are in exunet's numbering unless a name says otherwise.

    name   : for tables
    path   : of the case file
    start  : exunet's
    theirs : the reference's case, net, equations of motion and start
    """

    name: str
    path: Path
    start: Start
    theirs: reference.Scene

    @cached_property
    def reference_nodes(self) -> Ints:
        """(n_nodes,) for each node of exunet the node of the reference at the same place."""
        start, theirs = self.start, self.theirs
        ours = _at_start(start.net, start.position, start.velocity)
        return match_nodes(ours, _at_start(theirs.net, theirs.x0, theirs.v0))

    @cached_property
    def reference_elements(self) -> Ints:
        """(n_elements,) for each element of exunet the element of the reference between the same nodes."""
        ours = np.sort(self.reference_nodes[self.start.net.element_nodes], axis=1)
        theirs = np.sort(self.theirs.net.element_nodes, axis=1)
        match = np.empty(len(ours), dtype=np.int64)
        match[np.lexsort(ours.T)] = np.lexsort(theirs.T)
        return match

    @property
    def effects(self) -> set[str]:
        """Names of the effects that the case switches on."""
        return set(switched_on(self.start.scene.effects))

    @property
    def speed(self) -> float:
        """See `launch_speed`."""
        return launch_speed(self.start.velocity)

    @property
    def size(self) -> float:
        """See `Net.size`."""
        return self.start.net.size

    def to_reference(self, values: Floats) -> Floats:
        """Values (..., n, 3) of exunet's nodes in the order of the reference's."""
        result = np.empty_like(values)
        result[..., self.reference_nodes, :] = values
        return result

    def from_reference(self, values: Floats) -> Floats:
        """Values (..., n, 3) of the reference's nodes in the order of exunet's."""
        return values[..., self.reference_nodes, :]

    def probe(self) -> Probe:
        """The engine's equations of motion, in the form that also has derivatives."""
        implicit = Plan(Method.GENERALIZED_ALPHA, step=1e-6)
        fused = self.start.scene.engine.net == NetForm.FUSED
        return Probe(build(self.start.system, self.start.state, implicit, fused=fused))

    def in_form(self, form: Form) -> BothCodes:
        """The same case with the engine's fused net, or by exunet's compiled loop; needs Numba to run."""
        start = replace(self.start, scene=_with_form(self.start.scene, form))
        return replace(self, name=f"{self.name}, {form.name.lower()}", start=start)

    def fastest(self) -> BothCodes:
        """The form of the case for many runs: compiled, or this one where Numba is not installed."""
        return self.in_form(Form.COMPILED) if numba_installed() else self

    def from_state(self, position: Floats, velocity: Floats) -> BothCodes:
        """The same case started from another state of the free nodes."""
        fixed = self.start.net.fixed_nodes
        position, velocity = position.copy(), velocity.copy()
        position[fixed], velocity[fixed] = self.start.position[fixed], 0.0
        return replace(self, start=self.start.moved(position, velocity))

    def run_exunet(self, times: Floats, plan: Plan | None = None) -> Trajectory:
        """exunet's trajectory at `times` (from 0 on), with the plan of the case or another.

        By Exudyn, or by the compiled loop where the case is `compiled`. Raises IntegrationFailed where it
        gives up.
        """
        start = replace(self.start, plan=plan or self.start.plan)
        stepper = integrator(start.scene.engine, start.system, start.state, start.plan, _Unobserved())
        states = [start.state]
        for until in times[1:].tolist():
            stepper.advance(until)
            states.append(stepper.state())
        x, v = np.array([state.position for state in states]), np.array([state.velocity for state in states])
        return Trajectory(np.asarray(times), x, v, stepper.counts.steps)

    def run_reference(self, times: Floats, **how: Any) -> Trajectory:
        """The reference's trajectory at `times` (from 0 on); `how` as in reference_impl.integration."""
        found = self.reference_trajectory(times, **how)
        x, v = (self.from_reference(values) for values in (found.x, found.v))
        return Trajectory(found.t, x, v, found.n_steps)

    def reference_trajectory(self, times: Sequence[float] | Floats, **how: Any) -> reference.Trajectory:
        """The same as the reference gives it, in its own numbering and with its counts."""
        x0, v0 = self.to_reference(self.start.position), self.to_reference(self.start.velocity)
        return reference.integrate(self.theirs.system, x0, v0, times, **how)


def coordinates(nodes: Ints) -> Ints:
    """(3n,) rows of the nodes (n,) in matrices that count three coordinates a node."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).ravel())


def _at_start(net: Any, position: Floats, velocity: Floats) -> ComparedRun:
    return ComparedRun.of_net(net, np.zeros(1), position[None], velocity[None])


def _with_form(scene: Scene, form: Form) -> Scene:
    return scene.model_copy(update={"engine": scene.engine.model_copy(update=form.engine)})


class _Unobserved:
    """An observer that ignores what it gets."""

    def take(self, batch: Batch) -> None: ...

    def between(self, until: float, extremes: Extremes) -> None: ...

    def changed(self, time: float, memory: str, change: Change) -> None: ...


def read_both(path: str | Path, overrides: Sequence[str] = ()) -> BothCodes:
    """The case at `path` in both codes.

    overrides : "key=value" as after `--set`
    Raises CaseError if exunet cannot read it, and InputError naming what the reference does not know: such
    a case is never compared in part.
    """
    case = load(path, overrides)
    with located_faults(case):
        return both_of(case)


def both_of(case: Case) -> BothCodes:
    """As `read_both`, of a case that exunet has read."""
    try:
        overrides = dict(map(reference.parse_override, case.overrides))
        theirs = reference.prepare(reference.read(case.path, overrides))
    except reference.Refused as refused:
        reasons = "; ".join(fault.replace("\n", " ") for fault in refused.faults[:5])
        words = f"the reference does not cover this case, so nothing is compared: {reasons}"
        raise InputError(f"{case.name}: {words}") from refused
    # The form that states the law element by element; see `BothCodes.in_form` for the others.
    scene = _with_form(case.scene, Form.CONNECTORS)
    return BothCodes(case.name, case.path, prepare(scene), theirs)


def both_of_text(name: str, text: str) -> BothCodes:
    """As `read_both`, of a case that is not a file."""
    with tempfile.TemporaryDirectory(prefix="exunet-verify-") as folder:
        path = Path(folder) / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return read_both(path)
