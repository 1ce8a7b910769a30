"""From a scene to the system and its state at the start: net, bodies, forces, what moves how."""

from __future__ import annotations

import numpy as np

from exunet.base.errors import Fault
from exunet.case.scene import Scene
from exunet.forces.blocks import Blocks
from exunet.forces.effects import first_order_states, forces_of, point_masses
from exunet.net import weave
from exunet.system.initial import bodies_at_start, common_velocity, initial_state
from exunet.system.system import State, System


def system_of(scene: Scene, faults: list[Fault]) -> tuple[System, State]:
    """Weave the net, add the bodies, and sum the forces of the effects that are on; the state at t = 0.

    faults : takes what is wrong with the bodies and the effects, which does not hide other faults
    Raises CaseError if there is no net.
    """
    net = weave(scene.net)
    position, velocity = initial_state(scene, net)
    rigid = tuple(scene.bodies)
    blocks = Blocks.of(net, position, point_masses(scene.effects), rigid, first_order_states(scene.effects))
    places = blocks.position[net.n_nodes :]
    velocity = np.concatenate([velocity, common_velocity(scene.initial, places)])
    bodies, moving = bodies_at_start(scene, faults)
    words = "an effect brings a point mass of this name (launch_force: chaser): name the body otherwise"
    faults += [Fault(f"bodies.{name}", words) for name in scene.bodies if name in blocks.body]
    system = System(blocks, forces_of(scene.effects, blocks, faults), bodies)
    return system, State(0.0, blocks.position, velocity, moving, dict(system.memory), blocks.initial_states)
