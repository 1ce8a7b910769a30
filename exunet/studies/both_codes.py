"""One case in both codes: read by each with its own reader, woven by each, and matched node by node.

This is where exunet imports reference_impl. The two share the case file and nothing else.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.backends.compiled.loop import March, loop_kernel
from exunet.backends.exudyn.probe import Probe
from exunet.backends.exudyn.stepper import EngineFailed, Stepper
from exunet.base.errors import InputError
from exunet.case.casefile import Case, load
from exunet.case.fault_location import located_faults
from exunet.codegen.compile import numba_installed
from exunet.forces.effects import switched_on
from exunet.methods.method import Method, NetForm, TimeLoop
from exunet.methods.plan import Plan
from exunet.results.comparison import States, match_nodes
from exunet.simulation.preparation import Start, build, prepare

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Motion:
    """A trajectory in exunet's numbering: time (t,) [s], position and velocity (t, n, 3), steps taken."""

    time: Floats
    position: Floats
    velocity: Floats
    steps: int


@dataclass(frozen=True)
class Pair:
    """A case as both codes see it.

    name    : for tables
    path    : of the case file
    start   : exunet's
    theirs  : the reference's case
    net, system : the reference's net and equations of motion
    """

    name: str
    path: Path
    start: Start
    theirs: reference.Case
    net: reference.Net
    system: reference.System

    @cached_property
    def to_theirs(self) -> Ints:
        """(n_nodes,) for each node of exunet the node of the reference at the same place."""
        return match_nodes(self.ours_at_start, self.theirs_at_start)

    @cached_property
    def elements_to_theirs(self) -> Ints:
        """(n_elements,) for each element of exunet the element of the reference between the same nodes."""
        ours = np.sort(self.to_theirs[self.start.net.element_nodes], axis=1)
        theirs = np.sort(self.net.element_nodes, axis=1)
        there = np.lexsort(theirs.T)
        match = np.empty(len(ours), dtype=np.int64)
        match[np.lexsort(ours.T)] = there
        return match

    @property
    def ours_at_start(self) -> States:
        """exunet's net and initial state."""
        start = self.start
        return States.of_net(start.net, np.zeros(1), start.position[None], start.velocity[None])

    @property
    def theirs_at_start(self) -> States:
        """The reference's net and initial state, in its own numbering."""
        position, velocity = reference.initial_state(self.theirs, self.net)
        return States.of_net(self.net, np.zeros(1), position[None], velocity[None])

    @property
    def effects(self) -> set[str]:
        """Names of the effects that the case switches on."""
        return set(switched_on(self.start.scene.effects))

    @property
    def speed(self) -> float:
        """Largest initial speed of a node [m/s]; 1 for a net at rest."""
        return float(np.linalg.norm(self.start.velocity, axis=1).max(initial=0.0)) or 1.0

    @property
    def size(self) -> float:
        """Largest side of the box around the reference configuration [m]."""
        return float(np.ptp(self.start.net.reference_position, axis=0).max()) or 1.0

    def give(self, values: Floats) -> Floats:
        """Values (..., n, 3) of exunet's nodes in the order of the reference's."""
        result = np.empty_like(values)
        result[..., self.to_theirs, :] = values
        return result

    def take(self, values: Floats) -> Floats:
        """Values (..., n, 3) of the reference's nodes in the order of exunet's."""
        return values[..., self.to_theirs, :]

    def probe(self) -> Probe:
        """The engine's equations of motion, in the form that also has derivatives."""
        implicit = Plan(Method.GENERALIZED_ALPHA, step=1e-6)
        return Probe(build(replace(self.start, plan=implicit)))

    def fused(self) -> Pair:
        """The same case with the engine's fused net in place of connectors."""
        scene = self.start.scene
        engine = scene.engine.model_copy(update={"net": NetForm.FUSED})
        start = replace(self.start, scene=scene.model_copy(update={"engine": engine}))
        return replace(self, name=f"{self.name}, fused", start=start)

    def looped(self) -> Pair:
        """The same case stepped by exunet's compiled loop in place of the engine; needs Numba to run."""
        scene = self.start.scene
        engine = scene.engine.model_copy(update={"net": NetForm.FUSED, "loop": TimeLoop.COMPILED})
        start = replace(self.start, scene=scene.model_copy(update={"engine": engine}))
        return replace(self, name=f"{self.name}, compiled", start=start)

    def fastest(self) -> Pair:
        """The form of the case for many runs: `looped`, or this one where Numba is not installed."""
        return self.looped() if numba_installed() else self

    def from_state(self, position: Floats, velocity: Floats) -> Pair:
        """The same case started from another state of the free nodes (both in exunet's order)."""
        fixed = self.start.net.fixed_nodes
        position, velocity = position.copy(), velocity.copy()
        position[fixed], velocity[fixed] = self.start.position[fixed], 0.0
        return replace(self, start=replace(self.start, position=position, velocity=velocity))

    def engine(self, times: Floats, plan: Plan | None = None) -> Motion:
        """Exudyn's trajectory at `times` (from 0 on), with the plan of the case or another.

        That of the compiled loop, if the case is `looped`. Raises EngineFailed where the engine
        gives up.
        """
        start = replace(self.start, plan=plan or self.start.plan)
        if start.scene.engine.loop == TimeLoop.COMPILED:
            return _compiled(start, times)
        model = build(start)
        states = [model.coordinates()]
        stepper = Stepper(model, start.plan, float(times[-1]), _ignore)
        for until in times[1:].tolist():
            stepper.advance(until)
            states.append(model.coordinates())
        raw = [np.array(part) for part in zip(*states, strict=True)]
        return Motion(np.asarray(times), *model.unpack(raw[0], raw[1]), stepper.counts.steps)

    def march(self, times: Floats, symmetric: bool = False, **how: Any) -> Motion:
        """The reference's trajectory at `times` (from 0 on); `how` as in reference_impl.march."""
        system = replace(self.system, symmetric=symmetric) if symmetric else self.system
        x0, v0 = self.give(self.start.position), self.give(self.start.velocity)
        found = reference.march(system, x0, v0, times, **how)
        return Motion(found.t, self.take(found.x), self.take(found.v), found.n_steps)

    def bullet_speeds(self, motion: Motion) -> Floats:
        """(t, n_bullets) [m/s]; of all nodes if there are no bullets."""
        bullets = self.start.net.bullet_nodes
        shown = bullets if len(bullets) else np.arange(self.start.net.n_nodes)
        return np.linalg.norm(motion.velocity[:, shown], axis=-1)


def _compiled(start: Start, times: Floats) -> Motion:
    march = March(start, loop_kernel(start))
    reached, position, velocity, _ = march.through(times)
    if len(reached) < len(times):
        raise EngineFailed(march.collapse())
    if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
        raise EngineFailed("the state in the compiled loop is no longer finite")
    return Motion(np.asarray(times), position, velocity, march.counts.steps)


def _ignore(time: Floats, position: Floats, velocity: Floats) -> None:
    """A watcher that only lets the stepper go on."""


def read_pair(path: str | Path, overrides: Mapping[str, str] | None = None) -> Pair:
    """The case at `path` in both codes.

    overrides : key to value as in `--set` (text)
    Raises CaseError if exunet cannot read it, and InputError naming what the reference does not know: such
    a case is never compared in part.
    """
    settings = [f"{key}={value}" for key, value in (overrides or {}).items()]
    case = load(path, settings)
    with located_faults(case):
        return pair_of(case)


def pair_of(case: Case) -> Pair:
    """As `read_pair`, of a case that exunet has read."""
    try:
        theirs = reference.read(case.path, dict(map(reference.parse_override, case.overrides)))
        net = reference.weave(theirs)
    except reference.Refused as refused:
        raise _out_of_reach(case.name, refused) from refused
    # The form that states the law element by element; `Pair.fused` is the other.
    scene = case.scene
    engine = scene.engine.model_copy(update={"net": NetForm.CONNECTORS, "loop": TimeLoop.EXUDYN})
    scene = scene.model_copy(update={"engine": engine})
    return Pair(case.name, case.path, prepare(scene), theirs, net, reference.assemble(theirs, net))


def pair_of_text(name: str, text: str) -> Pair:
    """As `read_pair`, of a case that is not a file."""
    with tempfile.TemporaryDirectory(prefix="exunet-verify-") as folder:
        path = Path(folder) / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return read_pair(path)


def _out_of_reach(name: str, refused: reference.Refused) -> InputError:
    reasons = "; ".join(fault.replace("\n", " ") for fault in refused.faults[:5])
    return InputError(f"{name}: out of the reference's reach, so nothing of it is compared: {reasons}")
