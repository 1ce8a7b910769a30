"""Contacts of bodies with each other: which are stored, and their headlines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from exunet.forces.contact.status import OF_BODY
from exunet.results.clearance import Pair, pairs_of
from exunet.results.course import CONTACT, Course
from exunet.results.headline import Headline

Floats = NDArray[np.float64]

JOINED = "+"  # between the names of a pair; no name has it
_DEEPEST = "_deepest"
_LEAST = 1e-8  # what moves of 1e-9 m do themselves


def stored_pairs(names: Iterable[str]) -> tuple[Pair, ...]:
    """The pairs of bodies whose contact is stored, by the names of all that is stored of contacts.

    What one body presses into the other, and what the other into the one, are stored apart.
    """
    found: set[frozenset[str]] = set()
    for name in names:
        touched, _, series = name.removeprefix(CONTACT).rpartition("/")
        if name.startswith(CONTACT) and series.startswith(OF_BODY) and series.endswith(_DEEPEST):
            presses = series.removeprefix(OF_BODY).removesuffix(_DEEPEST)
            found.add(frozenset((presses, touched)))
    bodies = {name for pair in found for name in pair}
    return tuple(pair for pair in pairs_of(list(bodies)) if frozenset(pair) in found)


def _series(course: Course, pair: str, quantity: str) -> list[Floats]:
    """(t,) of each way of the bodies "one+other", as far as it is stored; none where they never touched."""
    one, other = pair.split(JOINED)
    found = []
    for presses, touched in ((one, other), (other, one)):
        begin = f"{CONTACT}{touched}/{OF_BODY}{presses}_"
        if f"{begin}first" in course.contact and course.contact[f"{begin}first"][-1] >= 0.0:
            found.append(course.contact[begin + quantity])
    return found


def of_touching_pair(pair: str) -> tuple[Headline, ...]:
    """When two bodies, "one+other", first touched, how deep, and how hard."""

    def first(course: Course) -> float | None:
        return min((float(item[-1]) for item in _series(course, pair, "first")), default=None)

    def deepest(course: Course) -> float | None:
        return max((float(item[-1]) for item in _series(course, pair, "deepest")), default=None)

    def force(course: Course) -> float | None:
        found = _series(course, pair, "force")
        return float(np.sum(found, axis=0).max()) if found else None

    words = pair.replace(JOINED, " and ")
    return (
        Headline(
            f"bodies_{pair}_first_contact",
            f"first contact of {words}",
            "s",
            first,
            at_a_step=True,
        ),
        Headline(
            f"bodies_{pair}_deepest",
            f"deepest contact of {words}",
            "m",
            deepest,
            least=_LEAST,
            remark="surface in surface, of all steps",
        ),
        Headline(
            f"bodies_{pair}_largest_force",
            f"largest force of {words}",
            "N",
            force,
            remark="sum across the surfaces, of the stored times",
        ),
    )
