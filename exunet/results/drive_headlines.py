"""The headlines of what is wound up: reels with their tethers, a closing line with its winch."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from exunet.net.closing import NAME as LINE_NAME
from exunet.results.course import LINE, REEL_STATES, Course
from exunet.results.headline import Headline
from exunet.results.taken import TAKEN, stored_over_time


def of_reel(name: str) -> tuple[Headline, Headline]:
    """How much of a tether is wound up at the end, and the work that its drum has done."""
    return wound_up(name), reel_work(name)


def wound_up(name: str) -> Headline:
    """The length [m] of a tether on its drum at the end, or that of the closing line that is wound up."""
    value = partial(_of_drum, name, REEL_STATES.index("wound_up"))
    key, words = f"tether_{name}_wound_up", f"length of {name} on the drum"
    if name == LINE_NAME:
        key, words = f"{name}_wound_up", "length of the closing line wound up"
    return Headline(key, words, "m", value, least=1e-9, remark="at the end")


def reel_work(name: str) -> Headline:
    """The work [J] that the reel of a tether has done on it, or the winch on the closing line."""
    value = partial(_of_drum, name, REEL_STATES.index("work"))
    if name == LINE_NAME:
        return Headline(f"{name}_work", "work of the winch", "J", value, remark="on the closing line")
    words = f"work of the reel of {name}"
    return Headline(f"tether_{name}_work_of_reel", words, "J", value, remark="on the tether")


def _of_drum(name: str, quantity: int, course: Course) -> float | None:
    """At the end."""
    if name not in course.reel_names:
        return None
    return float(course.reel[-1, course.reel_names.index(name), quantity])


def _of_line(quantity: str) -> Callable[[Course], float | None]:
    """At the end, of a closing line; None without one, or where it was never taut."""

    def value(course: Course) -> float | None:
        series = course.line.get(LINE + quantity)
        return None if series is None or not course.line[f"{LINE}largest"][-1] > 0.0 else float(series[-1])

    return value


def _line_margin(course: Course) -> float | None:
    load = _of_line("load")(course)
    return 1.0 / load - 1.0 if load else None


OF_A_LINE = (
    Headline(
        "closing_largest_tension", "largest tension of the closing line", "N", _of_line("largest"),
        remark="of all steps",
    ),
    Headline(
        "closing_time_of_largest_tension", "time of largest tension of the closing line", "s",
        _of_line("largest_time"), at_a_step=True,
    ),
    Headline(
        "closing_margin", "margin of the closing line", "", _line_margin, least=1e-4,
        remark="strength / largest tension - 1",
    ),
)  # fmt: skip


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
