"""Headlines of what contacts store, and what they and a closing line have taken: lines of the books."""

from __future__ import annotations

from exunet.results.course import Course
from exunet.results.headline import Headline
from exunet.results.taken import TAKEN, stored_over_time

_LEAST = 1e-8  # J, as of the other entries
_OF_BOOK = 1e-3  # part of what is dissipated that an entry is small against


def _by(name: str, words: str) -> Headline:
    """What has been taken until the end, of the energy dissipated."""

    def value(course: Course) -> float | None:
        if name not in course.taken_names:
            return None
        return float(course.taken[-1, course.taken_names.index(name)])

    return Headline(
        f"taken_by_{name.replace('/', '_')}",
        f"taken by {words}",
        "J",
        value,
        size=lambda course: _OF_BOOK * abs(float(course.dissipated[-1])),
        remark="of the energy dissipated",
        least=_LEAST,
        of_book=True,
    )


def _stored(course: Course) -> float | None:
    stored = stored_over_time({**course.contact, **course.together})
    return None if stored is None else float(stored[-1])


STORED_IN_CONTACT = Headline(
    "stored_in_contact",
    "stored in contact",
    "J",
    _stored,
    size=lambda course: _OF_BOOK * float(abs(course.potential).max(initial=0.0)),
    remark="at the end, of the potential energy",
    least=_LEAST,
    of_book=True,
)
_TAKEN = tuple(_by(name, words) for name, words in TAKEN.items())
OF_TAKEN = (STORED_IN_CONTACT, *_TAKEN)


def headlines_of_taken(course: Course) -> tuple[Headline, ...]:
    """Those of what a scene has."""
    taken = [one for name, one in zip(TAKEN, _TAKEN, strict=True) if name in course.taken_names]
    return (*(STORED_IN_CONTACT,) * bool(course.contact or course.together), *taken)
