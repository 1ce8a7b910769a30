"""Headlines of contacts of the net and of a capture, and what became of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.capture import Measures
from exunet.results.course import CONTACT, SELF, TOUCHING, Course
from exunet.results.headline import COUNT, Headline
from exunet.results.verdict import Found, Outcome, conditions, found

Floats = NDArray[np.float64]

_LEAST = 1e-8  # what moves of 1e-9 m do themselves
_OF_THE_COUNT = 1e-3  # to which an enclosed part is known, see `exunet.results.capture.POINTS`
_NOT_YET = -1.0  # the time of a first touch


def bodies_with_contacts(course: Course) -> tuple[str, ...]:
    """The bodies whose contacts with the net are stored."""
    found = (name.removeprefix(CONTACT).rpartition("/") for name in course.contact)
    return tuple(dict.fromkeys(body for body, _, series in found if series.startswith(TOUCHING)))


def _series(course: Course, body: str, quantity: str) -> list[Floats]:
    """(t,) of threads, of nodes and of bullets, as far as they touch the body."""
    names = (f"{CONTACT}{body}/{what}_{quantity}" for what in TOUCHING)
    return [course.contact[name] for name in names if name in course.contact]


def first_contact(course: Course, body: str) -> float | None:
    """When the net first touched a body [s]; None: it did not."""
    times = [float(item[-1]) for item in _series(course, body, "first") if item[-1] != _NOT_YET]
    return min(times, default=None)


def of_contact(body: str) -> tuple[Headline, ...]:
    """When the net first touched a body, how deep, and how many elements, nodes and bullets at once."""

    def deepest(course: Course) -> float | None:
        if first_contact(course, body) is None:
            return None
        return max(float(item[-1]) for item in _series(course, body, "deepest"))

    def most(course: Course) -> float | None:
        if first_contact(course, body) is None:
            return None
        return float(np.sum(_series(course, body, "touching"), axis=0).max())

    def force(course: Course) -> float | None:
        if first_contact(course, body) is None:
            return None
        return float(np.sum(_series(course, body, "force"), axis=0).max())

    key = f"contact_{body}"
    return (
        Headline(
            f"{key}_first",
            f"first contact with {body}",
            "s",
            lambda course: first_contact(course, body),
            at_a_step=True,
        ),
        Headline(
            f"{key}_deepest",
            f"deepest in {body}",
            "m",
            deepest,
            least=_LEAST,
            remark="surface in surface, of all steps",
        ),
        Headline(
            f"{key}_most_touching",
            f"most that touch {body}",
            "",
            most,
            least=COUNT,
            remark="elements, nodes and bullets, of the stored times",
        ),
        Headline(
            f"{key}_largest_force",
            f"largest force on {body}",
            "N",
            force,
            remark="sum across the surface, of the stored times",
        ),
    )


def _of_threads(quantity: str) -> Callable[[Course], float | None]:
    """Of threads that touch each other; None where none ever did."""

    def value(course: Course) -> float | None:
        if not course.together or course.together[f"{SELF}first"][-1] == _NOT_YET:
            return None
        series = course.together[SELF + quantity]
        return float(series[-1] if quantity in ("first", "deepest") else series.max())

    return value


OF_SELF_CONTACT = (
    Headline(
        "self_contact_first", "first contact of threads", "s", _of_threads("first"), at_a_step=True
    ),
    Headline(
        "self_contact_deepest", "deepest overlap of threads", "m", _of_threads("deepest"), least=_LEAST,
        remark="surface in surface, of all steps",
    ),
    Headline(
        "self_contact_most_touching", "most pairs of elements that touch", "", _of_threads("touching"),
        least=COUNT, remark="of the stored times",
    ),
    Headline(
        "self_contact_largest_force", "largest force between threads", "N", _of_threads("force"),
        remark="sum over all pairs, of the stored times",
    ),
)  # fmt: skip


def outcome(course: Course) -> Found | None:
    """What became of the target; None without a rule."""
    if course.rule is None or course.capture is None:
        return None
    touching = _series(course, course.rule.target, "touching")[:1] or [np.zeros(len(course.time))]
    touched = first_contact(course, course.rule.target) is not None
    return found(course.rule, course.time, course.capture, touching[0], touched=touched)


def outcomes(courses: Sequence[Course]) -> dict[str, int]:
    """How often what became of it, the most frequent first."""
    every = [one.outcome for course in courses if (one := outcome(course)) is not None]
    return {name.value: number for name, number in Counter(every).most_common()}


def told(course: Course) -> dict[str, Any] | None:
    """What became of a run's target, for summary.json; None without a rule."""
    one = outcome(course)
    if one is None or course.rule is None or course.capture is None:
        return None
    touching = _series(course, course.rule.target, "touching")[:1] or [np.zeros(len(course.time))]
    holding = conditions(course.rule, course.capture, touching[0])
    return {
        "outcome": one.outcome.value,
        "since_s": one.since,
        "duration_s": course.rule.duration,
        "target": course.rule.target,
        "conditions": {_with_unit(name): getattr(course.rule, name) for name in holding},
        "hold_at_end": {_with_unit(name): bool(values[-1]) for name, values in holding.items()},
    }


def _with_unit(condition: str) -> str:
    """Its key in summary.json."""
    unit = {"relative_speed": "_m_s", "relative_spin": "_rad_s", "mouth": "_m"}
    return condition + unit.get(condition, "")


def _capture_time(course: Course) -> float | None:
    one = outcome(course)
    return one.since if one is not None and one.outcome is Outcome.CAPTURED else None


def _at_end(quantity: str) -> Callable[[Course], float | None]:
    def value(course: Course) -> float | None:
        return None if course.capture is None else float(getattr(course.capture, quantity)[-1])

    return value


_MEASURES = {  # words, unit, remark, least
    "enclosed": ("part enclosed", "", "of the target's volume, in the convex hull of the net", _OF_THE_COUNT),
    "cqi": ("capture quality index", "", "less is better", _LEAST),
    "mcqi": ("modified index", "", "less is better", _OF_THE_COUNT),
    "mouth": ("diameter of the mouth", "m", "largest distance of two nodes of its rim", _LEAST),
    "relative_speed": ("relative speed", "m/s", "of the centres of net and target", _LEAST),
    "relative_spin": ("relative spin", "rad/s", "of net and target", _LEAST),
}
assert tuple(_MEASURES) == Measures._fields

OF_A_CAPTURE = (
    Headline("capture_time", "captured from", "s", _capture_time, at_a_time=True),
    *(
        Headline(
            f"capture_{name}",
            f"{words} at the end",
            unit,
            _at_end(name),
            least=least,
            remark=remark,
        )
        for name, (words, unit, remark, least) in _MEASURES.items()
    ),
)


def headlines_of_capture(course: Course) -> tuple[Headline, ...]:
    """Those of the contacts and of the capture of a scene."""
    contacts = [item for body in bodies_with_contacts(course) for item in of_contact(body)]
    together = OF_SELF_CONTACT if course.together else ()
    return (*contacts, *together, *(OF_A_CAPTURE if course.rule is not None else ()))
