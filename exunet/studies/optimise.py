"""Optimisation of keys of a case; each design is judged by all runs of a study, with the same samples.

Designs are asked for eight at a time and scored in order: workers do not change the result. Each portion of
eight is a study with `designs` in a folder of its own. Going on asks for the same designs, whose rows are
there.
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

from exunet.base.arrays import Floats
from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import path_of
from exunet.studies import estimates
from exunet.studies.inputs import InputConfig, OptimiseConfig, Quantity
from exunet.studies.rows import ROWS_FILE, RowFile
from exunet.studies.study import Progress, Study, StudyTable

TOGETHER = 8  # designs that are asked for before their scores are known
FRESH = 200  # samples of the final comparison
FRONT = 5  # designs of a front that are compared
GIVEN = "given"

Values = dict[str, Any]  # by key
Scores = tuple[float, ...]


@dataclass(frozen=True)
class Trial:
    """A design that was tried.

    values  : by key
    scores  : of what is maximised, with its sign
    margins : of the constraints, 0 or more where they hold
    """

    values: Values
    scores: Scores
    margins: Scores

    @property
    def feasible(self) -> bool:
        """True if all constraints hold, and the scores are finite."""
        return min(self.margins, default=0.0) >= 0.0 and bool(np.isfinite(self.scores).all())


def search(
    over: Mapping[str, InputConfig],
    objectives: int,
    designs: int,
    seed: int,
    score: Callable[[int, Sequence[Values]], Sequence[tuple[Scores, Scores]]],
) -> list[Trial]:
    """Ask for designs and score them, eight at a time.

    Parameters
    ----------
    over : mapping of str to InputConfig
        Ranges by key.
    objectives, designs, seed : int
        Number of scores that are maximised, one or two; number of designs; seed of the sampler.
    score : callable
        From the number of the first of some designs, and these, to scores and margins of each.

    Returns
    -------
    list of Trial
        In the order of the questions.

    Raises
    ------
    MissingExtra
        Without optuna.

    Notes
    -----
    A tree-structured Parzen estimator (Bergstra et al. 2011), for two objectives NSGA-II (Deb et al. 2002,
    doi:10.1109/4235.996017) with eight designs a generation.
    """
    optuna = _optuna()
    two, ranges = objectives > 1, {key: _range(optuna, item) for key, item in over.items()}
    trials: list[Trial] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = (
            optuna.samplers.NSGAIISampler(population_size=TOGETHER, seed=seed) if two
            else optuna.samplers.TPESampler(seed=seed)
        )  # fmt: skip
        asked = optuna.create_study(sampler=sampler, directions=["maximize"] * objectives)
        while len(trials) < designs:
            questions = [asked.ask(ranges) for _ in range(min(TOGETHER, designs - len(trials)))]
            values = [
                {key: item.choice[trial.params[key]] if item.choice else trial.params[key]
                 for key, item in over.items()}
                for trial in questions
            ]  # fmt: skip
            answers = score(len(trials), values)
            for question, given, (scores, margins) in zip(questions, values, answers, strict=True):
                for number, margin in enumerate(margins):
                    question.set_constraint(str(number), -margin)
                finite = bool(np.isfinite(scores).all())
                asked.tell(
                    question, scores if finite else None, None if finite else optuna.trial.TrialState.FAIL
                )
                trials.append(Trial(given, tuple(scores), tuple(margins)))
    return trials


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise MissingExtra("[optimise] needs optuna: pip install 'exunet[optimise]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def _range(optuna: Any, item: InputConfig) -> Any:
    if item.choice is not None:
        return optuna.distributions.CategoricalDistribution(range(len(item.choice)))
    if item.integer is not None:
        return optuna.distributions.IntDistribution(*item.integer)
    ends: Any = item.uniform or item.log_uniform
    return optuna.distributions.FloatDistribution(*ends, log=item.log_uniform is not None)


def best_of(trials: Sequence[Trial]) -> list[int]:
    """Return the number of the best feasible design; of two objectives those of a front, at most five."""
    there = [k for k, trial in enumerate(trials) if trial.feasible]
    scores = {k: np.array(trials[k].scores) for k in there}
    front = [
        k for k in there
        if not any((scores[j] >= scores[k]).all() and ((scores[j] > scores[k]).any() or j < k) for j in there)
    ]  # fmt: skip
    front.sort(key=lambda k: trials[k].scores)
    return (
        [front[k] for k in np.unique(np.linspace(0, len(front) - 1, FRONT).round().astype(int))]
        if front
        else []
    )


def gain(quantity: Quantity, first: Floats, second: Floats, seed: int) -> estimates.Interval:
    """Return how much better the second of two designs with the same samples is, at a level of 95 %.

    Of a probability with the interval of `paired_outcomes`, of a quantile with that of a paired bootstrap.
    """
    if quantity.part is None:
        found = estimates.paired_outcomes(first, second)
        ends = sorted(quantity.sign * end for end in (found.low, found.high))
        return estimates.Interval(quantity.sign * found.difference, *ends)

    def difference(a: Floats, b: Floats) -> float:
        return quantity.value(b) - quantity.value(a)

    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of constant values
        ends = stats.bootstrap(
            (first, second), difference, paired=True, vectorized=False, n_resamples=estimates.RESAMPLES,
            confidence_level=estimates.LEVEL, method="percentile", rng=np.random.default_rng(seed),
        ).confidence_interval  # fmt: skip
    return estimates.Interval(difference(first, second), float(ends.low), float(ends.high))


@dataclass(frozen=True)
class Optimum:
    """What an optimisation has found, as it is stored with the rows of the given design.

    trials : all designs, in order
    best   : number of the best design, or of those of a front
    fresh  : folder, in that of the study, with fresh samples of the given design and of the best
    """

    trials: list[Trial]
    best: list[int]
    fresh: str | None

    @classmethod
    def of(cls, table: StudyTable) -> Optimum | None:
        """Return what is stored with a table; None without an optimisation, or before its end."""
        if (stored := table.files.about("optimum")) is None:
            return None
        return cls([Trial(**trial) for trial in stored["trials"]], stored["best"], stored["fresh"])


def optimise(
    study: Study,
    folder: str | Path,
    workers: int | None = None,
    *,
    client: Any = None,
    progress: Progress | None = None,
    note: Callable[[str], None] | None = None,
) -> StudyTable:
    """Search for the best values of the keys of `[optimise]`, or go on with the search of a folder.

    Parameters as of `Study.run`. The given design and the best run 200 fresh samples at the end.

    Returns
    -------
    StudyTable
        Of the given design; `Optimum.of` has the designs that were tried.

    Raises
    ------
    CaseError, InputError, Interrupted
        As `Study.run`; InputError for a study without `[optimise]`.
    MissingExtra
        Without optuna.
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

    def score(first: int, designs: Sequence[Values]) -> list[tuple[Scores, Scores]]:
        names = {str(first + k): overrides_of(config, values) for k, values in enumerate(designs)}
        table = run(study.variant(names), folder / "designs" / str(first))
        return [scores_of(config, table, name) for name in names]

    table = run(study, folder)
    trials = search(config.over, len(config.maximise), config.designs, study.config.seed, score)
    fresh, best = None, best_of(trials)
    if best:
        fresh = "-".join(["fresh", *map(str, best)])
        names = {GIVEN: ()} | {str(k): overrides_of(config, trials[k].values) for k in best}
        more = {"design": "random", "runs": FRESH, "seed": study.config.seed + 1}
        run(study.variant(names, **more), folder / fresh)
    with closing(RowFile(folder / ROWS_FILE)) as rows:
        rows.note(optimum=asdict(Optimum(trials, best, fresh)))
    return table


def runs_of(study: Study) -> int:
    """Return the largest number of runs of a search, with those of its final comparison."""
    config = study.config.optimise
    if config is None:
        return study.config.number_of_rows
    compared = 2 if len(config.maximise) == 1 else 1 + FRONT
    return (1 + config.designs) * study.config.points + compared * FRESH


def overrides_of(config: OptimiseConfig, values: Values) -> list[str]:
    """Return the overrides of a design."""
    return [text for key, item in config.over.items() for text in item.overrides(key, {key: values[key]})]


def scores_of(config: OptimiseConfig, table: StudyTable, design: str) -> tuple[Scores, Scores]:
    """Return what is maximised of a design, and the margins of the constraints."""
    mine, scores, margins = table.of_design(design), list[float](), list[float]()
    for quantity in config.quantities:
        value = quantity.value(table.responses(quantity.name)[mine])
        if quantity.bound is None:
            scores.append(value)
        else:
            margins.append(value - quantity.bound)
    return tuple(scores), tuple(margins)
