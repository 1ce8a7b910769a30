"""Headlines of what damping and friction of contacts and of a closing line have taken: lines of the books."""

from __future__ import annotations

from exunet.results.course import Course
from exunet.results.headline import Headline
from exunet.results.taken import TAKEN

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


OF_TAKEN = tuple(_by(name, words) for name, words in TAKEN.items())


def headlines_of_taken(course: Course) -> tuple[Headline, ...]:
    """Those of what a scene has."""
    return tuple(one for name, one in zip(TAKEN, OF_TAKEN, strict=True) if name in course.taken_names)
