"""Status of a contact: extremes behind the rows of pairs in the discrete state, limits that stop a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces.cores import Surface
from exunet.forces.terms import DiscreteState, Series


class ContactStatus(NamedTuple):
    """Status of a contact at the end of an accepted step, in the order of the discrete state.

    depth, depth_time, depth_pair : largest depth so far [m], when [s], number of the pair
    first_touch : when something touched first [s]; -1.0: not yet
    wrong, wrong_time, wrong_pair : what has gone wrong (see `trouble`), when [s], with which pair
    most        : most pairs that touched at once
    time        : the end of the step [s]
    touching    : how many pairs touch
    force       : sum of the forces across the surface [N]
    stored      : energy that they store [J]
    force_x ... : resultant of all forces on the body [N], and their torque about its centre of mass [N m] in
                  its own axes; zeros of threads among each other
    """

    depth: float
    depth_time: float
    depth_pair: float
    first_touch: float
    wrong: float
    wrong_time: float
    wrong_pair: float
    most: float
    time: float
    touching: float
    force: float
    stored: float
    force_x: float = 0.0
    force_y: float = 0.0
    force_z: float = 0.0
    torque_x: float = 0.0
    torque_y: float = 0.0
    torque_z: float = 0.0


OF_BODY = "body_"  # before the name of a body, in place of what else touches one
THREADS, NODES, BULLETS = TOUCHING = ("threads", "nodes", "bullets")  # of the net, which may touch a body


@dataclass(frozen=True)
class ContactKey:
    """Key of a series of a contact; its text is the name in tables and files.

    body      : touched body
    other     : one of `TOUCHING`, or the name of another body
    quantity  : such as "force"
    of_bodies : True if the other is a body
    """

    body: str
    other: str
    quantity: str
    of_bodies: bool = False

    def __str__(self) -> str:
        return f"contact_{self.body}/{OF_BODY * self.of_bodies}{self.other}_{self.quantity}"


STATUS = len(ContactStatus._fields)
_SERIES = {  # fields of the status: name of the series, units
    "touching": ("touching", "1"),
    "force": ("force", "N"),
    "stored": ("stored", "J"),
    "depth": ("deepest", "m"),
    "first_touch": ("first", "s"),
}
_VECTORS = {"force_x": ("resultant", "N"), "torque_x": ("torque", "N m")}  # three numbers from there on


def status_of(values: Floats) -> ContactStatus:
    """The status in a discrete state."""
    return ContactStatus(*values[-STATUS:].tolist())


def untouched(pairs: Floats) -> Floats:
    """A discrete state of these rows, before anything has touched."""
    status = ContactStatus(*np.zeros(STATUS))._replace(first_touch=-1.0)
    return np.concatenate([pairs.ravel(), status])


def discrete_state_of(
    other: str, body: str, kept: Floats, wrong: Callable[[Floats], str], *, of_bodies: bool = False
) -> DiscreteState:
    """The discrete state of the contact of threads, of bullets, or of another body with a body."""
    series = tuple(
        Series(ContactKey(body, other, name, of_bodies), unit, _place(field), size)
        for size, quantities in ((1, _SERIES), (3, _VECTORS))
        for field, (name, unit) in quantities.items()
    )
    name = f"contact/{OF_BODY * of_bodies}{other}/{body}"
    return DiscreteState(name, kept, kept_in="kept", wrong=wrong, series=series)


def series_of(begin: str) -> tuple[Series, ...]:
    """Return the series that are stored of a status; their names start with `begin`."""
    return tuple(Series(begin + name, units, _place(field)) for field, (name, units) in _SERIES.items())


def _place(field: str) -> int:
    """Return where a field of the status stands, from the end of a discrete state."""
    return ContactStatus._fields.index(field) - STATUS


TOO_DEEP, TOO_FAST, UNSEEN = 1.0, 2.0, 3.0


class TooFast(str):
    """Message of a contact that a step may have passed through: smaller steps see it."""


def trouble(
    values: Floats,
    surface: Surface,
    body: str,
    what: str,
    numbers: NDArray[np.int64],
    beyond_radius: float | None = None,
) -> str:
    """Return the error message of a discrete state; "": no error.

    what, numbers : name of what touches the body, and its number in each pair
    beyond_radius : how much deeper than by its radius it may be [m]; None: as the surface allows
    """
    status = status_of(values)
    wrong, when = status.wrong, f"at t = {status.wrong_time:.6g} s"
    if not wrong:
        return ""
    name = f"{what} {numbers[int(status.wrong_pair)]}"
    if wrong == TOO_DEEP and beyond_radius is not None and beyond_radius < surface.allowed:
        return (
            f"{name} is deeper than {2.0 * surface.least:.3g} m in {body}, the body's least "
            f"thickness, {when}: it comes out on the other side. Make contact stiffer, or its radius smaller"
        )
    if wrong == TOO_DEEP:
        return (
            f"{name} is deeper than {surface.allowed:.3g} m in {body} {when}: it may come out on "
            f"the other side of an edge, or of the body. Make contact stiffer, elements shorter (divisions), "
            f"steps smaller, or bodies.{body}.edge_radius larger"
        )
    if wrong == TOO_FAST:
        return TooFast(
            f"{name} near {body} moves by more than {surface.least:.3g} m, half of the body's "
            f"least thickness, in the step that ends {when}, and may pass through unseen. Give smaller steps "
            f"(solver.step, or a smaller solver.tolerance)"
        )
    if wrong == UNSEEN:
        return TooFast(
            f"{name} came to {body} faster than contact looks for it, {when}. Give smaller steps, "
            f"or look for what accelerates it so much"
        )
    return ""


def trouble_of_bodies(values: Floats, presses: str, touched: str, allowed: float, least: float) -> str:
    """Return the error message of the discrete state of two bodies; "": no error.

    allowed : depth beyond which nothing may be [m]; least : half of the least thickness of both [m]
    """
    status = status_of(values)
    when = f"at t = {status.wrong_time:.6g} s"
    if status.wrong == TOO_DEEP:
        return (
            f"{presses} is deeper than {allowed:.3g} m in {touched} {when}: it may come out on the other "
            f"side of an edge, or of the body. Make effects.contact.body_stiffness or modulus larger, steps "
            f"smaller, or edge_radius of bodies.{presses} or bodies.{touched} larger"
        )
    if status.wrong == TOO_FAST:
        return TooFast(
            f"{presses} near {touched} may move by more than {least:.3g} m, half of the least thickness of "
            f"both, in the step that ends {when}, and may pass through unseen. Give smaller steps "
            f"(solver.step, or a smaller solver.tolerance)"
        )
    return ""
