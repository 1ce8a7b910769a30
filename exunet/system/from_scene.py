"""From a scene to the system and its state at the start: net, bodies, forces, what moves how."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exunet.base.errors import Fault
from exunet.case.scene import Scene
from exunet.forces.blocks import Blocks, Inertia
from exunet.forces.effects import breaking_limits, first_order_states, forces_of, point_masses
from exunet.net import weave
from exunet.net.arrays import Net
from exunet.net.tether import with_tethers
from exunet.system.bodies import bodies_at_start
from exunet.system.carried import carried
from exunet.system.initial import along_tethers, common_velocity, initial_state, kicks
from exunet.system.system import State, System


def system_of(scene: Scene, faults: list[Fault]) -> tuple[System, State]:
    """Weave the net, add the bodies, and sum the forces of the effects that are on; the state at t = 0.

    faults : takes what is wrong with the bodies and the effects, which does not hide other faults
    Raises CaseError if there is no net.
    """
    woven = weave(scene.net)
    net, tied = with_tethers(woven, scene.tethers)
    net = _with_strength(net, scene)
    rigid = bodies_at_start(scene, net, tied, faults)
    position, velocity = initial_state(scene, woven)
    if (frame := scene.initial.frame) is not None:
        position, velocity, rigid = carried(frame, rigid, net, position, velocity, kicks(scene, woven))
    room = np.zeros((net.n_nodes - woven.n_nodes, 3))
    position, velocity = np.concatenate([position, room]), np.concatenate([velocity, room])
    position, velocity, _ = rigid.kinematics.completed(np.array(0.0), position, velocity, rigid.states)
    faults += along_tethers(net, position, velocity)
    names = tuple(body.name for body in rigid.bodies)
    states = (*rigid.given, *first_order_states(scene.effects))
    inertia = Inertia(*rigid.free_inertia, rigid.kinematics.point)
    blocks = Blocks.of(net, position, point_masses(scene.effects), names, states, inertia)
    places = blocks.position[net.n_nodes :]
    velocity = np.concatenate([velocity, common_velocity(scene.initial, places)])
    words = "an effect brings a point mass of this name (launch_force: chaser): name the body otherwise"
    faults += [Fault(f"bodies.{name}", words) for name in scene.bodies if name in blocks.body]
    forces = replace(forces_of(scene.effects, blocks, faults), constraint=rigid.kinematics.term(blocks))
    system = System(blocks, forces, rigid.bodies, rigid.kinematics)
    memory = dict(system.memory)
    return system, State(0.0, blocks.position, velocity, rigid.states, memory, blocks.initial_states)


def _with_strength(net: Net, scene: Scene) -> Net:
    """The net that knows at what force its elements break, where the case does not state what they bear."""
    limits = breaking_limits(scene.effects, net)
    if limits is None:
        return net
    strength = limits if net.strength is None else np.where(net.strength > 0.0, net.strength, limits)
    strength.flags.writeable = False
    return replace(net, strength=strength)
