"""Ensemble: a table of the metrics of many runs of a case, and quantiles of their time series."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from exunet.base.arguments import ShortRepr, takes
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import path_of
from exunet.results.io import (
    ENSEMBLE_FILE,
    ENSEMBLE_KIND,
    damage,
    new_file,
    open_to_read,
    put,
    put_text,
    refuse_unreadable,
)
from exunet.results.metrics import Metric, metrics_of, printed, without_values
from exunet.results.observables import Observables, TimeSeries, time_series
from exunet.results.outcome import outcome
from exunet.results.result import Result, table
from exunet.results.run_record import Ending, EnsembleRecord, Recorded

if TYPE_CHECKING:
    import h5py
    from pandas import DataFrame
    from xarray import Dataset


FORMAT = 2
LEVELS = (
    0.0,
    0.05,
    0.25,
    0.5,
    0.75,
    0.95,
    1.0,
)  # of the quantiles over time; 0 and 1 are minimum and maximum
MANY = 20  # runs from which on a range is from 5 % to 95 %, else from minimum to maximum
INTERVALS = 400  # between the instants at which members are sampled


def instants(end: float) -> Floats:
    """(401,) times [s] from 0 to `end` at which members are sampled, whatever times a case stores."""
    return np.linspace(0.0, end, INTERVALS + 1)


@dataclass(frozen=True)
class Member:
    """Data that an ensemble uses of one run.

    time    : (t,) [s]
    stopped : verdict of the script that ended the run at the last of the times; "": it did not
    outcome : of the capture; "": the case has no criterion
    """

    time: Floats
    metrics: Mapping[str, Metric]
    series: Mapping[str, TimeSeries]
    stopped: str = ""
    outcome: str = ""

    @property
    def n_instants(self) -> int:
        """Number of its times that are instants of all members: not that at which a script ended it."""
        return max(1, len(self.time) - 1) if self.stopped else len(self.time)


def member_of(result: Result) -> Member:
    """Measure a result for an ensemble."""
    run = Observables(result)
    found = outcome(run)
    return Member(
        time=np.asarray(result.time),
        metrics=metrics_of(run),
        series={series.name: series for series in time_series(run)},
        stopped="" if result.run.stop is None else result.run.stop.verdict or "",
        outcome="" if found is None else found.outcome.value,
    )


class Range(NamedTuple):
    """A metric over the runs that have it: median, and 5 % to 95 % of 20 runs or more, else all.

    runs, of_runs : runs that have the metric, all runs
    """

    metric: Metric
    runs: int
    of_runs: int
    median: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """True if the range is below the printed digits."""
        return self.high - self.low <= max(self.metric.last_digit(end) for end in (self.low, self.high))

    def __str__(self) -> str:
        last = max(self.metric.last_digit(end) for end in (self.low, self.high))
        low, median, high = (printed(value, last) for value in (self.low, self.median, self.high))
        words = f"{median} {self.metric.unit}".rstrip()
        words += "" if self.known else f" ({low} to {high})"
        return words + (f", in {self.runs} of {self.of_runs} runs" if self.runs < self.of_runs else "")


def sensitivity(runs: int, move: float) -> str:
    """Return which runs ranges are of, in words; move: of their perturbation [m]."""
    what = "median (5 % to 95 %)" if runs >= MANY else "median (minimum to maximum)"
    return f"numerical sensitivity: {what} of {runs} runs perturbed by {move:.2g} m"


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(ShortRepr, Recorded):
    """Metrics of many runs of a case, and quantiles of their time series.

    metrics   : (runs,) by key, such as "largest_tension_N", of each run until its end; NaN where a run
                does not have the metric
    about     : what each metric is, by key, without values
    time      : (t,) instants [s], until the last of the runs ended
    levels    : (q,) levels of the quantiles, from 0 (minimum) to 1 (maximum)
    quantiles : (q, t) by name of the quantity, such as "area" [m2] or "contact_target/threads_force" [N], of
                the runs that have not ended; SI units
    series    : what each of these quantities is, by name, without values
    run       : record of the start and of the perturbations, with the verdict
    """

    metrics: Mapping[str, Floats]
    about: Mapping[str, Metric]
    time: Floats
    levels: Floats
    quantiles: Mapping[str, Floats]
    series: Mapping[str, TimeSeries]
    run: EnsembleRecord = field(default_factory=EnsembleRecord)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(next(iter(self.metrics.values()), ()))

    def quantile(self, key: str, level: float | Sequence[float]) -> Any:
        """Return quantiles of a metric over the runs that have it, as `numpy.quantile`.

        Raises InputError for another metric, or a level outside 0 to 1.
        """
        if key not in self.metrics:
            raise InputError(f"quantile: {key!r} is not one of {', '.join(self.metrics)}")
        values = self.metrics[key]
        try:
            return np.quantile(values[~np.isnan(values)], level)
        except (TypeError, ValueError):
            raise InputError(f"quantile: levels are numbers from 0 to 1, got {level!r}") from None

    def range(self, key: str) -> Range | None:
        """Return median and range of a metric; None if no run has it."""
        if key not in self.metrics:
            return None
        having = int(np.count_nonzero(~np.isnan(self.metrics[key])))
        ends = (0.05, 0.95) if having >= MANY else (0.0, 1.0)
        low, median, high = self.quantile(key, (ends[0], 0.5, ends[1])).tolist()
        return Range(self.about[key], having, self.runs, median, low, high)

    def band(self, name: str) -> tuple[Floats, Floats]:
        """Return minimum and maximum (t,) of a quantity over the runs."""
        values = self.quantiles[name]
        return values[0], values[-1]

    def to_pandas(self) -> DataFrame:
        """Return the metrics as a pandas table: one row for each run, its number as the index.

        Columns are the metrics, with units at the end of their names. Raises MissingExtra without pandas
        (pip install 'exunet[pandas]').
        """
        return table("run", np.arange(self.runs), dict(self.metrics))

    def to_xarray(self) -> Dataset:
        """Return metrics (run) and quantiles (level, time) as an xarray data set with units.

        Raises MissingExtra without xarray (pip install xarray).
        """
        try:
            from xarray import Dataset
        except ImportError:
            raise MissingExtra("a data set of an ensemble needs xarray: pip install xarray") from None
        found: dict[str, Any] = {}
        for key, values in self.metrics.items():
            found[key] = ("run", values, {"units": self.about[key].unit, "long_name": self.about[key].words})
        for name, values in self.quantiles.items():
            about = {"units": self.series[name].unit, "long_name": self.series[name].words}
            found[name] = (("level", "time"), values, about)
        return Dataset(found, {"run": np.arange(self.runs), "level": self.levels, "time": self.time})


def ensemble_of(members: Sequence[Member], *, run: EnsembleRecord | None = None) -> Ensemble:
    """Make the ensemble of at least one member."""
    about: dict[str, Metric] = {}
    for member in members:
        for key, metric in member.metrics.items():
            known = about.setdefault(key, without_values(metric))
            about[key] = replace(known, size=max(known.size, metric.size))
    values = {key: np.array([_value(member.metrics.get(key)) for member in members]) for key in about}
    longest = max(members, key=lambda member: member.n_instants)
    lengths = [member.n_instants for member in members]
    series, quantiles = dict[str, TimeSeries](), dict[str, Floats]()
    for name, one in members[0].series.items():
        series[name] = one._replace(values=np.zeros(0))
        quantiles[name] = _quantiles([member.series[name].values for member in members], lengths)
    record = replace(
        run or EnsembleRecord(),
        outcomes=dict(Counter(member.outcome for member in members if member.outcome).most_common()),
        endings=endings(members),
    )
    return Ensemble(
        metrics=values,
        about=about,
        time=longest.time[: longest.n_instants],
        levels=np.array(LEVELS),
        quantiles=quantiles,
        series=series,
        run=record,
    )


def _value(metric: Metric | None) -> float:
    return math.nan if metric is None else metric.value


def _quantiles(values: Sequence[Floats], lengths: Sequence[int]) -> Floats:
    """(q, t) quantiles of values (t_k,) at common instants, of the runs that still go on there."""
    found, begin = [], 0
    for end in sorted(set(lengths)):
        lasting = [own[begin:end] for own, length in zip(values, lengths, strict=True) if length >= end]
        found.append(np.quantile(lasting, LEVELS, axis=0))
        begin = end
    return np.concatenate(found, axis=1)


def endings(members: Sequence[Member]) -> tuple[Ending, ...]:
    """Return how runs ended, the most frequent ending first; empty if a script ended no run."""
    if not any(member.stopped for member in members):
        return ()
    found = []
    for verdict, number in Counter(member.stopped for member in members).most_common():
        times = [float(member.time[-1]) for member in members if member.stopped == verdict]
        found.append(Ending(verdict or None, number, min(times), max(times)))
    return tuple(found)


def words_of_endings(found: Iterable[Ending]) -> str:
    """Return `endings` in words; "" without."""
    parts = []
    for item in found:
        low, high = f"{item.earliest_s:.4g}", f"{item.latest_s:.4g}"
        how = "at the end time," if item.verdict is None else f'by the script ("{item.verdict}")'
        parts.append(f"{item.runs} {how} at {low if low == high else f'{low} to {high}'} s")
    return f"{'; '.join(parts)}; metrics are of each run until its own end" if parts else ""


# --- files


@takes(result=Ensemble, overwrite=bool)
def save_ensemble(result: Ensemble, path: str | Path, *, overwrite: bool = False) -> None:
    """Write an ensemble to an HDF5 file, which appears whole or not at all.

    overwrite : replace an older file of that name, which stays as it is until the new one is whole
    Raises InputError, and writes nothing, if there is a file of that name and `overwrite` is False, or if the
    file cannot be written.
    """
    path = path_of(path, "save_ensemble")
    if not overwrite and os.path.exists(path):
        raise InputError(f"{path}: there is a file of that name: give another, or overwrite=True")
    about = {key: {**asdict(metric), "value": 0.0} for key, metric in result.about.items()}
    with new_file(path) as (file, _):
        put_text(file, "kind", ENSEMBLE_KIND)
        file.attrs["format"] = FORMAT
        put_text(file, "run", result.run.to_json())
        for key, values in result.metrics.items():
            put(file, f"metrics/{key}", values, result.about[key].unit or "1", result.about[key].words)
            put_text(file[f"metrics/{key}"], "about", json.dumps(about[key]))
        put(file, "time", result.time, "s", "instants")
        put(file, "levels", result.levels, "1", "levels of the quantiles over the runs")
        for name, values in result.quantiles.items():
            series = result.series[name]
            put(
                file,
                f"quantiles/{name}",
                values,
                series.unit or "1",
                f"{series.words}: quantiles over the runs",
            )
            put_text(file[f"quantiles/{name}"], "about", json.dumps([*series[:3], [], series.general]))


def load_ensemble(path: str | Path) -> Ensemble:
    """Read what `save_ensemble` or `exunet ensemble` wrote; path: the file, or its folder.

    Raises InputError if it is missing, damaged or of another kind.
    """
    path = path_of(path, "load_ensemble")
    path = path / ENSEMBLE_FILE if path.is_dir() else path
    refuse_unreadable(path)
    with damage(path), open_to_read(path) as file:
        return _read(file, path)


def _read(file: h5py.File, path: Path) -> Ensemble:
    import h5py

    if _text(file, "kind") != ENSEMBLE_KIND:
        raise InputError(f"{path}: is no file of an ensemble")
    if int(file.attrs.get("format", 0)) != FORMAT:
        raise InputError(f"{path}: has a format that this version does not read")
    quantiles: dict[str, Floats] = {}
    series: dict[str, TimeSeries] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            quantiles[name] = item[...]
            series[name] = TimeSeries(*json.loads(_text(item, "about")))._replace(values=np.zeros(0))

    file["quantiles"].visititems(visit)
    return Ensemble(
        metrics={key: values[...] for key, values in file["metrics"].items()},
        about={
            key: without_values(Metric(**json.loads(_text(values, "about"))))
            for key, values in file["metrics"].items()
        },
        time=file["time"][...],
        levels=file["levels"][...],
        quantiles=quantiles,
        series=series,
        run=EnsembleRecord.from_json(_text(file, "run")),
    )


def _text(owner: h5py.Group | h5py.Dataset, name: str) -> str:
    stored = owner.attrs.get(name, "")
    return stored.decode() if isinstance(stored, bytes) else str(stored)
