"""Rows of `exunet check` that describe bodies: mass, centre, principal axes, start, what is fixed to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import in_frames
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.cores import SAMPLED
from exunet.simulation.preparation import Start

Floats = NDArray[np.float64]

_ROUND_OFF = 1e-12  # of the largest of some numbers, below which one of them is zero
_NOTHING = 1e-15  # [m], [m/s], [rad/s], below which all are


def body_rows(start: Start) -> list[tuple[str, str]]:
    """Four rows for each rigid body, one more for each mesh that is touched, one for each point mass."""
    system, state = start.system, start.state
    found, states = [], in_frames(system.bodies, state.bodies)
    for k, body in enumerate(system.bodies):
        name, spin = body.name, states.angular_velocity[k]
        moments = ", ".join(f"{moment:g}" for moment in body.inertia)
        axes = ", ".join(map(vector, np.round(body.rotation.T, 6)))
        moving = _motion(states.position[k], states.velocity[k])
        in_scene = vector(rotation_matrix(states.attitude[k]) @ spin)
        found += [
            (f"body {name}", f"{body.mass:g} kg, {start.scene.bodies[name].motion}{_attached(start, k)}"),
            (f"{name}: centre of mass", f"at {vector(np.array(body.centre))} m in the body's frame"),
            (
                f"{name}: inertia",
                f"{moments} kg m2 about the centre of mass and the principal axes {axes} of the body's frame",
            ),
            (
                f"{name}: at the start",
                f"centre of mass {moving}; turns at {vector(spin)} rad/s in the body's axes, "
                f"{in_scene} rad/s in the scene's",
            ),
        ]
    for name, surface in system.blocks.surfaces.items():
        if surface.cores.kind[0] == SAMPLED:
            cores, size = surface.cores, surface.cores.values.nbytes / 1024**2
            words = f"the distance is sampled each {cores.cell:.3g} m, {size:.3g} MB, and up to "
            found.append((f"{name}: contact", f"{words}{surface.error:.2g} m off"))
    for name, point in system.blocks.body.items():
        moving = _motion(state.position[point], state.velocity[point])
        found.append((f"point mass {name}", f"{system.blocks.mass[point]:g} kg, {moving}"))
    return found


def vector(values: Floats) -> str:
    """Numbers in brackets, without those that are round-off beside the others."""
    size = float(np.abs(values).max(initial=0.0))
    kept = np.where(np.abs(values) > max(_ROUND_OFF * size, _NOTHING), values, 0.0)
    return "(" + ", ".join(f"{value:g}" for value in kept) + ")"


def _attached(start: Start, body: int) -> str:
    """The nodes that are fixed to a body, whose mass is part of its own."""
    kinematics = start.system.kinematics
    nodes, words = kinematics.point[kinematics.body == body], ""
    if len(nodes):
        mass = float(start.net.mass[nodes].sum())
        words = f"; {mass:g} kg of it are nodes fixed to it: {', '.join(map(str, nodes.tolist()))}"
    ties = [one for one in kinematics.ties.values() if one.body == body and one.start]
    if ties:
        every = ", ".join(f"{one.points[0]} ({one.tie})" for one in ties)
        words += f"; fixed to it until a script releases them: node {every}"
    return words


def _motion(position: Floats, velocity: Floats) -> str:
    return f"at {vector(position)} m with {vector(velocity)} m/s in the scene's axes"
