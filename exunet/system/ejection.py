"""A packed net that a body holds until it is ejected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import rotation_matrix
from exunet.forces.blocks import Blocks
from exunet.forces.held import Held
from exunet.forces.terms import Change, Constraint, Memories, Memory
from exunet.net.arrays import Net
from exunet.system.bodies import BodiesAtStart
from exunet.system.carried import NetAxes, gained_by_net
from exunet.system.exchange import exchanged
from exunet.system.system import Layout

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HELD = "net/held"  # the memory of it
NODES, LET_GO = 0, 1  # in it: how many nodes are held, and 1.0 once a script lets them go


def holding(axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats) -> BodiesAtStart:
    """The bodies, of which the one that carries the net holds its nodes where they are packed.

    position : (n, 3) of the net's nodes, in the scene's axes [m]
    Nodes that are attached to bodies are left to these.
    """
    assert axes.body is not None
    nodes = np.setdiff1d(np.arange(len(position)), rigid.kinematics.tied)
    states = rigid.states
    turn = rotation_matrix(states.attitude[axes.body])
    arms = (position[nodes] - states.position[axes.body]) @ turn
    held = Held(HELD, len(nodes), nodes, axes.body, arms, net.mass[nodes])
    kinematics = replace(rigid.kinematics, held=(*rigid.kinematics.held, held))
    return replace(rigid, kinematics=kinematics)


def ejecting(
    constraint: Constraint | None,
    time: float,
    axes: NetAxes,
    rigid: BodiesAtStart,
    blocks: Blocks,
    speed: Floats,
) -> Constraint:
    """The constraint that lets the net go at a time [s]; infinite: when a script says so.

    speed : (n, 3) velocities of the net's nodes relative to the body, in the net's axes [m/s]
    """
    assert constraint is not None
    assert axes.body is not None
    (held,) = (one for one in rigid.kinematics.held if one.memory == HELD)
    in_body = rotation_matrix(rigid.states.attitude[axes.body]).T @ axes.turn
    added = speed[held.points] @ in_body.T
    switch = Ejection(time, held, added, blocks, rigid.kinematics)
    return replace(constraint, memory=Memory(HELD, np.array([float(held.start), 0.0])), switch=switch)


@dataclass(frozen=True, eq=False)
class Ejection:
    """The nodes get velocities beside those that they have with the body, which gives them their momenta.

    time  : [s]; infinite: when a script says so
    held  : the nodes
    added : (n, 3) these velocities, in the body's principal axes [m/s]
    """

    time: float
    held: Held
    added: Floats
    blocks: Blocks
    kinematics: Kinematics
    heading = "ejection"

    @property
    def times(self) -> tuple[float, ...]:
        """When it happens [s]."""
        return (self.time,)

    def in_steps(self, memory: Floats) -> bool:
        """The time is known."""
        return False

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """The only item, from its time on."""
        return np.flatnonzero([(time >= self.time or memory[LET_GO] > 0.0) and memory[NODES] > 0.0])

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """Steps end at known times anyway."""
        return step

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """Momentum and angular momentum stay; what all energy changes by is the work of the ejection."""
        layout, nodes = Layout(self.blocks), self.held.points
        moving = layout.unpack(x.copy(), v.copy()).completed(self.kinematics, time, every)
        turn, before = rotation_matrix(moving.bodies.attitude[self.held.body]), moving.velocity.copy()
        thrown = moving.velocity[nodes] + self.added @ turn.T
        after = np.zeros(2)
        points = moving.position[nodes], -self.held.mass[:, None] * thrown
        both = every, {**every, HELD: after}
        moved = exchanged(moving, self.blocks, self.kinematics, self.held.body, both, points)
        moved.velocity[nodes] = thrown
        moved = moved.completed(self.kinematics, time, both[1])
        x, v = layout.pack(moved)
        every_node = slice(self.blocks.net.n_nodes)
        net = (
            values[every_node] for values in (self.blocks.own_mass, moved.position, before, moved.velocity)
        )
        body = self.blocks.rigid[self.held.body]
        event = {"time_s": time, "nodes": len(nodes), "body": body, **gained_by_net(*net)}
        return Change(after, None, (event,), x=x, v=v)
