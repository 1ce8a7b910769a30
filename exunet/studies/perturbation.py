"""Perturbed runs: another start or another accuracy of a scene, and the speeds that are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from numbers import Integral, Real

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError
from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import product, quaternion_of
from exunet.methods.method import Plan
from exunet.net.arrays import Net
from exunet.simulation.preparation import Start
from exunet.simulation.rollback import FINER_TOLERANCE, finer

Floats = NDArray[np.float64]

PAPER_SIZE = 7.0  # [m], of the paper's net with its strings
MOVE = 1e-12 / PAPER_SIZE  # of the net's size: far above round-off, far below what any figure shows
SEED = 20210616


def perturbed(net: Net, position: Floats, amplitude: float, seed: int | Sequence[int] = SEED) -> Floats:
    """(n_nodes, 3) positions [m] with each coordinate of a free node moved by up to +-amplitude [m].

    A coordinate whose neighbouring floating-point numbers are further away than that moves by its last bit.
    """
    shift = np.random.default_rng(seed).uniform(-amplitude, amplitude, position.shape)
    if amplitude > 0.0:
        last_bit = np.spacing(np.abs(position))
        shift = np.where(last_bit > amplitude, np.copysign(last_bit, shift), shift)
    shift[net.fixed_nodes] = 0.0
    return position + shift


def perturbed_bodies(start: Start, amplitude: float, seed: int | Sequence[int] = SEED) -> RigidStates:
    """States of the bodies: each free one moved by up to +-amplitude [m] along each axis, turned by up to as
    many radians about each, and turning faster by up to as many rad/s.
    """
    states, free = start.state.bodies, start.system.moves_freely[:, None]
    shift = np.random.default_rng(seed).uniform(-amplitude, amplitude, (3, len(free), 3)) * free
    return RigidStates(
        states.position + shift[0],
        states.velocity,
        product(states.attitude, quaternion_of(shift[1])),
        states.angular_velocity + shift[2],
    )


@takes(start=Start)
def perturbed_positions(start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0) -> Floats:
    """(runs, n_nodes, 3) initial positions, each coordinate of free nodes moved by up to +-amplitude [m].

    first : number of the first of the runs
    Run k gets the same perturbation however many runs there are. Raises InputError for a number of runs, a
    seed or an amplitude that is out of range.
    """
    require_whole_number("runs", runs, at_least=0)
    require_whole_number("seed", seed, at_least=0)
    require_whole_number("first", first, at_least=0)
    require_length("amplitude", amplitude)
    found = [
        perturbed(start.net, start.position, amplitude, (seed, run)) for run in range(first, first + runs)
    ]
    return np.array(found).reshape(-1, *start.position.shape)


def perturbed_bodies_of(
    start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0
) -> RigidStates | None:
    """The bodies beside `perturbed_positions`, with a leading axis of runs; None of a scene without bodies.

    amplitude : [m], and of their attitudes and angular velocities [rad], [rad/s]
    """
    if not start.system.bodies or not runs:
        return None
    found = [perturbed_bodies(start, amplitude, (seed, run, 1)) for run in range(first, first + runs)]
    return RigidStates(*(np.stack(parts) for parts in zip(*(item.parts() for item in found), strict=True)))


def require_whole_number(name: str, given: object, at_least: int) -> None:
    """Raise InputError for an argument that is not a whole number, or too small a one."""
    if isinstance(given, bool) or not isinstance(given, Integral) or given < at_least:
        raise InputError(f"{name}: must be a whole number, {at_least} or more, got {given!r}")


def require_length(name: str, given: object) -> None:
    """Raise InputError for an argument that is not a length, or a negative one."""
    if isinstance(given, bool) or not (isinstance(given, Real) and 0.0 <= float(given) < float("inf")):
        raise InputError(f"{name}: must be a finite number of metres, 0 or more, got {given!r}")


def nearby_start(start: Start, part: float = MOVE, seed: int = SEED) -> Start:
    """The start with its positions moved by up to a part of the net's size."""
    net = start.net
    return start.moved(perturbed(net, start.position, part * net.size, seed))


def of_other_accuracy(plan: Plan) -> Plan:
    """A finer plan; a coarser one where round-off leaves nothing to gain."""
    if found := finer(plan):
        return found
    assert plan.tolerance is not None  # there is always a shorter step
    return replace(plan, tolerance=plan.tolerance / FINER_TOLERANCE)


def of_much_other_accuracy(plan: Plan) -> Plan:
    """Two steps finer, or coarser where round-off leaves nothing to gain.

    Errors at kinks of the forces scatter by two decades at one tolerance, so
    that a run with a tenth of it often errs as much, and nothing follows from the difference of the two.
    """
    other = of_other_accuracy(plan)
    return finer(other) or other


def tracked_speeds(net: Net, velocity: Floats) -> Floats:
    """(..., k) speeds [m/s] of the bullets, or of all nodes without bullets; velocity (..., n_nodes, 3)."""
    nodes = net.bullet_nodes if len(net.bullet_nodes) else np.arange(net.n_nodes)
    return np.asarray(np.linalg.norm(velocity[..., nodes, :], axis=-1))
