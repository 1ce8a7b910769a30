"""How runs of a case from moved starts ended, where a script may end each at another time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.course import Course

Floats = NDArray[np.float64]


def endings(courses: Sequence[Course]) -> list[dict[str, Any]]:
    """Of each way in which runs ended: verdict of the script, or None, number of runs, from when to when [s].

    The most frequent first; empty if a script has ended none of them.
    """
    if not any(item.stopped for item in courses):
        return []
    found = []
    for verdict, number in Counter(entry.stopped for entry in courses).most_common():
        times = [float(course.time[-1]) for course in courses if course.stopped == verdict]
        ends = {"earliest_s": min(times), "latest_s": max(times)}
        found.append({"verdict": verdict or None, "runs": number, **ends})
    return found


def words_of_endings(found: Sequence[Mapping[str, Any]]) -> str:
    """The same in words; "" without."""
    told = []
    for item in found:
        low, high = (f"{item[name]:.4g}" for name in ("earliest_s", "latest_s"))
        when = f"at {low} s" if low == high else f"at {low} to {high} s"
        told.append(f"{item['runs']} {_how(item['verdict'])} {when}")
    return f"{'; '.join(told)}; headlines are of each run until its own end" if told else ""


def _how(verdict: str | None) -> str:
    return "at their time," if verdict is None else f'by the script ("{verdict}")'


def over_time(
    courses: Sequence[Course], value: Callable[[Course], Floats | None], levels: Sequence[float]
) -> Floats:
    """(q, t) quantiles of a value (t,) of courses at common instants, of the runs that still go on there."""
    lengths = [instants_in(course) for course in courses]
    values = [np.zeros(0) if (own := value(item)) is None else own for item in courses]
    found, done = [], 0
    for until in sorted(set(lengths)):
        going_on = [own[done:until] for own, length in zip(values, lengths, strict=True) if length >= until]
        found.append(np.quantile(going_on, levels, axis=0))
        done = until
    return np.concatenate(found, axis=1)


def common_time(courses: Sequence[Course]) -> Floats:
    """(t,) instants [s] until the last of the runs ended."""
    longest = max(courses, key=instants_in)
    return longest.time[: instants_in(longest)]


def instants_in(course: Course) -> int:
    """How many of its times are instants of all courses: not that at which a script ended it."""
    return max(1, len(course.time) - 1) if course.stopped else len(course.time)
