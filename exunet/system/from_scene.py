"""From a scene to the system and its state at the start: net, bodies, forces, what moves how."""

from __future__ import annotations

import numpy as np

from exunet.base.errors import Fault
from exunet.case.scene import Scene
from exunet.forces.effects import forces_of, point_masses
from exunet.forces.points import Points
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
    points = Points.of(net, position, point_masses(scene.effects))
    places = points.position[net.n_nodes :]
    velocity = np.concatenate([velocity, common_velocity(scene.initial, places)])
    bodies, moving = bodies_at_start(scene)
    words = "an effect brings a point mass of this name (launch_force: chaser): name the body otherwise"
    faults += [Fault(f"bodies.{name}", words) for name in scene.bodies if name in points.body]
    system = System(points, forces_of(scene.effects, points, faults), bodies)
    return system, State(0.0, points.position, velocity, moving, dict(system.memory))
