"""Studies: many runs of a case with inputs from distributions or lists, and the table of their rows."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import re
import time as clock
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic.fields import FieldInfo

from exunet.base.arguments import takes
from exunet.base.arrays import Ints
from exunet.base.errors import CaseError, Fault, InputError, Interrupted, MissingExtra
from exunet.base.files import cannot_write, path_of, replacing
from exunet.base.key_path import KeyPath, closest, key_path
from exunet.base.record import Record
from exunet.results.outcome import Outcome
from exunet.results.result import table
from exunet.results.run_folder import held
from exunet.scene.casefile import Case, key_lines, parse_case, parse_record, place_of_override, read_text
from exunet.scene.scene import Scene
from exunet.scene.validation import validated_record
from exunet.simulation.preparation import Start, prepare_case
from exunet.studies.executor import (
    ClusterLane,
    Done,
    Job,
    Lane,
    ProcessLane,
    Work,
    lanes_on_this_machine,
    mesh_files,
    replicate_of,
    run_jobs,
    versions,
)
from exunet.studies.inputs import MAX_OUTSIDE, InputConfig, Sample, Samples, StudyConfig
from exunet.studies.rows import FAILED, FIXED, INVALID, OK, Row, RowFile, RowFiles, file_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

    from exunet.studies.estimates import Estimate

CHECKED = 200  # samples that are prepared before any run
KEPT = "runs"  # folder of full results
_CHUNK = 256  # samples that are drawn together
_MENDS = {"solver.step": 'set = ["solver="] lets each run choose its step'}  # by key of the fault
_NOT_IN_ALL = re.compile(r"capture_time_s|escape_time_s|first_break_s|script_.*|time_of_.*|.*_first_.*")

Progress = Callable[[int, int], None]


class Study:
    """Many runs of a case, with inputs from distributions or lists.

    Parameters
    ----------
    case : str or Path
        Case file.
    design : {"random", "lhs", "grid", "saltelli"}
        How samples are chosen.
    inputs : mapping
        By key of the case: a table such as {"normal": [8.0, 0.4]}, a frozen distribution of scipy.stats, or a
        list, of a grid.
    runs : int, optional
        Number of samples; of saltelli a power of 2; not for a grid.
    seed : int
        Seed of the random streams.
    more
        Further keys of a study's file: set, designs, replicates, outputs, title, time_limit.

    Raises
    ------
    CaseError
        With all faults of the study, and of its cases.
    """

    def __init__(
        self,
        case: str | Path,
        *,
        design: str = "random",
        inputs: Mapping[str, Any],
        runs: int | None = None,
        seed: int = 0,
        **more: Any,
    ) -> None:
        path = path_of(case, "Study").resolve()
        given = {"case": str(path), "design": design, "inputs": dict(inputs), "seed": seed, **more}
        config, found = validated_record(given if runs is None else given | {"runs": runs}, StudyConfig)
        if config is None:
            faults = [Fault("", f"{'.'.join(map(str, paths[0]))}: {words}") for paths, words in found]
            raise CaseError(faults)
        self._begin(config, path.parent, None)

    @classmethod
    def read(cls, path: str | Path, *, runs: int | None = None) -> Study:
        """Read a study's file; runs: another number of samples.

        Raises InputError if the file cannot be read, and CaseError with all faults, with file and line.
        """
        path = path_of(path, "Study.read")
        text = read_text(path)
        config = parse_record(text, path, StudyConfig)
        if runs is not None:
            try:
                config = StudyConfig.model_validate(config.model_dump(exclude_unset=True) | {"runs": runs})
            except ValueError as error:
                raise InputError(f"runs: {' '.join(str(error).split())}") from None
        return cls._of(config, path.parent, (text, path))

    @classmethod
    def of_folder(cls, folder: str | Path) -> Study:
        """Return the study that has written into a folder, with its cases as their files are now."""
        stored = RowFiles(path_of(folder, "Study.of_folder")).about("study")
        return cls._of(StudyConfig.model_validate(stored["config"]), Path(stored["folder"]), None)

    @classmethod
    def _of(cls, *given: Any) -> Study:
        study = cls.__new__(cls)
        study._begin(*given)
        return study

    def _begin(
        self,
        config: StudyConfig,
        folder: Path,
        source: tuple[str, Path] | None,
        cases: tuple[tuple[str, Path], ...] | None = None,
    ) -> None:
        self.config, self.folder = config, folder
        self._source = source
        if cases is None:
            names = [design.case or config.case for design in config.designs] or [config.case]
            paths = [folder / name for name in names]
            texts = {path: read_text(path) for path in paths}
            cases = tuple((texts[path], path) for path in paths)
        self._cases = cases
        self._lines = key_lines(source[0]) if source else {}

    @property
    def name(self) -> str:
        """Name of the study's file, or of its case, without ending."""
        return (self._source[1] if self._source else self._cases[0][1]).stem

    @property
    def title(self) -> str:
        """Title of the study, or of its case."""
        return self.config.title or self._base(0).scene.title

    @property
    def cases(self) -> int:
        """Number of cases."""
        return self.config.points * self.config.cases_of_point

    def _overrides(self, design: int) -> tuple[str, ...]:
        """Return the overrides of all cases of a design."""
        own = self.config.designs[design].set if self.config.designs else ()
        return (*self.config.set, *own)

    def _base(self, design: int) -> Case:
        """Return the case of a design without the inputs."""
        return parse_case(*self._cases[design], self._overrides(design))

    @cached_property
    def samples(self) -> Samples:
        """The samples."""
        attitudes: dict[tuple[int, str], Sequence[float]] = {}
        for key, item in self.config.inputs.items():
            for design in range(len(self._cases)) if item.kind == "tilt" else ():
                value = value_at(self._base(design).scene, key_path(key))
                attitudes[design, key] = (1.0, 0.0, 0.0, 0.0) if value is None else value
        return Samples(self.config, attitudes)

    def overrides(self, run: int, sample: Sample) -> tuple[str, ...]:
        """Return the overrides of a case with the values of its inputs."""
        own = (o for key, item in self.config.inputs.items() for o in item.overrides(key, sample))
        return (*self._overrides(self.samples.design(run)), *own)

    def case(self, run: int) -> Case:
        """Return the case with this number, from 0."""
        return self._case(run, self.samples.of_runs([self._number(run)])[0])

    def _number(self, run: int) -> int:
        if not 0 <= run < self.cases:
            raise InputError(f"run: must be from 0 to {self.cases - 1}, got {run}")
        return run

    def _case(self, run: int, sample: Sample) -> Case:
        return parse_case(*self._cases[self.samples.design(run)], self.overrides(run, sample))

    # Refusals

    def validate(self) -> None:
        """Raise CaseError for keys, distributions and samples with which runs would be refused.

        The first 200 samples are prepared.
        """
        faults: list[Fault] = []
        for design in range(len(self._cases)):
            scene = self._base(design).scene
            for key, item in self.config.inputs.items():
                faults += self._faults_of_input(design, scene, key, item)
        if not faults:
            faults = self._faults_of_samples()
        if faults:
            raise CaseError(list(dict.fromkeys(faults)))

    def _faults_of_input(self, design: int, scene: Scene, key: str, item: InputConfig) -> list[Fault]:
        here = self._place("inputs", key)
        try:
            path = key_path(key)
        except ValueError as error:
            return [Fault("", f'"{key}": {error}', place=here)]
        before = value_at(scene, path)
        if item.frozen is not None and (isinstance(before, bool | str | Mapping | Record)):
            return [Fault(key, f"requires a number, and is {_kind(before)}", place=here)]
        sample = item.draw(key, np.full((1, item.dimensions), 0.5))
        options = [*item.overrides(key, {name: values[0] for name, values in sample.items()})]
        try:
            case = parse_case(*self._cases[design], (*self._overrides(design), *options))
        except CaseError as error:
            return [Fault(fault.key, fault.reason, place=here) for fault in error.faults]
        if item.frozen is None:
            return []
        low, high = bounds_of(case.scene, path)
        if (share := item.outside(low, high)) > MAX_OUTSIDE:
            inside = f"[{max(low, -1e300):.4g}, {min(high, 1e300):.4g}]".replace("1e+300", "inf")
            words = f"{share:.2%} of the distribution is outside the bounds {inside} of the key: give bounds"
            return [Fault(key, words, place=here)]
        return []

    def _faults_of_samples(self) -> list[Fault]:
        number, failed, first = min(CHECKED, self.cases), 0, list[Fault]()
        samples = self.samples.of_runs(range(number))
        for run, sample in enumerate(samples):
            try:
                prepare_case(self._case(run, sample))
            except CaseError as error:
                failed += 1
                first = first or [self._of_sample(run, sample, fault) for fault in error.faults]
        if failed > 1:
            words = f"{failed} of the first {number} samples cannot be prepared"
            first.append(Fault("", words, place=self._place("inputs")))
        return first

    def _of_sample(self, run: int, sample: Sample, fault: Fault) -> Fault:
        places = {
            place_of_override(option): self._place("inputs", key)
            for key, item in self.config.inputs.items()
            for option in item.overrides(key, sample)
        }
        mends = _MENDS.get(fault.key, "")
        words = f"sample {run}: {fault.reason}{'; ' if mends else ''}{mends}"
        return Fault(fault.key, words, place=places.get(fault.place, fault.place))

    def _place(self, *path: str) -> str:
        if self._source is None:
            return ": ".join(path)
        line = next((self._lines[path[:k]] for k in (2, 1) if path[:k] in self._lines), 1)
        return f"{self._source[1]}:{line}"

    # Runs

    def validate_outputs(self, metrics: Iterable[str]) -> None:
        """Raise CaseError for an output that is not among the metrics of a run, nor depends on its events."""
        faults = []
        for key in ("print", "limits"):
            for name in getattr(self.config.outputs, key):
                if name not in metrics and not _NOT_IN_ALL.fullmatch(name):
                    near = closest(name, metrics)
                    hint = f"; did you mean '{near}'?" if near else ""
                    place = self._place("outputs", key)
                    faults.append(
                        Fault(f"outputs.{key}", f"{name} is no metric of the case{hint}", place=place)
                    )
        if faults:
            raise CaseError(faults)

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Return what rows of one table have in common: samples, cases, and hashes of other files."""
        kept = self.config.model_dump(mode="json", exclude={"title", "outputs", "time_limit", "case"})
        if self.config.design == "random":
            kept.pop("runs")
        files = {}
        for design in range(len(self._cases)):
            for key, path in mesh_files(self._base(design)).items():
                with suppress(OSError):
                    files[key] = hashlib.sha256(path.read_bytes()).hexdigest()
        texts = [hashlib.sha256(text.encode()).hexdigest() for text, _ in self._cases]
        found: dict[str, Any] = json.loads(json.dumps({"study": kept, "cases": texts, "files": files}))
        return found

    def _refuse_other(self, stored: dict[str, Any], folder: Path) -> None:
        """Raise InputError if a folder has rows of another study, or of another state of the case."""
        if stored == self.identity:
            return
        own = self.identity
        changed = [
            f"the mesh of {key}" for key in own["files"] if stored["files"].get(key) != own["files"][key]
        ]
        if stored["cases"] != own["cases"]:
            changed = ["the case", *changed]
        keys = own["study"].keys() | stored["study"].keys()
        changed += sorted(key for key in keys if own["study"].get(key) != stored["study"].get(key))
        words = f"has rows of another study ({', '.join(changed)} differs)"
        raise InputError(f"{folder}: {words}: give a new folder, or the study and case as they were")

    @takes(progress=Callable)
    def run(
        self,
        folder: str | Path,
        workers: int | None = None,
        *,
        client: Any = None,
        shard: tuple[int, int] | None = None,
        progress: Progress | None = None,
        note: Callable[[str], None] | None = None,
    ) -> StudyTable:
        """Compute the rows that a folder does not have yet.

        Parameters
        ----------
        folder : str or Path
            For study.sqlite, and the results that are kept.
        workers : int, optional
            Processes of this machine; 1: none but this one; None: one a core.
        client : distributed.Client, optional
            Dask cluster that computes the runs, instead of processes of this machine.
        shard : (int, int), optional
            (k, n): only the rows whose number modulo n is k, into a file of their own.
        progress : callable, optional
            Called with the number of rows that are there, and of all.
        note : callable, optional
            Called with notes in words, such as on fewer workers.

        Raises
        ------
        CaseError, InputError
            Before any run, for what would be refused, or a folder with rows of another study; after the first
            run for an output that is no metric; when the disk is full.
        Interrupted
            On Ctrl-C; complete rows are stored.
        """
        folder = path_of(folder, "run")
        workers = _validated(workers, shard)
        file = folder / file_of(shard)
        there = list(folder.glob("study*.sqlite"))
        if there:
            self._refuse_other(RowFiles(folder).about("identity"), folder)
        if file not in there:
            self.validate()
            with _writing(folder):
                folder.mkdir(parents=True, exist_ok=True)
        lock = folder if shard is None else _lock_file(folder, shard)
        with held(lock):
            if not file.is_file():
                RowFile.create(file, self._about(), self._types()).close()
            with closing(RowFile(file)) as rows:
                rows.note(study=self._stored(), identity=self.identity)
                runner = _Runner(self, rows, folder, shard, progress, note)
                runner.run(workers, client)
        return StudyTable(folder)

    def _about(self) -> dict[str, Any]:
        cases = [(text, str(path.resolve())) for text, path in self._cases]
        return {"cases": cases, "versions": versions(), "wall_s": 0.0, "workers": 1}

    def _stored(self) -> dict[str, Any]:
        config = self.config.model_dump(mode="json", exclude_unset=True)
        text, name = ("", self.name) if self._source is None else (self._source[0], self.name)
        return {"config": config, "text": text, "name": name, "folder": str(self.folder.resolve())}

    def _types(self) -> dict[str, str]:
        """Return the type of each column of inputs; without one, values are stored as they are."""
        kinds = {"choice": "", "values": "", "integer": "INTEGER"}
        inputs = self.config.inputs.items()
        return {name: kinds.get(item.kind, "REAL") for key, item in inputs for name in item.columns(key)}


class _Runner:
    """Computes the missing rows of a file."""

    def __init__(
        self,
        study: Study,
        rows: RowFile,
        folder: Path,
        shard: tuple[int, int] | None,
        progress: Progress | None,
        note: Callable[[str], None] | None,
    ) -> None:
        self._study, self._rows, self._folder = study, rows, folder
        self._shard, self._progress = shard or (0, 1), progress
        self._note = note or (lambda _: None)
        self._inputs: dict[int, Sample] = {}
        total = study.config.number_of_rows
        there = np.zeros(total, dtype=bool)
        numbers = RowFiles(folder).numbers()  # of other shards too
        there[numbers[numbers < total]] = True
        mine = np.arange(total) % self._shard[1] == self._shard[0]
        self._left = np.flatnonzero(mine & ~there)
        self._all = int(mine.sum())
        self._count = self._all - len(self._left)
        self._checked = self._count > 0

    def run(self, workers: int, client: Any) -> None:
        """Compute all rows that are left."""
        study = self._study
        if not len(self._left):
            return
        cases = tuple((text, str(path.resolve())) for text, path in study._cases)
        work = Work(cases, study.config.outputs, study.config.time_limit)
        first: Lane = Lane() if workers == 1 else ProcessLane()
        if client is not None:
            first = ClusterLane(client, work)
        used = 1

        def lanes(_seconds: float, memory: int) -> list[Lane]:
            nonlocal used
            if client is not None or workers == 1:
                used = len(client.nthreads()) if client is not None else 1
                return [first]
            found, words = lanes_on_this_machine(min(workers, len(self._left)), first, memory)
            used = len(found)
            if words:
                self._note(words)
            return found

        began, before = clock.perf_counter(), self._rows.about("wall_s", 0.0)
        try:
            run_jobs(work, self._jobs(), first, lanes, self._take)
        except KeyboardInterrupt:
            words = f"interrupted after {self._count} of {self._all} runs"
            raise Interrupted(f"{words}; to go on: exunet resume {self._folder}") from None
        finally:
            with suppress(InputError):
                self._rows.note(wall_s=before + clock.perf_counter() - began, workers=used)

    def _jobs(self) -> Iterator[Job]:
        study, numbers = self._study, iter(self._left.tolist())
        while chunk := list(islice(numbers, _CHUNK)):
            places = [study.samples.place(number) for number in chunk]
            samples = study.samples.of_runs([place.run for place in places])
            for number, place, sample in zip(chunk, places, samples, strict=True):
                self._inputs[number] = sample
                design = study.samples.design(place.run)
                overrides = study.overrides(place.run, sample)
                yield Job(number, place.run, place.replicate, design, overrides)

    def _take(self, found: list[Done]) -> None:
        """Store the rows of a portion."""
        designs, rows = self._study.config.designs, []
        for done in found:
            job = done.job
            name = designs[job.design].name if designs else ""
            row = Row(
                job.row, job.run, job.replicate, name, self._inputs.pop(job.row), done.status, done.outcome,
                done.seconds, done.note, done.metrics, done.about,
            )  # fmt: skip
            rows.append(row)
            if done.result is not None:
                with _writing(self._folder):
                    (self._folder / KEPT).mkdir(exist_ok=True)
                with replacing(self._folder / KEPT / f"{name_of(job.run, job.replicate)}.h5") as part:
                    part.write_bytes(done.result)
        self._rows.add(rows)
        self._count += len(rows)
        if not self._checked and (whole := [row for row in rows if row.status == OK]):
            self._checked = True
            self._study.validate_outputs(whole[0].metrics)
        if self._progress is not None:
            self._progress(self._count, self._all)


class StudyTable:
    """The rows of a study: inputs, outcome, metrics, status, seconds of each run.

    Columns are read from the files one at a time.

    Parameters
    ----------
    folder : str or Path
        Into which the study has written.

    Raises
    ------
    InputError
        If there is no study in the folder, or its files are damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = path_of(folder, "StudyTable")
        self._files = RowFiles(self.folder)
        stored = self._files.about("study")
        self._name: str = stored["name"]
        cases = tuple((text, Path(path)) for text, path in self._files.about("cases"))
        config = StudyConfig.model_validate(stored["config"])
        source = (stored["text"], Path(stored["folder"]) / f"{self._name}.toml") if stored["text"] else None
        self.study = Study._of(config, Path(stored["folder"]), source, cases)

    @property
    def config(self) -> StudyConfig:
        """Keys of the study."""
        return self.study.config

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def numbers(self) -> Ints:
        """Numbers (rows,) of the rows that are there."""
        return self._files.numbers()

    @property
    def complete(self) -> bool:
        """True if all rows are there."""
        return len(self) >= self.config.number_of_rows

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs; of a vector, its length, or the angle of a tilt."""
        return tuple(self.config.inputs)

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics, as of `exunet.metrics`."""
        fixed = {*FIXED, *self.config.columns}
        return tuple(name for name in self._files.columns if name not in fixed)

    def about(self, metric: str) -> tuple[str, str]:
        """Return name in tables, and unit, of a metric."""
        found = next(about[metric] for about in self._files.abouts("metrics") if metric in about)
        return found[0], found[1]

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (rows,): an input, a metric (NaN where a run does not have it), status, ..."""
        if name not in self._files.columns:
            raise InputError(f"column: {name!r} is not one of {', '.join(self._files.columns)}")
        return self._files.column(name)

    @property
    def outcome(self) -> NDArray[Any]:
        """Capture outcomes (rows,), "" where a case has no criterion."""
        return self._texts("outcome")

    @property
    def status(self) -> NDArray[Any]:
        """Status (rows,): ok, stopped, invalid or failed."""
        return self._texts("status")

    @property
    def seconds(self) -> NDArray[Any]:
        """Wall time (rows,) of each run [s]."""
        return self.column("seconds")

    def _texts(self, name: str) -> NDArray[Any]:
        return np.array([text if isinstance(text, str) else "" for text in self.column(name)], dtype=object)

    def of_design(self, design: str | None = None) -> NDArray[np.bool_]:
        """Return (rows,) which rows are of a design, by its name; None: all, which requires a single one."""
        names = [item.name for item in self.config.designs]
        if design is None and len(names) > 1:
            raise InputError(f"design: must be one of {', '.join(names)}")
        if design is not None and design not in names:
            raise InputError(f"design: must be one of {', '.join(names) or 'None'}, got {design!r}")
        found: NDArray[np.bool_] = self._texts("design") == (design or (names[0] if names else ""))
        return found

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """(rows,) which rows have no outcome: undetermined, failed or invalid."""
        no_run = np.isin(self.status, (FAILED, INVALID))
        return no_run | (self.outcome == Outcome.UNDETERMINED.value)

    def probability(self, outcome: str, design: str | None = None, level: float = 0.95) -> Estimate:
        """Return the probability of an outcome, with its interval of confidence.

        Rows without an outcome count as not having it at the low end, and as having it at the high end.

        Parameters
        ----------
        outcome : str
            Capture outcome, such as "captured".
        design : str, optional
            Name of one of several designs.
        level : float
            Level of confidence.

        Raises
        ------
        InputError
            For an unknown outcome or design, or a case without [capture].
        """
        from exunet.studies import estimates

        if outcome not in list(Outcome):
            raise InputError(f"outcome: must be one of {', '.join(Outcome)}, got {outcome!r}")
        mine, found = self.of_design(design), self.outcome
        if not (found != "").any():
            raise InputError("outcome: the case has no criterion: add [capture]")
        hits, lost = int((found[mine] == outcome).sum()), int(self.undetermined[mine].sum())
        if outcome == Outcome.UNDETERMINED.value:
            lost = int(np.isin(self.status[mine], (FAILED, INVALID)).sum())
        return estimates.probability(hits, int(mine.sum()), lost, level)

    def to_pandas(self) -> DataFrame:
        """Return all columns as a pandas table: one row for each run; MissingExtra without pandas."""
        columns = {name: self.column(name) for name in self._files.columns if name != "id"}
        return table("row", self.numbers, columns)

    def to_xarray(self) -> Dataset:
        """Return all columns as an xarray data set along "row", with units; MissingExtra without xarray."""
        try:
            from xarray import Dataset
        except ImportError:
            words = "a data set of a study needs xarray: pip install 'exunet[studies]'"
            raise MissingExtra(words) from None
        found: dict[str, Any] = {}
        for name in self._files.columns:
            words, unit = (
                self.about(name) if name in self.metrics else (name, "s" if name == "seconds" else "")
            )
            found[name] = ("row", self.column(name), {"units": unit, "long_name": words})
        found.pop("id")
        return Dataset(found, {"row": self.numbers})

    def row(self, run: int, replicate: int = 0) -> dict[str, Any]:
        """Return all columns of a run; raises InputError if it is not there."""
        found = self._files.row(self.study.samples.row(self.study._number(run), replicate))
        if found is None:
            raise InputError(f"run: {run} is not there yet: exunet resume {self.folder}")
        return found

    def case(self, run: int) -> Case:
        """Return the case of a run, whose `exunet.run` has the metrics of its row, bit by bit.

        run : number of the case, from 0
        """
        row = self._files.row(self.study.samples.row(self.study._number(run)))
        if row is None:
            return self.study.case(run)
        sample = {name: row[name] for name in self.config.columns}
        for key, item in self.config.inputs.items():
            if item.kind in ("choice", "values"):  # which SQLite may have stored as another type
                sample[key] = self.study.samples.of_runs([run])[0][key]
        return self.study._case(run, sample)

    def start(self, run: int, replicate: int = 0) -> Start:
        """Return the start of a replicate of a run; 0: that of the case, from 1 on perturbed by 1e-9 m."""
        most = 1 if self.config.design == "saltelli" else self.config.replicates - 1
        if not 0 <= replicate <= most:
            raise InputError(f"replicate: must be from 0 to {most}, got {replicate}")
        return replicate_of(self.case(run), replicate)

    def write_csv(self, path: str | Path) -> None:
        """Write all columns to a CSV file, which appears whole or not at all."""
        with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            names = self._files.columns
            writer.writerow(names)
            writer.writerows(self._files.rows(names))


def name_of(run: int, replicate: int) -> str:
    """Return the name of a run in folders and tables: 17, or 17.3 of a replicate."""
    return f"{run}.{replicate}" if replicate else str(run)


class _Found(NamedTuple):
    """A value in a scene, and the field of the record that has it."""

    value: Any
    field: FieldInfo | None


def _find(scene: Scene, path: KeyPath) -> _Found:
    value: Any = scene
    field: FieldInfo | None = None
    for part in path:
        if isinstance(value, Record):
            field = type(value).model_fields.get(str(part))
            value = getattr(value, str(part), None)
        elif isinstance(value, Mapping):
            value = list(value.values())[part] if isinstance(part, int) else value.get(part)
        elif isinstance(value, tuple) and isinstance(part, int):
            value = value[part]
        else:
            return _Found(None, None)
    return _Found(value, field)


def value_at(scene: Scene, path: KeyPath) -> Any:
    """Return the value of a key; None if there is none."""
    with suppress(IndexError):
        return _find(scene, path).value
    return None


def bounds_of(scene: Scene, path: KeyPath) -> tuple[float, float]:
    """Return minimum and maximum of the numbers that a key accepts, as its record declares."""
    field = _find(scene, path).field
    low, high = -math.inf, math.inf
    for item in () if field is None else (*field.metadata, *_metadata(field.annotation)):
        least = [getattr(item, name, None) for name in ("ge", "gt")]
        most = [getattr(item, name, None) for name in ("le", "lt")]
        low = max(low, *(value for value in least if value is not None), -math.inf)
        high = min(high, *(value for value in most if value is not None), math.inf)
    return low, high


def _metadata(kind: Any) -> Iterator[Any]:
    """Yield what `Annotated` states of a type and the types that it consists of."""
    for item in getattr(kind, "__metadata__", ()):
        yield from item.metadata if isinstance(item, FieldInfo) else (item,)
    for part in getattr(kind, "__args__", ()):
        yield from _metadata(part)
    if hasattr(kind, "__origin__"):
        yield from () if kind.__origin__ in (tuple, dict) else _metadata(kind.__origin__)


def _kind(value: Any) -> str:
    words = {bool: "true or false", str: "a text"}
    return words.get(type(value), "a table")


def _validated(workers: object, shard: object) -> int:
    """Return the number of workers; raises InputError for arguments of `Study.run` out of range."""
    if workers is None:
        workers = os.cpu_count() or 1
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError(f"workers: must be a whole number, 1 or more, got {workers!r}")
    if shard is not None:
        whole = isinstance(shard, tuple) and len(shard) == 2 and all(type(k) is int for k in shard)
        if not whole or not 0 <= shard[0] < shard[1]:  # type: ignore[index]
            raise InputError(f"shard: must be (k, n) with k from 0 to n - 1, got {shard!r}")
    return workers


def _lock_file(folder: Path, shard: tuple[int, int]) -> Path:
    """Return a file that stands for a shard, to be held while it is written."""
    path = folder / f".{file_of(shard)}.lock"
    with _writing(path):
        path.touch()
    return path


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error
