"""What an ensemble leaves: headlines of each run, quantiles over time, and how they were found."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError
from exunet.base.files import path_of
from exunet.base.short_repr import ShortRepr
from exunet.results.course import Course
from exunet.results.curves import Curve, curve, curves_for, directions_of
from exunet.results.endings import common_time, over_time
from exunet.results.headlines import headline, headlines_for
from exunet.results.io import (
    ENSEMBLE_KIND,
    damage,
    new_file,
    open_to_read,
    put,
    put_text,
    refuse_unreadable,
)
from exunet.results.result import table

if TYPE_CHECKING:
    import h5py
    from pandas import DataFrame

Floats = NDArray[np.float64]

ENSEMBLE_FILE = "ensemble.h5"
FORMAT = 1
ALONG = "momenta_along"  # in the story: directions in the scene's axes of the momenta over time, by kind
LEVELS = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)  # of the quantiles; 0 and 1 are the least and the largest


@dataclass(frozen=True, eq=False, repr=False)
class EnsembleResult(ShortRepr):
    """Metrics of many perturbed runs of a case, and quantiles of their time series.

    headlines : (runs,) by key, such as "largest_tension_N", of each until its end; a NaN where a run has no
                such quantity
    elements  : (runs,) element with the largest tension of each run; -1: none was ever taut
    time      : (t,) instants [s], until the last of the runs ended
    levels    : (q,) levels of the quantiles, from 0 (the least) to 1 (the largest)
    quantiles : (q, t) by name of the quantity, such as "area" [m2] or "contact_target/threads_force" [N], of
                the runs that have not ended; SI units
    complete  : False if the ensemble was stopped before its last run
    verdict   : "ok", or why it stopped
    provenance : case text, seed, move_m, versions, method, counts, of a case with bodies the directions of
                 the changes of momenta, "momenta_along" (JSON-like)
    """

    headlines: Mapping[str, Floats]
    elements: NDArray[np.int64]
    time: Floats
    levels: Floats
    quantiles: Mapping[str, Floats]
    complete: bool = True
    verdict: str = "ok"
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.elements)

    def quantile(self, key: str, level: float | Sequence[float]) -> Any:
        """Quantiles of a headline over the runs that have it, as `numpy.quantile`.

        Raises InputError for another headline, or a level outside 0 to 1.
        """
        if key not in self.headlines:
            raise InputError(f"quantile: {key!r} is not one of {', '.join(self.headlines)}")
        values = self.headlines[key]
        try:
            return np.quantile(values[~np.isnan(values)], level)
        except (TypeError, ValueError):
            raise InputError(f"quantile: levels are numbers from 0 to 1, got {level!r}") from None

    def band(self, name: str) -> tuple[Floats, Floats]:
        """Least and largest (t,) of a quantity over the runs."""
        values = self.quantiles[name]
        return values[0], values[-1]

    def to_frame(self) -> DataFrame:
        """The headlines as a pandas table: one row for each run, its number as the index.

        Columns are the headlines, with units at the end of their names, and "element" with the largest
        tension. Raises MissingExtra without pandas (pip install 'exunet[pandas]').
        """
        return table("run", np.arange(self.runs), {**self.headlines, "element": self.elements})


def ensemble_result(
    courses: Sequence[Course],
    *,
    complete: bool,
    verdict: str,
    provenance: Mapping[str, Any],
    shown: Course | None = None,
) -> EnsembleResult:
    """The result of at least one course.

    shown : the run whose figures show the quantiles: along its directions of momenta they are; None: the
            first of the courses
    """
    along = directions_of(shown or courses[0])
    told = {} if along is None else {ALONG: {kind: one.tolist() for kind, one in along.items()}}
    found = {
        item.key: np.array([np.nan if (value := item.value(course)) is None else value for course in courses])
        for item in headlines_for(courses[0])
    }
    curves = {entry.name: over_time(courses, entry.value, LEVELS) for entry in curves_for(courses[0], along)}
    return EnsembleResult(
        headlines={key: values for key, values in found.items() if not np.isnan(values).all()},
        elements=np.array([course.peak.element for course in courses]),
        time=common_time(courses),
        levels=np.array(LEVELS),
        quantiles=curves,
        complete=complete,
        verdict=verdict,
        provenance={**provenance, **told},
    )


@takes(result=EnsembleResult, overwrite=bool)
def save_ensemble(result: EnsembleResult, path: str | Path, *, overwrite: bool = False) -> None:
    """Write an ensemble to an HDF5 file, which appears whole or not at all.

    overwrite : replace an older file of that name, which stays as it is until the new one is whole
    Raises InputError, and writes nothing, if there is a file of that name and `overwrite` is False, if the
    file cannot be written, or if there is no quantity of a name.
    """
    path = path_of(path, "save_ensemble")
    if not overwrite and os.path.exists(path):
        raise InputError(f"{path}: there is a file of that name: give another, or overwrite=True")
    curves = [_curve(name) for name in result.quantiles]
    with new_file(path) as (file, _):
        put_text(file, "kind", ENSEMBLE_KIND)
        file.attrs["format"] = FORMAT
        file.attrs["complete"] = bool(result.complete)
        put_text(file, "verdict", result.verdict)
        put_text(file, "provenance", json.dumps(dict(result.provenance), sort_keys=True, allow_nan=False))
        for key, values in result.headlines.items():
            one = headline(key)
            put(file, f"headlines/{key}", values, one.unit or "1", one.words)
        put(file, "elements", result.elements, "1", "element with the largest tension of each run")
        put(file, "time", result.time, "s", "instants")
        put(file, "quantiles/levels", result.levels, "1", "levels of the quantiles over the runs")
        for each in curves:
            words_of = f"{each.words}: quantiles over the runs"
            put(file, f"quantiles/{each.name}", result.quantiles[each.name], each.unit or "1", words_of)


def _curve(name: str) -> Curve:
    try:
        return curve(name)
    except KeyError:
        words = "is none of which an ensemble has quantiles"
        raise InputError(f"save_ensemble: the quantity {name!r} {words}: leave it out") from None


def load_ensemble(path: str | Path) -> EnsembleResult:
    """Read what `save_ensemble` or `exunet ensemble` wrote; path: the file, or its folder.

    Raises InputError if it is missing, damaged or of another kind.
    """
    path = path_of(path, "load_ensemble")
    path = path / ENSEMBLE_FILE if path.is_dir() else path
    refuse_unreadable(path)
    with damage(path), open_to_read(path) as file:
        return _read(file, path)


def _read(file: h5py.File, path: Path) -> EnsembleResult:
    if file.attrs.get("kind") not in (ENSEMBLE_KIND, ENSEMBLE_KIND.encode()):
        raise InputError(f"{path}: is no file of an ensemble")
    if int(file.attrs.get("format", 0)) != FORMAT:
        raise InputError(f"{path}: has a format that this version does not read")
    story = file.attrs["provenance"]
    verdict = file.attrs["verdict"]
    return EnsembleResult(
        headlines={key: values[...] for key, values in file["headlines"].items()},
        elements=file["elements"][...],
        time=file["time"][...],
        levels=file["quantiles/levels"][...],
        quantiles=_quantiles(file["quantiles"]),
        complete=bool(file.attrs["complete"]),
        verdict=verdict.decode() if isinstance(verdict, bytes) else str(verdict),
        provenance=json.loads(story),
    )


def _quantiles(group: h5py.Group) -> dict[str, Floats]:
    """By name of the quantity; one of a contact, a body or a corner unit stands in a group of its own."""
    import h5py

    found: dict[str, Floats] = {}
    for name, values in group.items():
        if isinstance(values, h5py.Group):
            found |= {f"{name}/{part}": one[...] for part, one in values.items()}
        elif name != "levels":
            found[name] = values[...]
    return found
