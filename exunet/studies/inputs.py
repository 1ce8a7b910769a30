"""Inputs of a study: distributions of keys of a case, their random streams, and designs of samples.

Each input has its own random stream, seeded by the study's seed and the input's name: draws do not depend on
other inputs, on the number of runs, or on who computes the run. A Latin hypercube depends on the number of
runs, and a Saltelli design on the order of the inputs.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field
from scipy.special import ndtri

from exunet.base.arrays import Floats
from exunet.base.errors import Fault
from exunet.base.record import Count, FromArray, NonNegative, Positive, Record
from exunet.bodies.rotations import product, quaternion_of
from exunet.results.outcome import Outcome

Pair = Annotated[tuple[float, float], FromArray]
Triple = Annotated[tuple[float, float, float], FromArray]
Values = Annotated[tuple[Any, ...], FromArray, Field(min_length=1)]
Texts = Annotated[tuple[str, ...], FromArray]
Sample = dict[str, Any]  # value by column

MAX_RUNS = 1_000_000
NO_TURN = (1.0, 0.0, 0.0, 0.0)
_BLOCK = 4096  # samples that are drawn together
_LEAST = 2.0**-54  # so that no quantile is infinite
_BITS = 30  # of Sobol' points
_DIMENSIONS = {"isotropic": 3, "tilt": 2}  # numbers from 0 to 1 that a draw takes, if not one
_COMPONENTS = {"isotropic": 3, "tilt": 4}
_QUANTITY = re.compile(r"(-?)(probability|median|quantile)\((\w+)(?:,([\d.]+))?\)(?:(<=|>=)(.+))?")
_UNBOUNDED = ("integer", "choice", "isotropic", "tilt", "values")


class ScipyConfig(Record):
    """A distribution of scipy.stats by its name and arguments, as a frozen distribution has them."""

    name: str = Field(description="name in scipy.stats")
    args: Annotated[tuple[float, ...], FromArray] = Field((), description="shape parameters, loc and scale")
    kwds: dict[str, float] = Field({}, description="parameters by name")


def _as_record(given: Any) -> Any:
    """Return the table of an input for a list, an array, or a frozen distribution of SciPy."""
    given = given.tolist() if isinstance(given, np.ndarray) else given
    if isinstance(given, list | tuple):
        return {"values": given}
    if isinstance(given, Mapping) or not hasattr(given, "ppf"):
        return given
    kwds = {name: float(value) for name, value in given.kwds.items()}
    return {"scipy": {"name": given.dist.name, "args": tuple(map(float, given.args)), "kwds": kwds}}


class InputConfig(Record):
    """Distribution, or list, of the values of a key."""

    EXACTLY_ONE: ClassVar = (
        *("uniform", "normal", "log_uniform", "log_normal", "triangular"),
        *("integer", "choice", "isotropic", "tilt", "values", "scipy"),
    )

    uniform: Pair | None = Field(None, description="minimum, maximum")
    normal: Pair | None = Field(None, description="mean, standard deviation")
    log_uniform: Pair | None = Field(None, description="minimum, maximum, both positive")
    log_normal: Pair | None = Field(None, description="median, and factor (> 1) of a standard deviation")
    triangular: Triple | None = Field(None, description="minimum, mode, maximum")
    integer: Annotated[tuple[int, int], FromArray] | None = Field(None, description="first, last")
    choice: Values | None = Field(None, description="values, each as likely as the others")
    isotropic: Annotated[tuple[NonNegative, NonNegative], FromArray] | None = Field(
        None, description="minimum, maximum of the length of a vector of any direction"
    )
    tilt: Positive | None = Field(
        None, description="standard deviation of rotations of an attitude about its x and its y axis [rad]"
    )
    values: Values | None = Field(None, description="list of a grid")
    scipy: ScipyConfig | None = Field(None, description="distribution of scipy.stats")
    bounds: Pair | None = Field(None, description="minimum, maximum, to which the distribution is cut")
    also: Texts = Field((), description="other keys with the same value")

    @property
    def kind(self) -> str:
        """Name of the distribution."""
        return next(name for name in self.EXACTLY_ONE if self.is_given(name))

    @property
    def dimensions(self) -> int:
        """Number of numbers from 0 to 1 that a draw takes."""
        return _DIMENSIONS.get(self.kind, 1)

    def faults(self) -> Iterator[Fault]:
        """Require parameters of a distribution, and bounds within it."""
        if sum(self.is_given(name) for name in self.EXACTLY_ONE) != 1:
            return
        kind = self.kind
        try:
            valid = self.frozen is None or math.isfinite(self.frozen.ppf(0.5))
        except (AttributeError, TypeError, ValueError):  # no such distribution, or other arguments
            valid = False
        if kind == "isotropic" and self.isotropic is not None:
            valid = self.isotropic[0] <= self.isotropic[1]
        if not valid:
            yield Fault(kind, f"requires {type(self).model_fields[kind].description}")
        elif self.bounds is not None and kind in _UNBOUNDED:
            yield Fault("bounds", f"is not for {kind}")
        elif self.bounds is not None and not self.outside(*self.bounds, cut=False) < 1.0:
            yield Fault("bounds", "requires minimum < maximum, and a part of the distribution between them")

    @cached_property
    def frozen(self) -> Any:
        """The distribution without `bounds`, frozen as in scipy.stats; None of lists and vectors."""
        from scipy import stats  # late: half a second that workers do without

        given: Any = getattr(self, self.kind)
        match self.kind:
            case "uniform":
                return stats.uniform(given[0], given[1] - given[0])
            case "normal":
                return stats.norm(*given)
            case "log_uniform":
                return stats.loguniform(*given)
            case "log_normal":
                return stats.lognorm(math.log(max(given[1], 0.1)), scale=given[0])
            case "triangular":
                low, mode, high = given
                width = high - low or math.nan
                return stats.triang((mode - low) / width, low, width)
            case "integer":
                return stats.randint(given[0], given[1] + 1)
            case "scipy":
                return getattr(stats, given.name)(*given.args, **given.kwds)
        return None

    def outside(self, low: float, high: float, *, cut: bool = True) -> float:
        """Return the part of the distribution, cut to its `bounds`, that is not from `low` to `high`."""
        ends = self.bounds if cut and self.bounds else (-math.inf, math.inf)
        inner = max(low, ends[0]), min(high, ends[1])
        inside, whole = (self.frozen.cdf(b) - self.frozen.cdf(a) for a, b in (inner, ends))
        return 1.0 - max(0.0, float(inside)) / float(whole)

    def draw(self, key: str, unit: Floats, attitude: Sequence[float] = NO_TURN) -> Sample:
        """Return columns of samples from independent, uniform numbers (n, dimensions) of 0 to 1.

        attitude : quaternion that `tilt` turns
        """
        kind, given = self.kind, getattr(self, self.kind)
        unit = np.clip(unit, _LEAST, 1.0 - 4.0 * _LEAST)
        if kind in ("choice", "values"):
            return {key: [given[int(part * len(given))] for part in unit[:, 0]]}
        if kind == "isotropic":
            length, height = given[0] + unit[:, 0] * (given[1] - given[0]), 2.0 * unit[:, 1] - 1.0
            across, angle = np.sqrt(1.0 - height**2), 2.0 * math.pi * unit[:, 2]
            directions = [across * np.cos(angle), across * np.sin(angle), height]
            return self._vector(key, length, length[:, None] * np.stack(directions, axis=-1))
        if kind == "tilt":
            rotation = np.pad(given * ndtri(unit), ((0, 0), (0, 1)))
            turned = product(np.broadcast_to(np.array(attitude), (len(unit), 4)), quaternion_of(rotation))
            return self._vector(key, np.linalg.norm(rotation, axis=1), turned)
        values = unit[:, 0]
        if self.bounds is not None:
            low, high = self.frozen.cdf(self.bounds)
            values = np.clip(self.frozen.ppf(low + values * (high - low)), *self.bounds)
        else:
            values = self.frozen.ppf(values)
        return {key: values.astype(np.int64 if kind == "integer" else np.float64).tolist()}

    def _vector(self, key: str, length: Floats, vectors: Floats) -> Sample:
        return dict(zip(self.columns(key), (length.tolist(), *vectors.T.tolist()), strict=True))

    def columns(self, key: str) -> list[str]:
        """Return the names of the columns: the key, of a vector its length, then its components."""
        return [key, *(f"{key}[{k}]" for k in range(_COMPONENTS.get(self.kind, 0)))]

    def value(self, key: str, sample: Mapping[str, Any]) -> Any:
        """Return the value of the input in a sample, by column; a list of a vector or an attitude."""
        columns = self.columns(key)
        return [sample[name] for name in columns[1:]] if len(columns) > 1 else sample[key]

    def overrides(self, key: str, sample: Mapping[str, Any]) -> list[str]:
        """Return the overrides of a case for the values of a sample, by column."""
        return [f"{name}={as_toml(self.value(key, sample))}" for name in (key, *self.also)]


def as_toml(value: Any) -> str:
    """Return a value as TOML has it; a floating-point number with all digits."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {as_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


class DesignConfig(Record):
    """One of several designs that are compared on the same samples."""

    name: Annotated[str, Field(min_length=1)] = Field(description="name in tables and figures")
    case: str | None = Field(None, description="case file, if not that of the study")
    set: Texts = Field((), description='overrides "key.path=value"')


class OutputsConfig(Record):
    """Printed metrics of a study, and full results that are kept beside its rows."""

    print: Texts = Field((), description="metrics that are printed")
    limits: dict[str, float] = Field({}, description="limit of a metric, whose exceedance is printed")
    keep: Literal["none", "undetermined", "all"] | Annotated[tuple[int, ...], FromArray] = Field(
        "none", description="full results that are kept: none, undetermined, all, or numbers of runs"
    )

    @property
    def named(self) -> list[str]:
        """The metrics that are named, each once."""
        return list(dict.fromkeys((*self.print, *self.limits)))

    def keeps(self, run: int, outcome: str | None) -> bool:
        """True if the full result of a run is kept."""
        return run in self.keep if isinstance(self.keep, tuple) else self.keep in ("all", outcome)


@dataclass(frozen=True)
class Statistic:
    """Probability of an outcome, or quantile of a metric, over the runs of a design; larger is better.

    part  : of the quantile; None of a probability
    sign  : -1 where smaller is better
    bound : minimum, of a constraint, with this sign
    """

    name: str
    part: float | None
    sign: float
    bound: float | None = None

    @classmethod
    def parse(cls, text: str, *, bounded: bool) -> Statistic:
        """Read such as "-quantile(METRIC, 0.95)", or a constraint; raises ValueError."""
        if (found := _QUANTITY.fullmatch(text.replace(" ", ""))) is None:
            raise ValueError
        minus, kind, name, given, relation, number = found.groups()
        part = None if kind == "probability" else float(given or 0.5)
        valid = name in list(Outcome) if part is None else 0.0 < part < 1.0
        if not valid or (relation is not None) != bounded or (given is not None) != (kind == "quantile"):
            raise ValueError
        turned = -1.0 if relation == "<=" else 1.0
        bound = turned * float(number) if bounded else None
        return cls(name, part, -turned if minus else turned, bound)

    def value(self, responses: Floats) -> float:
        """Return the quantity of (runs,) values, with its sign; NaN of a run without it is the worst."""
        signed = self.sign * responses
        if self.part is None:
            return float(np.nan_to_num(signed, nan=min(0.0, self.sign)).mean())
        part = self.part if self.sign > 0.0 else 1.0 - self.part
        with np.errstate(invalid="ignore"):  # between infinities
            found = float(np.quantile(np.where(np.isnan(signed), -math.inf, signed), part))
        return -math.inf if math.isnan(found) else found


class OptimiseConfig(Record):
    """Search for the best values of keys; each design is judged by all runs, with the same samples."""

    over: dict[str, InputConfig] = Field(
        min_length=1, description="by key: uniform, log_uniform, integer or choice, as the range of values"
    )
    maximise: Annotated[
        Texts, BeforeValidator(lambda given: [given] if isinstance(given, str) else given)
    ] = Field(description="one or two of probability(OUTCOME), median(METRIC), quantile(METRIC, PART)")
    constraints: Texts = Field((), description='"QUANTITY <= NUMBER" or "QUANTITY >= NUMBER"')
    designs: Count = Field(40, description="number of designs that are tried")

    def faults(self) -> Iterator[Fault]:
        """Require ranges, and quantities that can be read."""
        for key, item in self.over.items():
            if item.kind not in ("uniform", "log_uniform", "integer", "choice") or item.bounds:
                yield Fault(f"over.{json.dumps(key)}", "requires uniform, log_uniform, integer or choice")
        if not 1 <= len(self.maximise) <= 2:
            yield Fault("maximise", f"requires one or two quantities, got {len(self.maximise)}")
        for key in ("maximise", "constraints"):
            for text in getattr(self, key):
                try:
                    Statistic.parse(text, bounded=key == "constraints")
                except ValueError:
                    yield Fault(key, f"requires {type(self).model_fields[key].description}, got {text!r}")

    @cached_property
    def quantities(self) -> list[Statistic]:
        """Return the quantities that are maximised, then the constraints."""
        return [
            *(Statistic.parse(text, bounded=False) for text in self.maximise),
            *(Statistic.parse(text, bounded=True) for text in self.constraints),
        ]


class StudyConfig(Record):
    """A study: case, inputs, design."""

    format: Literal[1] = Field(1, description="version of the format")
    title: str = Field("", description="one line for tables and figures")
    case: str = Field(description="case file, relative to the folder of the study")
    design: Literal["random", "lhs", "grid", "saltelli"] = Field(description="how samples are chosen")
    runs: Count | None = Field(None, description="number of samples; grid: absent; saltelli: a power of 2")
    seed: Annotated[int, Field(strict=True, ge=0)] = Field(0, description="of the random streams")
    set: Texts = Field((), description="overrides of all runs")
    inputs: dict[str, Annotated[InputConfig, BeforeValidator(_as_record)]] = Field(
        description="distributions, or lists of a grid, by key of the case"
    )
    replicates: Count = Field(1, description="of a grid: runs of each point, from perturbed starts")
    designs: Annotated[tuple[DesignConfig, ...], FromArray] = Field((), description="designs, side by side")
    outputs: OutputsConfig = Field(
        default_factory=lambda: OutputsConfig.model_validate({}), description="what is printed and kept"
    )
    time_limit: Positive | None = Field(None, description="wall time of a run [s]")
    optimise: OptimiseConfig | None = Field(None, description="search for better values of keys")

    def faults(self) -> Iterator[Fault]:
        """Require inputs and numbers of runs that fit the design."""
        grid, saltelli, runs = self.design == "grid", self.design == "saltelli", self.runs
        if not self.inputs and not (grid and self.designs):
            yield Fault("inputs", "requires at least one key")
        for key, item in self.inputs.items():
            if grid != (item.kind == "values"):
                words = "a grid requires lists" if grid else 'a list requires design = "grid" (or use choice)'
                yield Fault(f"inputs.{json.dumps(key)}", words)
        written = [(key, name) for key, item in self.inputs.items() for name in (key, *item.also)]
        for k, (key, name) in enumerate(written):
            for before, other in written[:k]:
                if (
                    name == other
                    or name.startswith((f"{other}[", f"{other}."))
                    or other.startswith((f"{name}[", f"{name}."))
                ):
                    words = f"sets {name}, of which the input {before} sets {other}: remove one of both"
                    yield Fault(f"inputs.{json.dumps(key)}", words)
        if grid == (runs is not None):
            yield Fault("runs", "is not for a grid" if grid else f"missing for {self.design}")
        elif saltelli and runs and runs & (runs - 1):
            yield Fault(
                "runs", f"must be a power of 2 for saltelli, got {runs}: use {1 << runs.bit_length()}"
            )
        if self.replicates > 1 and not grid:
            yield Fault("replicates", 'requires design = "grid"')
        if self.designs and saltelli:
            yield Fault("designs", "saltelli does not compare designs: use random, lhs or grid")
        if self.optimise is not None:
            if self.design not in ("random", "lhs") or self.designs:
                yield Fault("optimise", 'requires design = "random" or "lhs", without designs')
            for key in self.optimise.over.keys() & self.inputs.keys():
                yield Fault(f"optimise.over.{json.dumps(key)}", "is an input too: remove one of both")
        if len({design.name for design in self.designs}) < len(self.designs):
            yield Fault("designs", "requires different names")
        if (number := self.number_of_rows) > MAX_RUNS:
            yield Fault("inputs" if grid else "runs", f"{number:,} runs; at most {MAX_RUNS:,} are allowed")

    def values(self, sample: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of a sample by input, lists of vectors and attitudes."""
        return {key: item.value(key, sample) for key, item in self.inputs.items()}

    @property
    def points(self) -> int:
        """Number of samples; of Saltelli's design N."""
        if self.design == "grid":
            return math.prod(len(item.values or ()) for item in self.inputs.values())
        return self.runs or 0

    @property
    def cases_of_point(self) -> int:
        """Number of cases of each sample: designs, or of Saltelli's design A, B and one of each input."""
        return len(self.inputs) + 2 if self.design == "saltelli" else max(1, len(self.designs))

    @property
    def rows_of_point(self) -> int:
        """Number of runs of each sample, with replicates, and the dummy of Saltelli's design."""
        return self.cases_of_point * self.replicates + (self.design == "saltelli")

    @property
    def number_of_rows(self) -> int:
        """Number of runs of the study."""
        return self.points * self.rows_of_point


@dataclass(frozen=True)
class Samples:
    """The samples of a study.

    attitudes : quaternion that `tilt` turns, by number of the design and key
    """

    config: StudyConfig
    attitudes: Mapping[tuple[int, str], Sequence[float]]

    def place(self, row: int) -> tuple[int, int]:
        """Return the number of the case of a row, and of its replicate; 0: unperturbed."""
        config = self.config
        if config.design != "saltelli":
            return divmod(row, config.replicates)
        point, m = divmod(row, config.rows_of_point)
        first = point * config.cases_of_point
        return (first, 1) if m == config.cases_of_point else (first + m, 0)

    def row(self, run: int, replicate: int = 0) -> int:
        """Return the row of a case and a replicate."""
        config = self.config
        if config.design != "saltelli":
            return run * config.replicates + replicate
        point, m = divmod(run, config.cases_of_point)
        return point * config.rows_of_point + (config.cases_of_point if replicate else m)

    def design(self, run: int) -> int:
        """Return the number of the design of a case."""
        return 0 if self.config.design == "saltelli" else run % self.config.cases_of_point

    def of_runs(self, runs: Sequence[int]) -> list[Sample]:
        """Return the values of cases, by column."""
        found: list[Sample] = [{} for _ in runs]
        for number, (key, item) in enumerate(self.config.inputs.items()):
            for design in sorted({self.design(run) for run in runs}):
                mine = [k for k, run in enumerate(runs) if self.design(run) == design]
                unit = np.array([self._unit(number, key, runs[k]) for k in mine])
                columns = item.draw(key, unit, self.attitudes.get((design, key), NO_TURN))
                for name, values in columns.items():
                    for k, value in zip(mine, values, strict=True):
                        found[k][name] = value
        return found

    def _unit(self, number: int, key: str, run: int) -> Floats:
        """Return numbers (dimensions,) from 0 to 1 of an input in a case."""
        config = self.config
        (point, m), size = divmod(run, config.cases_of_point), config.inputs[key].dimensions
        if config.design == "grid":
            lengths = [len(item.values or ()) for item in config.inputs.values()]
            place = point // math.prod(lengths[number + 1 :]) % lengths[number]
            return np.array([(place + 0.5) / lengths[number]])
        if config.design == "random":
            return _random(config.seed, key, point // _BLOCK, size)[point % _BLOCK]
        if config.design == "lhs":
            return _latin(config.seed, key, config.points, size)[point]
        other = m in (1, 2 + number)  # of B
        return self._sobol[key][point, size * other : size * (1 + other)]

    @cached_property
    def _sobol(self) -> dict[str, Floats]:
        """Return numbers (points, 2 dimensions) of each input, of the samples A and B.

        An exclusive or with random bits of each input shifts a Sobol' sequence and keeps its balance.
        """
        from scipy.stats import qmc

        sizes = [2 * item.dimensions for item in self.config.inputs.values()]
        points = qmc.Sobol(sum(sizes), scramble=False, bits=_BITS).random(self.config.points)
        found, parts = {}, np.split(points, np.cumsum(sizes)[:-1], axis=1)
        for key, part in zip(self.config.inputs, parts, strict=True):
            stream, size = _stream(self.config.seed, key, 0), part.shape[1]
            bits = (part * 2.0**_BITS).astype(np.int64) ^ stream.integers(0, 2**_BITS, size)
            found[key] = (bits + stream.random(size)) / 2.0**_BITS
        return found


def _stream(seed: int, key: str, block: int) -> np.random.Generator:
    """Return the random stream of a block of an input."""
    name = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "little")
    return np.random.default_rng([seed, name, block])


@lru_cache(maxsize=64)
def _random(seed: int, key: str, block: int, size: int) -> Floats:
    return _stream(seed, key, block).random((_BLOCK, size))


@lru_cache(maxsize=64)
def _latin(seed: int, key: str, points: int, size: int) -> Floats:
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(size, seed=_stream(seed, key, 0)).random(points))
