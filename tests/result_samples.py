"""Small results made by hand, for the tests of result, metrics and plot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.run_events import ElementBreak, ScriptEvent
from exunet.bodies.shapes import Shape, Solid, packed
from exunet.forces import cable, law
from exunet.forces.contact.status import ContactKey
from exunet.net.arrays import Net
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.run_record import RunRecord

Floats = NDArray[np.float64]

STEEL = {"area": 1e-6, "youngs_modulus": 2e11, "density": 7800.0}


def net(
    position: Any,
    elements: Any,
    bullets: tuple[int, ...] = (),
    faces: tuple[tuple[int, ...], ...] = (),
    mouth: tuple[int, ...] = (),
    strings: tuple[int, ...] = (),
) -> Net:
    """A net of thin steel cables: lumped masses by eq. (9), half a kilogram more for each bullet."""
    position, elements = np.array(position, float), np.array(elements, int).reshape(-1, 2)
    length = np.linalg.norm(position[elements[:, 1]] - position[elements[:, 0]], axis=1)
    mass = np.zeros(len(position))
    np.add.at(mass, elements.ravel(), np.repeat(STEEL["density"] * STEEL["area"] * length / 2, 2))
    mass[list(bullets)] += 0.5
    is_string = np.zeros(len(elements), bool)
    is_string[list(strings)] = True
    return Net(
        reference_position=position,
        mass=mass,
        element_nodes=elements,
        reference_length=length,
        is_string=is_string,
        bullet_nodes=np.array(bullets, int),
        fixed_nodes=np.array([], int),
        faces=faces,
        mouth=mouth,
        **{name: np.full(len(elements), value) for name, value in STEEL.items()},
    )


def square_net(cells: int = 1, size: float = 1.0, strings: bool = False) -> Net:
    """A square net in z = 0 with its bullets at the corners, or on strings that reach 1.4 times as far."""
    side = np.linspace(-size / 2, size / 2, cells + 1)
    knots = [(x, y, 0.0) for y in side for x in side]
    at = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    sides = [*zip(at[:, :-1].flat, at[:, 1:].flat, strict=True), *zip(at[:-1].flat, at[1:].flat, strict=True)]
    loops = zip(at[:-1, :-1].flat, at[:-1, 1:].flat, at[1:, 1:].flat, at[1:, :-1].flat, strict=True)
    faces = tuple(tuple(map(int, loop)) for loop in loops)
    corners = tuple(map(int, (at[0, 0], at[0, -1], at[-1, -1], at[-1, 0])))
    if not strings:
        return net(knots, sides, bullets=corners, faces=faces, mouth=corners)
    ends = [tuple(1.4 * c for c in knots[corner]) for corner in corners]
    tips = range(len(knots), len(knots) + 4)
    sides += zip(corners, tips, strict=True)
    return net(
        knots + ends,
        sides,
        bullets=tuple(tips),
        faces=faces,
        mouth=corners,
        strings=tuple(range(len(sides) - 4, len(sides))),
    )


def result(of: Net, time: Any, position: Any, velocity: Any = None, **changes: Any) -> Result:
    """A result with these states; the energies and forces that belong to them, no damping, no loads."""
    time, position = np.array(time, float), np.array(position, float)
    velocity = np.zeros_like(position) if velocity is None else np.array(velocity, float)
    length = cable.lengths(of, position)
    whole = Result(
        net=of,
        time=time,
        position=position,
        velocity=velocity,
        strain=law.green_lagrange_strain(length, of.reference_length),
        tension=law.tension(length, of.reference_length, of.axial_stiffness),
        kinetic=0.5 * np.einsum("n,tnk,tnk->t", of.mass, velocity, velocity),
        elastic=cable.elastic_energy(cable.AxialLaw.of(of), length),
        potential=np.zeros(len(time)),
        dissipated=np.zeros(len(time)),
        momentum=np.einsum("n,tnk->tk", of.mass, velocity),
        angular_momentum=np.einsum("n,tnk->tk", of.mass, np.cross(position, velocity)),
    )
    return replace(whole, **changes)


def unfolding(of: Net, times: int = 7, lift: float = 0.0, **changes: Any) -> Result:
    """A net that grows evenly from a tenth of its reference configuration to the whole of it within 1 s.

    `lift` bends it out of its plane meanwhile [m].
    """
    time = np.linspace(0, 1, times)
    reference = of.reference_position
    position = (0.1 + 0.9 * time)[:, None, None] * reference
    position[..., 2] += lift * time[:, None] * (reference**2).sum(axis=1)
    velocity = np.broadcast_to(0.9 * reference, position.shape)
    return result(of, time, position, velocity, **changes)


TENSION = np.abs(np.sin(np.arange(7 * 16))).reshape(7, 16) * (np.arange(16) > 3)  # N; four threads are slack


RESULTANT = np.array([0.3, -0.4, 1.2])  # N, 1.3 of size


def around_a_box(title: str = "a net", body: str = "box") -> Result:
    """A net of 2 x 2 meshes with strings around a turning box: contact, event, break, closing line."""
    of = unfolding(square_net(cells=2, strings=True), lift=0.4)
    shape = Shape((Solid("box", (0.2, 0.3, 0.4)),), edge_radius=0.05)
    turn = np.linspace(0.0, 1.0, 7)
    attitude = np.stack([np.cos(turn / 2), 0 * turn, np.sin(turn / 2), 0 * turn], axis=1)
    place, still = of.position[:, 4] + np.array([0.0, 0.0, 0.1]), np.zeros((7, 3))
    states = BodyStates(2.0, np.eye(3), place, still, attitude, still, **packed(shape, np.zeros(3)))
    touching = (turn > 0.5).astype(float)[:, None]
    note = ScriptEvent(time_s=0.5, entry="meets", event="note", cause="t", done=True)
    events, path = (note, ElementBreak(element=5, time_s=0.8)), [0, 2, 8, 6, 0]
    record = RunRecord(title=title, events=events, can_break=True, closing_path=path, edge_radii={body: 0.05})
    return replace(
        of,
        tension=TENSION,
        bodies={body: states},
        contacts={
            ContactKey(body, "threads", "first"): TermStates("s", 0.6 * touching - (1.0 - touching)),
            ContactKey(body, "threads", "deepest"): TermStates("m", 0.0 * touching),
            ContactKey(body, "threads", "touching"): TermStates("1", 3.0 * touching),
            ContactKey(body, "threads", "force"): TermStates("N", 1.5 * touching),
            ContactKey(body, "threads", "resultant"): TermStates("N", turn[:, None] * RESULTANT * touching),
            ContactKey(body, "threads", "torque"): TermStates("N m", [0.05, -0.02, 0.01] * touching),
        },
        states={
            "closing/largest": TermStates("N", 2.5 * touching),
            "closing/largest_time": TermStates("s", 0.75 * touching),
            "closing/tension_start": TermStates("N", 2.0 * touching),
            "closing/tension_end": TermStates("N", 1.0 * touching),
        },
        run=record,
    )
