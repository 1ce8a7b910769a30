"""Points that a body holds for a while, such as the nodes of a tether on a drum, and what their masses do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.forces.terms import Memories

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def tie_name(tie: str) -> str:
    """Of the memory that says whether a point is still held: 1.0, or 0.0 once it has been released."""
    return f"{tie}/held"


@dataclass(frozen=True, eq=False)
class Held:
    """Points that are fixed to a body as long as a memory says so.

    memory : its name; the first of its values is the number of points that are held, the first of these
    start  : that number at time 0
    points : (n,)
    body   : number among the rigid bodies
    arm    : (n, 3) of each from the centre of mass, in principal axes [m]
    mass   : (n,) of each [kg], which stays its own
    tie    : the attachment or the end of a tether that holds the point, by which a script releases it; "": of
             another kind
    """

    memory: str
    start: int
    points: Ints
    body: int
    arm: Floats
    mass: Floats
    tie: str = ""

    def number(self, memory: Memories) -> int:
        """How many are held at these memories; at the start without any."""
        return int(memory[self.memory][0]) if self.memory in memory else self.start


def held_by(every: Iterable[Held], body: int, memory: Memories) -> tuple[Floats, Floats]:
    """Masses (n,) [kg] and arms (n, 3) [m] of the points that a body holds at these memories."""
    own = [(one, one.number(memory)) for one in every if one.body == body]
    masses = [one.mass[:n] for one, n in own]
    arms = [one.arm[:n] for one, n in own]
    return np.concatenate([np.zeros(0), *masses]), np.concatenate([np.zeros((0, 3)), *arms])


def mass_matrix(mass: float, moments: Floats, held: Floats, arm: Floats) -> Floats:
    """(6, 6) of a body with masses fixed to it, for the acceleration of its centre and its angular one.

    mass, moments (3,) : of the body itself [kg], [kg m2]; held (n,) [kg] at arm (n, 3) [m], in principal axes

    Of momentum and angular momentum about the body's own centre of mass: the rows of
    sum m (a + alpha x p) and J alpha + sum m p x (a + alpha x p).
    """
    first = held @ arm
    across = np.array([[0.0, -first[2], first[1]], [first[2], 0.0, -first[0]], [-first[1], first[0], 0.0]])
    second = (held[:, None] * arm).T @ arm
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = (mass + held.sum()) * np.eye(3)
    matrix[:3, 3:] = -across
    matrix[3:, :3] = across
    matrix[3:, 3:] = np.diag(moments) + np.trace(second) * np.eye(3) - second
    return matrix
