"""Perturbed runs: another start or another accuracy of a scene, and the speeds that are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

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


def launch_speed(velocity: Floats) -> float:
    """Largest speed [m/s] of a node with the velocities (n_nodes, 3), the unit of errors; 1 at rest."""
    return float(np.linalg.norm(velocity, axis=1).max(initial=0.0)) or 1.0


def tracked_speeds(net: Net, velocity: Floats) -> Floats:
    """(..., k) speeds [m/s] of the bullets, or of all nodes without bullets; velocity (..., n_nodes, 3)."""
    nodes = net.bullet_nodes if len(net.bullet_nodes) else np.arange(net.n_nodes)
    return np.asarray(np.linalg.norm(velocity[..., nodes, :], axis=-1))
