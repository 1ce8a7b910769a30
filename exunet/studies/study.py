"""Studies: many runs of a case with inputs from distributions or lists, and the table of their rows."""

from __future__ import annotations

import csv
import hashlib
import inspect
import json
import math
import os
import re
import time as clock
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic.fields import FieldInfo

from exunet.base.arguments import shown, takes
from exunet.base.arrays import Bools, Floats, Ints
from exunet.base.errors import CaseError, Fault, InputError, Interrupted, MissingExtra
from exunet.base.files import cannot_write, path_of, replacing
from exunet.base.key_path import KeyPath, closest, key_path
from exunet.base.record import Record
from exunet.base.validation import validated_record
from exunet.forces.effect import RestOfCase
from exunet.results.outcome import Outcome
from exunet.results.result import table
from exunet.results.run_folder import held
from exunet.scene.casefile import Case, case_of, parse_case, parse_record, place_of_override
from exunet.scene.document import key_lines, read_text
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, start_of
from exunet.studies.executor import (
    ClusterLane,
    Done,
    Job,
    Lane,
    ProcessLane,
    Work,
    built,
    lanes_on_this_machine,
    pickled,
    replicate_of,
    run_jobs,
    versions,
)
from exunet.studies.inputs import (
    NO_TURN,
    DesignConfig,
    InputConfig,
    Sample,
    Samples,
    StudyConfig,
    as_toml,
)
from exunet.studies.rows import FAILED, FIXED, INVALID, OK, RowFile, RowFiles, file_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

    from exunet.studies.estimates import Estimate, PairedMetric, PairedOutcome

CHECKED = 200  # samples that are prepared before any run
MAX_OUTSIDE = 1e-3  # mass of a distribution outside the bounds of its key
KEPT = "runs"  # folder of full results
_CHUNK = 256  # samples that are drawn together
_MENDS = {"solver.step": '; set = ["solver="] lets each run choose its step'}  # by key of the fault
_NOT_IN_ALL = re.compile(r"capture_time_s|escape_time_s|first_break_s|script_.*|time_of_.*|.*_first_.*")
_TYPES = {"choice": "", "values": "", "integer": "INTEGER"}  # "": as they are
_OF_BULLETS: dict[str, Any] = {"launch.speed_factors": 1.0, "launch.tilts": [0.0, 0.0]}  # where absent
_GOES_ON = "requires the function {}: call run of the same Study in Python, which goes on and has the cases"
_NO_IDENTITY = {"title", "outputs", "time_limit", "case", "optimise"}  # keys that change no row

Progress = Callable[[int, int], None]
Cases = tuple[tuple[str, Path], ...]  # text and path
Build = Callable[..., Scene | Start]


class Study:
    """Many runs of a case, with inputs from distributions or lists.

    Parameters
    ----------
    case : str, Path or Scene
        Case file, or scene; not with build.
    build : callable, optional
        Function of the inputs as keyword arguments that returns a Scene, or a Start of `exunet.prepare`.
    design : {"random", "lhs", "grid", "saltelli"}
        How samples are chosen.
    inputs : mapping
        By key of the case, or by argument of build: a table such as {"normal": [8.0, 0.4]}, a frozen
        distribution of scipy.stats, or a list, of a grid. A key with [*] stands for each item of a list.
    more
        Further keys of a study's file: runs, seed, set, designs, replicates, outputs, title, time_limit.

    Raises
    ------
    CaseError
        With all faults of the study.
    InputError
        For both or none of case and build, and a function that fails or returns something else.
    """

    def __init__(
        self,
        case: str | Path | Scene | None = None,
        *,
        build: Build | None = None,
        design: str = "random",
        inputs: Mapping[str, Any],
        **more: Any,
    ) -> None:
        if (case is None) == (build is None) or not (build is None or inspect.isfunction(build)):
            raise InputError(
                f"Study: requires either a case or a function as build, got build={shown(build)}"
            )
        made = case_of(case, "Study") if isinstance(case, Scene) else None
        path = path_of(f"{build.__name__}.toml" if build else made.path if made else case, "Study").resolve()
        inputs = dict(inputs) if isinstance(inputs, Mapping) else inputs
        given = {"case": str(path), "design": design, "inputs": inputs, **more}
        config, found = validated_record(given, StudyConfig)
        if config is None:
            raise CaseError([Fault(".".join(map(str, paths[0])), words) for paths, words in found])
        if build is not None:
            made = _first_built(build, config)
        self._begin(config, path.parent, made=made.text if made else None, build=build)

    @classmethod
    def read(cls, path: str | Path, *, runs: int | None = None) -> Study:
        """Read a study's file; runs: another number of samples.

        Raises InputError if the file cannot be read, and CaseError with all faults, with file and line.
        """
        path = path_of(path, "Study.read")
        more = {} if runs is None else {"runs": runs}
        config = parse_record(text := read_text(path), path, StudyConfig, more)
        return cls.__new__(cls)._begin(config, path.parent, (text, path))

    @classmethod
    def of_folder(cls, folder: str | Path) -> Study:
        """Return the study that has written into a folder, not of a function, with files as they are now."""
        stored = (files := RowFiles(path_of(folder, "Study.of_folder"))).about("study")
        if stored["build"]:
            raise InputError(f"{folder}: {_GOES_ON.format(stored['build'])}")
        config, base = StudyConfig.model_validate(stored["config"]), Path(stored["folder"])
        made = next((text for text, path in files.about("cases") if path == config.case), None)
        return cls.__new__(cls)._begin(config, base, made=made if stored["made"] else None)

    def _begin(
        self,
        config: StudyConfig,
        folder: Path,
        source: tuple[str, Path] | None = None,
        cases: Cases | None = None,
        made: str | None = None,
        build: Build | None = None,
    ) -> Study:
        # made: text of the scene that the study has instead of a file; of a function that of its first sample
        self.config, self._folder, self._source = config, folder, source
        self._made, self._build, self._function = made, build, build.__qualname__ if build else ""
        if cases is None:
            names = [design.case or config.case for design in config.designs] or [config.case]
            given = {} if made is None else {config.case: (made, Path(config.case))}
            cases = tuple(
                given.get(name) or (read_text(folder / name), (folder / name).resolve()) for name in names
            )
        self._cases, self._valid = cases, False
        self._lines = key_lines(source[0]) if source else {}
        if build is None and any("[*]" in key for key in config.inputs):
            self._each()
        return self

    def _each(self) -> None:
        """Replace an input whose key has [*] by one for each item of the list."""
        more, scene = list[str](), self._base(0).scene
        for name, value in _OF_BULLETS.items():
            given = any(key.startswith(f"{name}[*]") for key in self.config.inputs)
            if given and scene.launch is not None and _find(scene, key_path(name))[0] is None:
                values = [value] * RestOfCase(scene).n_bullets
                more.append(f"{name}={as_toml(values)}")
                scene = scene.replace({name: values})
        try:
            each = [(name, item) for key, item in self.config.inputs.items() for name in _items(scene, key)]
        except ValueError as error:
            raise CaseError([Fault("inputs", str(error), place=self._place("inputs"))]) from None
        config = self.config.model_copy(update={"inputs": dict(each), "set": (*self.config.set, *more)})
        twice = {name for k, (name, _) in enumerate(each) for other, _ in each[:k] if name == other}
        faults = [
            Fault(name, "has two inputs: remove one", place=self._place("inputs")) for name in sorted(twice)
        ]
        if faults := faults or list(config.faults()):
            raise CaseError(faults)
        self.config = config

    def variant(self, designs: Mapping[str, Sequence[str]], **more: Any) -> Study:
        """Return this study with designs, overrides by name, and other keys; samples are not validated."""
        listed = [
            DesignConfig.model_validate({"name": name, "set": list(own)}) for name, own in designs.items()
        ]
        outputs = self.config.outputs.model_copy(update={"keep": "none"})
        own = {"designs": tuple(listed), "optimise": None, "outputs": outputs, **more}
        cases = self._cases[:1] * len(listed)
        found = Study.__new__(Study)._begin(
            self.config.model_copy(update=own), self._folder, self._source, cases, self._made
        )
        found._valid = True
        return found

    @property
    def name(self) -> str:
        """Name of the study's file, or of its case, without ending."""
        return (self._source[1] if self._source else self._cases[0][1]).stem

    @property
    def title(self) -> str:
        """Title of the study, or of its case."""
        return self.config.title or self._base(0).scene.title

    @property
    def case_names(self) -> str:
        """Names of the cases, without ending."""
        return ", ".join(dict.fromkeys(path.stem for _, path in self._cases))

    @property
    def number_of_cases(self) -> int:
        """Number of cases: without replicates."""
        return self.config.points * self.config.cases_of_point

    def _overrides(self, design: int) -> tuple[str, ...]:
        own = (*self.config.set, *(self.config.designs[design].set if self.config.designs else ()))
        # The compiled loop wherever it has the scene, whatever the case says.
        given = self._function or any(text.startswith("engine") for text in own)
        return own if given else ("engine.backend=auto", *own)

    def _parsed(self, design: int, overrides: Sequence[str]) -> Case:
        return replace(parse_case(*self._cases[design], overrides), is_file=self._made is None)

    def _base(self, design: int, *more: str) -> Case:
        """Return the case of a design without the inputs; of a function with those of the first sample."""
        return self._parsed(design, (*self._overrides(design), *more))

    @cached_property
    def samples(self) -> Samples:
        """The samples."""
        attitudes: dict[tuple[int, str], Sequence[float]] = {}
        for key, item in self.config.inputs.items():
            for design in range(len(self._cases)) if item.kind == "tilt" else ():
                value, _ = _find(self._base(design).scene, key_path(key))
                attitudes[design, key] = NO_TURN if value is None else value
        return Samples(self.config, attitudes)

    def overrides(self, run: int, sample: Sample) -> tuple[str, ...]:
        """Return the overrides of a case with the values of its inputs."""
        inputs = self.config.inputs if self._build is None else {}
        own = (o for key, item in inputs.items() for o in item.overrides(key, sample))
        return (*self._overrides(self.samples.design(run)), *own)

    def case(self, run: int) -> Case | Start:
        """Return the case with this number, from 0, or the start that a function builds."""
        return self.case_of(run, self.samples.of_runs([run])[0])

    def case_of(self, run: int, sample: Sample) -> Case | Start:
        """Return the case with this number, or the start, for values of its inputs."""
        overrides = self.overrides(run, sample)
        if self._build is not None:
            return built(self._build, self.config.values(sample), overrides)
        return self._parsed(self.samples.design(run), overrides)

    def validate(self) -> None:
        """Raise CaseError for keys, distributions and samples with which runs would be refused.

        The first 200 samples are prepared.
        """
        faults: dict[Fault, None] = {}
        for design in range(len(self._cases)):
            scene = self._base(design).scene
            over = {} if self.config.optimise is None else self.config.optimise.over
            for key, item in (self.config.inputs | over).items() if self._build is None else ():
                faults |= dict.fromkeys(self._faults_of_input(design, scene, key, item))
        if found := list(faults) or self._faults_of_samples():
            raise CaseError(found)

    def _faults_of_input(self, design: int, scene: Scene, key: str, item: InputConfig) -> Iterator[Fault]:
        here = self._place(*(("inputs", key) if key in self.config.inputs else ("optimise", "over")))
        try:
            path = key_path(key)
        except ValueError as error:
            yield Fault("", f"{key}: {error}", place=here)
            return
        if item.frozen is not None and isinstance(_find(scene, path)[0], bool | str | Mapping | Record):
            yield Fault(key, "is not a number, which a distribution requires", place=here)
            return
        sample = item.draw(key, np.full((1, item.dimensions), 0.5))
        try:
            case = self._base(design, *item.overrides(key, {name: part[0] for name, part in sample.items()}))
        except CaseError as error:
            yield from (Fault(fault.key, fault.reason, place=here) for fault in error.faults)
            return
        low, high = _bounds(_find(case.scene, path)[1])
        if item.frozen is not None and (share := item.outside(low, high)) > MAX_OUTSIDE:
            words = f"{share:.2%} of the distribution is outside the bounds of the key, {low:g} to {high:g}"
            yield Fault(key, f"{words}: give bounds", place=here)

    def _faults_of_samples(self) -> list[Fault]:
        number, failed, first = min(CHECKED, self.number_of_cases), 0, list[Fault]()
        for run, sample in enumerate(self.samples.of_runs(range(number))):
            try:
                start_of(self.case_of(run, sample))
            except CaseError as error:
                failed += 1
                first = first or [self._of_sample(run, sample, fault) for fault in error.faults]
        if failed:
            words = f"{failed} of the first {number} samples cannot be prepared"
            first.append(Fault("", words, place=self._place("inputs")))
        return first

    def _of_sample(self, run: int, sample: Sample, fault: Fault) -> Fault:
        places = {
            place_of_override(option): self._place("inputs", key)
            for key, item in self.config.inputs.items()
            for option in item.overrides(key, sample)
        }
        words = f"sample {run}: {fault.reason}{_MENDS.get(fault.key, '')}"
        return Fault(fault.key, words, place=places.get(fault.place, fault.place))

    def validate_outputs(self, metrics: Iterable[str]) -> None:
        """Raise CaseError for an output that is not among the metrics of a run, nor depends on its events."""
        faults, outputs, optimise = [], self.config.outputs, self.config.optimise
        quantities = (
            [] if optimise is None else [item.name for item in optimise.quantities if item.part is not None]
        )
        named = {"outputs.print": outputs.print, "outputs.limits": outputs.limits, "optimise": quantities}
        for key, names in named.items():
            for name in names:
                if name not in metrics and not _NOT_IN_ALL.fullmatch(name):
                    hint = f"; did you mean '{near}'?" if (near := closest(name, metrics)) else ""
                    words = f"{name} is not a metric of the case{hint}"
                    faults.append(Fault(key, words, place=self._place(*key.split("."))))
        if faults:
            raise CaseError(faults)

    def _place(self, *path: str) -> str:
        if self._source is None:
            return ""
        line = next((self._lines[path[:k]] for k in (2, 1) if path[:k] in self._lines), 1)
        return f"{self._source[1]}:{line}"

    @property
    def mesh_files(self) -> dict[tuple[int, str], Path]:
        """Mesh files that no input names, by number of the design and key."""
        return {
            (design, key): Path(body.file)
            for design in range(len(self._cases))
            for name, body in self._base(design).scene.bodies.items()
            if (key := f"bodies.{name}.file") not in self.config.inputs
            and body.file
            and Path(body.file).is_file()
        }

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Return the common facts of the rows of a table: keys, hashes of cases and meshes, versions."""
        kept = self.config.model_dump(mode="json", exclude=_NO_IDENTITY)
        if self.config.design == "random":
            kept.pop("runs")
        for design, (text, _) in enumerate(self._cases):
            kept[f"case {design}"] = hashlib.sha256(text.encode()).hexdigest()
        if self._build is not None:
            with suppress(OSError):  # of a function without a file
                kept["build"] = hashlib.sha256(inspect.getsource(self._build).encode()).hexdigest()
        for (design, key), path in self.mesh_files.items():
            kept[f"{key} {design}"] = hashlib.sha256(path.read_bytes()).hexdigest()
        found: dict[str, Any] = json.loads(json.dumps(kept | {"versions": versions()}))
        return found

    @takes(progress=Callable, note=Callable)
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
        folder, workers = path_of(folder, "run"), _validated(workers, shard)
        if self._build is not None and client is None and workers > 1:
            pickled(self._build)
        if any(folder.glob("study*.sqlite")):
            stored, own = RowFiles(folder).about("identity"), self.identity
            if changed := sorted(key for key in stored | own if stored.get(key) != own.get(key)):
                words = f"has rows of another study, which differs in {', '.join(changed)}"
                raise InputError(f"{folder}: {words}: give a new folder, or all as it was")
        elif not self._valid:
            self.validate()
        with _writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            lock, file = folder, folder / file_of(shard)
            if shard is not None:
                (lock := folder / f".{file.name}.lock").touch()
        with held(lock):
            if not file.is_file():
                RowFile.create(file, self._about(), self._types()).close()
            with closing(RowFile(file)) as rows:
                rows.note(study=self._about()["study"])
                _Runner(self, rows, folder, shard, progress, note).run(workers, client)
        table = StudyTable(folder)
        table.study._build = self._build
        return table

    def _about(self) -> dict[str, Any]:
        text = self._source[0] if self._source else ""
        config = self.config.model_dump(mode="json", exclude_unset=True)
        study = {"config": config, "text": text, "name": self.name, "folder": str(self._folder.resolve())}
        study |= {"made": self._made is not None, "build": self._function}  # type: ignore[dict-item]
        cases = [(text, str(path)) for text, path in self._cases]
        return {"study": study, "identity": self.identity, "cases": cases, "wall_s": 0.0, "workers": 1}

    def _types(self) -> dict[str, str]:
        """Return the SQLite type of each column of inputs."""
        inputs = self.config.inputs.items()
        return {name: _TYPES.get(item.kind, "REAL") for key, item in inputs for name in item.columns(key)}


@dataclass
class _Runner:
    """Computes the rows that a file misses."""

    _study: Study
    _rows: RowFile
    _folder: Path
    _shard: tuple[int, int] | None
    _progress: Progress | None
    _note: Callable[[str], None] | None

    def __post_init__(self) -> None:
        (k, n), total = self._shard or (0, 1), self._study.config.number_of_rows
        mine = np.arange(total) % n == k
        there = RowFiles(self._folder).column("id").astype(int)  # of other shards too
        self._all = int(mine.sum())
        mine[there[there < total]] = False
        self._left = np.flatnonzero(mine)
        self._count = self._all - len(self._left)
        self._checked = self._count > 0
        self._inputs: dict[int, Sample] = {}

    def run(self, workers: int, client: Any) -> None:
        """Compute all rows that are left."""
        if not len(self._left):
            return
        config, used = self._study.config, 1
        cases = tuple((text, str(path)) for text, path in self._study._cases)
        alone = workers == 1 or len(self._left) == 1
        build = self._study._build
        sent = build if build is None or client is not None or alone else pickled(build)
        work = Work(cases, config.outputs, config.time_limit, sent)
        first: Lane = Lane() if alone else ProcessLane()
        if client is not None:
            first = ClusterLane(client, self._study.mesh_files)

        def lanes(memory: int) -> list[Lane]:
            nonlocal used
            if client is not None or alone:
                used = first.workers
                return [first]
            found, words = lanes_on_this_machine(min(workers, len(self._left)), first, memory)
            used = len(found)
            if words and self._note is not None:
                self._note(words)
            return found

        began, before = clock.perf_counter(), self._rows.about("wall_s")
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
            samples = study.samples.of_runs([run for run, _ in places])
            for number, (run, replicate), sample in zip(chunk, places, samples, strict=True):
                self._inputs[number] = sample
                overrides, values = study.overrides(run, sample), study.config.values(sample)
                yield Job(number, run, replicate, study.samples.design(run), overrides, values)

    def _take(self, found: list[Done]) -> None:
        """Store the rows of a portion."""
        designs, rows = self._study.config.designs, []
        for done in found:
            job, name = done.job, designs[done.job.design].name if designs else ""
            ends = (done.status, done.outcome, done.seconds, done.note)
            fixed = dict(zip(FIXED, (job.row, job.run, job.replicate, name, *ends), strict=True))
            rows.append({**fixed, **self._inputs.pop(job.row), **done.metrics})
            if done.result is not None:
                with _writing(self._folder):
                    (self._folder / KEPT).mkdir(exist_ok=True)
                with replacing(self._folder / KEPT / f"{name_of(job.run, job.replicate)}.h5") as part:
                    part.write_bytes(done.result)
        self._rows.add(rows, {key: item for done in found for key, item in done.about.items()})
        self._count += len(rows)
        if not self._checked and (whole := [done for done in found if done.status == OK]):
            self._checked = True
            self._study.validate_outputs(whole[0].metrics)
        if self._progress is not None:
            self._progress(self._count, self._all)


class StudyTable:
    """The rows of a study: inputs, outcome, metrics, status, seconds of each run, read one column at a time.

    folder : into which the study has written

    Raises InputError if there is no study in the folder, or its files are damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = path_of(folder, "StudyTable")
        self.files = RowFiles(self.folder)
        stored, base = self.files.about("study"), Path(self.files.about("study")["folder"])
        cases = tuple((text, Path(path)) for text, path in self.files.about("cases"))
        config = StudyConfig.model_validate(stored["config"])
        source = (stored["text"], base / stored["name"]) if stored["text"] else None
        made = cases[0][0] if stored["made"] else None
        self.study = Study.__new__(Study)._begin(config, base, source, cases, made)
        self.study._function = stored["build"]
        self.config = config

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def numbers(self) -> Ints:
        """Numbers (rows,) of the rows that are there."""
        return self.files.column("id").astype(np.int64)

    @property
    def complete(self) -> bool:
        """True if all rows are there."""
        return len(self) >= self.config.number_of_rows

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs; of a vector its length, or the angle of a tilt."""
        return tuple(self.config.inputs)

    @cached_property
    def about(self) -> dict[str, tuple[str, str]]:
        """Words and unit of each metric, by key."""
        return {key: tuple(item) for part in self.files.abouts("metrics") for key, item in part.items()}

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics, as of `exunet.metrics`."""
        return tuple(self.about)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (rows,): an input, a metric (NaN where a run does not have it), status, ..."""
        if name not in self.files.columns:
            raise InputError(f"column: {name!r} is not one of {', '.join(self.files.columns)}")
        return self.files.column(name)

    @property
    def outcome(self) -> NDArray[Any]:
        """Capture outcomes (rows,), "" of a run without one."""
        return self._texts("outcome")

    @property
    def status(self) -> NDArray[Any]:
        """Status (rows,): ok, stopped, invalid or failed."""
        return self._texts("status")

    @property
    def seconds(self) -> Floats:
        """Wall time (rows,) of each run [s]."""
        return self.files.column("seconds")

    def _texts(self, name: str) -> NDArray[Any]:
        return np.array([text if isinstance(text, str) else "" for text in self.files.column(name)], object)

    def of_design(self, design: str | None = None) -> Bools:
        """Return (rows,) which rows are of a design, by its name; None: of the only one.

        Of Saltelli's design these are the independent samples A and B.
        """
        names = [item.name for item in self.config.designs] or [""]
        wanted = names[0] if design is None and len(names) == 1 else design
        if wanted not in names:
            raise InputError(f"design: must be one of {', '.join(names) or 'None'}, got {design!r}")
        independent = self.config.design != "saltelli" or self.numbers % self.config.rows_of_point < 2
        return np.asarray((self._texts("design") == wanted) & independent)

    @property
    def undetermined(self) -> Bools:
        """(rows,) which rows have no outcome: undetermined, failed or invalid."""
        return np.isin(self.status, (FAILED, INVALID)) | (self.outcome == Outcome.UNDETERMINED.value)

    def responses(self, name: str) -> Floats:
        """Return (rows,) 1 and 0 of an outcome, or a metric; NaN of runs without it."""
        if name in list(Outcome):
            return np.where(self.undetermined, np.nan, self.outcome == name)
        return self.column(name) if name in self.metrics else np.full(len(self), np.nan)

    def paired(
        self, name: str, first: str | None, second: str | None, other: StudyTable | None = None
    ) -> PairedOutcome | PairedMetric | None:
        """Compare an outcome or a metric of two designs, of this table or the second of another.

        Returns None for a metric that fewer than two pairs have. Raises InputError for designs without the
        same independent samples.
        """
        from exunet.studies import estimates

        sides = ((self, first), (other or self, second))
        rows = [np.flatnonzero(table.of_design(design)) for table, design in sides]
        numbers = [
            table.numbers[mine] // table.config.rows_of_point
            for (table, _), mine in zip(sides, rows, strict=True)
        ]
        _, *common = np.intersect1d(numbers[0], numbers[1], return_indices=True)
        if not len(common[0]):
            raise InputError("paired: the designs have no sample in common")
        one, two = (mine[places] for mine, places in zip(rows, common, strict=True))
        tables = [table for table, _ in sides]
        if any(table.config.design in ("grid", "saltelli") for table in tables) or any(
            not np.array_equal(self.column(key)[one], tables[1].column(key)[two]) for key in self.inputs
        ):
            raise InputError("paired: requires two designs with the same random samples")
        a, b = self.responses(name)[one], tables[1].responses(name)[two]
        return (
            estimates.paired_outcomes(a, b)
            if name in list(Outcome)
            else estimates.paired_metrics(a, b, self.config.seed)
        )

    def probability(self, outcome: str, design: str | None = None, level: float = 0.95) -> Estimate:
        """Return the probability of an outcome of a design, with its interval at a level of confidence.

        Rows without an outcome count as not having it at the low end, and as having it at the high end.
        Raises InputError for an unknown outcome or design, or a case without [capture].
        """
        from exunet.studies import estimates

        if outcome not in list(Outcome):
            raise InputError(f"outcome: must be one of {', '.join(Outcome)}, got {outcome!r}")
        mine, hits = self.of_design(design), self.outcome == outcome
        if not (self.outcome != "").any():
            raise InputError("outcome: the case has no criterion: add [capture]")
        lost = self.undetermined & ~hits
        found, runs, undetermined = (int(part[mine].sum()) for part in (hits, mine, lost))
        stratified = self.config.design == "lhs"
        return estimates.probability(found, runs, undetermined, level, stratified=stratified)

    def to_pandas(self) -> DataFrame:
        """Return all columns as a pandas table: one row for each run; MissingExtra without pandas."""
        return table("row", self.numbers, {name: self.column(name) for name in self.files.columns[1:]})

    def to_xarray(self) -> Dataset:
        """Return all columns as an xarray data set along "row", with units; MissingExtra without xarray."""
        try:
            from xarray import Dataset
        except ImportError:
            words = "a data set of a study needs xarray: pip install 'exunet[studies]'"
            raise MissingExtra(words) from None
        found: dict[str, Any] = {}
        for name in self.files.columns[1:]:
            words, unit = self.about.get(name, (name, "s" if name == "seconds" else ""))
            found[name] = ("row", self.column(name), {"units": unit, "long_name": words})
        return Dataset(found, {"row": self.numbers})

    def row(self, run: int, replicate: int = 0) -> dict[str, Any]:
        """Return all columns of a run, None where it has no value; raises InputError if it is not there."""
        if not 0 <= run < self.study.number_of_cases:
            raise InputError(f"run: must be from 0 to {self.study.number_of_cases - 1}, got {run}")
        names, number = self.files.columns, self.study.samples.row(run, replicate)
        for values in self.files.rows(names, number):
            return dict(zip(names, values, strict=True))
        raise InputError(f"run: {run} is not there yet: exunet resume {self.folder}")

    def case(self, run: int) -> Case | Start:
        """Return the case of a run, from 0, whose `exunet.run` has the metrics of its row, bit by bit."""
        if (name := self.study._function) and self.study._build is None:
            raise InputError(f"{self.folder}: {_GOES_ON.format(name)}")
        row, sample = self.row(run), self.study.samples.of_runs([run])[0]
        for key, item in self.config.inputs.items():
            if item.frozen is not None or item.kind in (
                "isotropic",
                "tilt",
            ):  # SQLite keeps these as they are
                sample |= {name: row[name] for name in item.columns(key)}
        return self.study.case_of(run, sample)

    def start(self, run: int, replicate: int = 0) -> Start:
        """Return the start of a replicate of a run; 0: that of the case, from 1 on perturbed by 1e-9 m."""
        most = 1 if self.config.design == "saltelli" else self.config.replicates - 1
        if not 0 <= replicate <= most:
            raise InputError(f"replicate: must be from 0 to {most}, got {replicate}")
        return replicate_of(self.case(run), replicate)

    def write_csv(self, path: str | Path) -> None:
        """Write all columns to a CSV file, which appears whole or not at all."""
        names = self.files.columns
        with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([names, *self.files.rows(names)])


def name_of(run: int, replicate: int) -> str:
    """Return the name of a run in folders and tables: 17, or 17.3 of a replicate."""
    return f"{run}.{replicate}" if replicate else str(run)


def _first_built(build: Build, config: StudyConfig) -> Case:
    """Return the case of the first sample of a study of a function; raise CaseError for other inputs."""
    signature = inspect.signature(build)
    try:
        signature.bind(**dict.fromkeys(config.inputs))
    except TypeError as error:
        raise CaseError([Fault("inputs", f"do not fit {build.__qualname__}{signature}: {error}")]) from None
    own_keys = any(item.also for item in config.inputs.values()) or any(item.case for item in config.designs)
    if config.optimise is not None or own_keys:
        raise CaseError([Fault("build", "excludes optimise, also, and designs with a case")])
    made = built(build, config.values(Samples(config, {}).of_runs([0])[0]), ())
    return case_of(made.scene, "Study") if isinstance(made, Start) else made


def _items(scene: Scene, key: str) -> list[str]:
    """Return the keys that one with [*] stands for; raises ValueError if there is no list."""
    before, each, after = key.partition("[*]")
    if not each:
        return [key]
    value, _ = _find(scene, key_path(before))
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise ValueError(f"{before} is not a list of the case, which [*] requires")
    return [name for k in range(len(value)) for name in _items(scene, f"{before}[{k}]{after}")]


def _find(scene: Scene, path: KeyPath) -> tuple[Any, FieldInfo | None]:
    """Return the value of a key, None if it is absent, and the field of the record that has it."""
    value: Any = scene
    field: FieldInfo | None = None
    for part in path:
        try:
            if isinstance(value, Record):
                field = type(value).model_fields.get(str(part))
                value = getattr(value, str(part), None)
            elif isinstance(value, Mapping) and isinstance(part, int):
                value = list(value.values())[part]
            else:
                value = value[part]
        except (IndexError, KeyError, TypeError):
            return None, None
    return value, field


def _bounds(field: FieldInfo | None) -> tuple[float, float]:
    """Return minimum and maximum of the numbers that a field accepts."""
    items = () if field is None else (*field.metadata, *_metadata(field.annotation))
    low = [getattr(item, name, None) for item in items for name in ("ge", "gt")]
    high = [getattr(item, name, None) for item in items for name in ("le", "lt")]
    low, high = ([value for value in values if value is not None] for values in (low, high))
    return max(low, default=-math.inf), min(high, default=math.inf)


def _metadata(kind: Any) -> Iterator[Any]:
    """Yield what `Annotated` states of a type and the types that it consists of."""
    for item in getattr(kind, "__metadata__", ()):
        yield from item.metadata if isinstance(item, FieldInfo) else (item,)
    for part in (
        *getattr(kind, "__args__", ()),
        *([kind.__origin__] if hasattr(kind, "__metadata__") else []),
    ):
        yield from _metadata(part)


def _validated(workers: object, shard: object) -> int:
    """Return the number of workers; raises InputError for arguments of `Study.run` out of range."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError(f"workers: must be a whole number, 1 or more, got {workers!r}")
    if shard is not None:
        whole = isinstance(shard, tuple) and len(shard) == 2 and all(type(k) is int for k in shard)
        if not whole or not 0 <= shard[0] < shard[1]:  # type: ignore[index]
            raise InputError(f"shard: must be (k, n) with k from 0 to n - 1, got {shard!r}")
    return workers


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error
