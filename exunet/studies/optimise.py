"""Optimisation of keys of a case; each design is judged by all runs of a study, with the same samples.

The sampler proposes eight designs at a time, which are scored in order: workers do not change the result.
Each eight are a study with `designs`, in a folder of its own. Going on proposes the same designs, whose rows
are there.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import path_of
from exunet.studies import estimates
from exunet.studies.inputs import InputConfig, OptimiseConfig, Statistic
from exunet.studies.rows import ROWS_FILE, RowFile
from exunet.studies.study import Progress, Study, StudyTable

TOGETHER = 8  # designs that are proposed before their scores are known
FRESH = 200  # samples of the final comparison
FRONT = 5  # designs of a front that are compared
GIVEN = "given"

Values = dict[str, Any]  # by key
Scores = tuple[float, ...]


@dataclass(frozen=True)
class Trial:
    """Values by key, what is maximised with its sign, and margins of constraints (broken below 0)."""

    values: Values
    scores: Scores
    margins: Scores

    @property
    def feasible(self) -> bool:
        """True if all constraints hold, and the scores are finite."""
        return min(self.margins, default=0.0) >= 0.0 and bool(np.isfinite(self.scores).all())


@dataclass(frozen=True)
class Optimum:
    """All designs of a search, the number of the best (of those of a front), the folder of fresh samples."""

    trials: list[Trial]
    best: list[int]
    fresh: str | None

    @classmethod
    def of(cls, table: StudyTable) -> Optimum | None:
        """Return what is stored with the rows of the given design; None before the end of a search."""
        if (stored := table.files.about("optimum")) is None:
            return None
        trials = [Trial(t["values"], tuple(t["scores"]), tuple(t["margins"])) for t in stored["trials"]]
        return cls(trials, stored["best"], stored["fresh"])


def search(
    over: Mapping[str, InputConfig],
    objectives: int,
    designs: int,
    seed: int,
    score: Callable[[int, Sequence[Values]], Sequence[tuple[Scores, Scores]]],
) -> list[Trial]:
    """Propose and score designs, eight at a time; raises MissingExtra without optuna.

    score : from the number of the first of some designs, and these, to scores and margins of each

    Notes
    -----
    A tree-structured Parzen estimator (Bergstra et al. 2011), for two objectives NSGA-II (Deb et al. 2002,
    doi:10.1109/4235.996017) with eight designs a generation.
    """
    optuna = _optuna()
    ranges = {key: _range(optuna.distributions, item) for key, item in over.items()}
    trials: list[Trial] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(seed=seed)
        if objectives > 1:
            sampler = optuna.samplers.NSGAIISampler(population_size=TOGETHER, seed=seed)
        asked = optuna.create_study(sampler=sampler, directions=["maximize"] * objectives)
        while len(trials) < designs:
            questions = [asked.ask(ranges) for _ in range(min(TOGETHER, designs - len(trials)))]
            listed = [
                {key: item.choice[values[key]] if item.choice else values[key] for key, item in over.items()}
                for values in (question.params for question in questions)
            ]
            answers = score(len(trials), listed)
            for question, values, (scores, margins) in zip(questions, listed, answers, strict=True):
                for number, margin in enumerate(margins):
                    question.set_constraint(str(number), -margin)
                if np.isfinite(scores).all():
                    asked.tell(question, scores)
                else:
                    asked.tell(question, state=optuna.trial.TrialState.FAIL)
                trials.append(Trial(values, scores, margins))
    return trials


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise MissingExtra("[optimise] needs optuna: pip install 'exunet[optimise]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def _range(distributions: Any, item: InputConfig) -> Any:
    if item.choice is not None:
        return distributions.CategoricalDistribution(range(len(item.choice)))
    if item.integer is not None:
        return distributions.IntDistribution(*item.integer)
    return distributions.FloatDistribution(*(item.uniform or item.log_uniform or ()), log=not item.uniform)


def best_of(trials: Sequence[Trial]) -> list[int]:
    """Return the number of the best feasible design; of two objectives those of a front, at most five."""
    scores = {k: np.array(trial.scores) for k, trial in enumerate(trials) if trial.feasible}
    front = [
        k for k, own in scores.items()
        if not any((s >= own).all() and ((s > own).any() or j < k) for j, s in scores.items())
    ]  # fmt: skip
    front.sort(key=lambda k: trials[k].scores)
    chosen = np.linspace(0, len(front) - 1, min(FRONT, len(front))).round().astype(int)
    return [front[k] for k in chosen]


def gain(quantity: Statistic, first: Floats, second: Floats, seed: int) -> estimates.Interval:
    """Return how much better the second of two designs with the same samples is, at a level of 95 %.

    Of a probability with the interval of `paired_outcomes`, of a quantile with that of a paired bootstrap.
    """
    if quantity.part is None:
        found = estimates.paired_outcomes(first, second)
        return estimates.Interval(
            quantity.sign * found.difference, *sorted(quantity.sign * end for end in (found.low, found.high))
        )

    def difference(a: Floats, b: Floats) -> float:
        return quantity.value(b) - quantity.value(a)

    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of constant values
        ends = stats.bootstrap(
            (first, second), difference, paired=True, vectorized=False, n_resamples=estimates.RESAMPLES,
            confidence_level=estimates.LEVEL, method="percentile", rng=np.random.default_rng(seed),
        ).confidence_interval  # fmt: skip
    return estimates.Interval(difference(first, second), float(ends.low), float(ends.high))


@takes(study=Study, progress=Callable, note=Callable)
def optimise(
    study: Study,
    folder: str | Path,
    workers: int | None = None,
    *,
    client: Any = None,
    progress: Progress | None = None,
    note: Callable[[str], None] | None = None,
) -> StudyTable:
    """Search for the best values of the keys of `[optimise]`, or go on; parameters as of `Study.run`.

    The given design and the best run fresh samples at the end. Returns the table of the given design;
    `Optimum.of` it has the designs. Raises as `Study.run`, and MissingExtra without optuna.
    """
    folder, config = path_of(folder, "optimise"), study.config.optimise
    if config is None:
        raise InputError("optimise: the study has no table [optimise]")
    _optuna()
    done, total = 0, runs_of(study)
    if note is not None:
        words = (
            f"{config.designs} designs and the given one x {study.config.points} runs, {FRESH} fresh runs of"
        )
        note(f"{words} each that is compared: at most {total:,} runs")

    def run(part: Study, place: Path) -> StudyTable:
        nonlocal done
        before, done = done, done + part.config.number_of_rows
        update = None if progress is None else lambda count, _: progress(before + count, total)
        return part.run(place, workers, client=client, progress=update, note=note)

    def overrides(values: Values) -> list[str]:
        return [text for key, item in config.over.items() for text in item.overrides(key, values)]

    def score(first: int, designs: Sequence[Values]) -> list[tuple[Scores, Scores]]:
        names = {str(first + k): overrides(values) for k, values in enumerate(designs)}
        table = run(study.variant(names), folder / "designs" / str(first))
        return [scores_of(config, table, name) for name in names]

    table = run(study, folder)
    trials = search(config.over, len(config.maximise), config.designs, study.config.seed, score)
    fresh, best = None, best_of(trials)
    if best:
        fresh = "-".join(["fresh", *map(str, best)])
        names = {GIVEN: list[str]()} | {str(k): overrides(trials[k].values) for k in best}
        more = {"design": "random", "runs": FRESH, "seed": study.config.seed + 1}
        run(study.variant(names, **more), folder / fresh)
    with closing(RowFile(folder / ROWS_FILE)) as rows:
        rows.note(optimum=asdict(Optimum(trials, best, fresh)))
    return table


def runs_of(study: Study) -> int:
    """Return the largest number of runs of a study, with those of a search and its final comparison."""
    if (config := study.config.optimise) is None:
        return study.config.number_of_rows
    compared = 2 if len(config.maximise) == 1 else 1 + FRONT
    return (1 + config.designs) * study.config.points + compared * FRESH


def scores_of(config: OptimiseConfig, table: StudyTable, design: str) -> tuple[Scores, Scores]:
    """Return what is maximised of a design, and the margins of the constraints."""
    mine = table.of_design(design)
    values = [(item.value(table.responses(item.name)[mine]), item.bound) for item in config.quantities]
    scores = tuple(value for value, bound in values if bound is None)
    return scores, tuple(value - bound for value, bound in values if bound is not None)
