"""Snapshots and unfinished runs whose files are sound, with contents that no simulation writes."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.base.blob import read_arrays, write_arrays
from exunet.simulation import driving
from exunet.simulation.run import run_into
from exunet.simulation.snapshot import FORMAT, KIND

CASE = Path(__file__).parents[1] / "cases" / "planar_deployment.toml"
FORMS = ["engine.loop=compiled", "engine.net=connectors"]


@pytest.fixture(scope="module", params=FORMS)
def whole(request: Any) -> tuple[exunet.Simulation, exunet.Snapshot]:
    """A simulation, and a snapshot of it with a force, marks and stops."""
    sim = exunet.Simulation(CASE, [request.param])
    sim.advance(0.01)
    sim.set_force(1, [0.0, 0.0, 0.1])
    sim.advance(0.01)
    return sim, sim.snapshot()


def refused(sim: exunet.Simulation, snapshot: exunet.Snapshot) -> bool:
    """True if it is refused with an InputError; a simulation that refuses is as it was."""
    before = sim.snapshot()
    try:
        sim.restore(snapshot)
    except exunet.InputError:
        after = sim.snapshot()
        assert after.header == before.header
        for name, values in before.arrays.items():
            np.testing.assert_array_equal(after.arrays[name], values)
        return True
    return False


@pytest.mark.slow
def test_every_array_must_be_there_with_its_type_and_size(
    whole: tuple[exunet.Simulation, exunet.Snapshot],
) -> None:
    sim, snapshot = whole
    for name, values in snapshot.arrays.items():
        changes = {
            "absent": None,
            "other type": values.astype(bool) if values.dtype != bool else values * 1.0,
        }
        changes["another axis"] = values[None]
        if values.size:
            changes["of size zero"] = values[..., :0] if values.ndim > 1 else None
        if values.dtype.kind == "f" and values.size:
            changes["NaN"] = np.full_like(values, np.nan)
            if not name.startswith(("integrator:seen", "integrator:clock", "monitor:envelope")):
                changes["infinite"] = np.full_like(values, np.inf)
        if name == "stops:force":
            changes["of other stops"] = values + 1000
        if name.startswith(("integrator:kept", "integrator:rows", "stops:times")):
            changes["of another length"] = np.concatenate([values, values])
        for words, changed in changes.items():
            arrays = {key: other for key, other in snapshot.arrays.items() if key != name}
            if changed is not None:
                arrays[name] = changed
            assert refused(sim, exunet.Snapshot(snapshot.of, snapshot.header, arrays)), (name, words)
    assert not refused(sim, snapshot)


PLANS: list[dict[str, Any]] = [
    {"method": "Euler"}, {"tolerance": None}, {"tolerance": "1"}, {"step": 1e-3}, {"notes": [1]},
    {"expected_error": [1.0]}, {"longest_step": -1.0}, {"more": 1},
    {"method": "RK44", "step": 1e-3, "tolerance": None},
]  # fmt: skip


def test_the_header_must_tell_what_it_should(whole: tuple[exunet.Simulation, exunet.Snapshot]) -> None:
    sim, snapshot = whole
    for key in snapshot.header:
        for junk in ("junk", None, -1, [1], {"a": 1}):
            header = dict(snapshot.header) | {key: junk}
            assert refused(sim, exunet.Snapshot(snapshot.of, header, snapshot.arrays)), (key, junk)
    for change in PLANS:
        header = dict(snapshot.header) | {"plan": snapshot.header["plan"] | change}
        assert refused(sim, exunet.Snapshot(snapshot.of, header, snapshot.arrays)), change
    assert refused(sim, exunet.Snapshot({}, snapshot.header, snapshot.arrays))


def test_a_file_is_checked_when_it_is_read(tmp_path: Path) -> None:
    sim = exunet.Simulation(CASE, [FORMS[0]])
    sim.snapshot().save(tmp_path / "good")
    header, arrays = read_arrays(tmp_path / "good", KIND, FORMAT)
    for key in ("of", "time", "plan", "retries", "spent", "events"):
        for changed in ({k: v for k, v in header.items() if k != key}, header | {key: "junk"}):
            write_arrays(tmp_path / "bad", KIND, FORMAT, changed, arrays)
            with pytest.raises(exunet.InputError, match=f"damaged.*{key}"):
                exunet.Snapshot.load(tmp_path / "bad")


def dies_after_a_quarter(time: float, *_: object) -> None:
    if time > 0.25:
        os._exit(9)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that was killed after checkpoints."""
    folder = tmp_path_factory.mktemp("killed")
    child = os.fork()
    if not child:
        try:
            driving._SHOWN = 0.0  # progress is called at each stored time
            case = exunet.load(CASE, [FORMS[0], "time.end=0.4"])
            run_into(folder, case, progress=dies_after_a_quarter, checkpoint_every=0.1)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 9
    return folder


def without(key: str) -> Callable[[dict[str, Any]], object]:
    return lambda header: header.pop(key)


def other(key: str, value: Any) -> Callable[[dict[str, Any]], object]:
    return lambda header: header.__setitem__(key, value)


JUNK = ("junk", None, 3, [1], {"a": 1})
KEYS = {
    "index.exu": ("identity", "segments", "written", "checkpoint", "of_checkpoint"),
    "run.exu": ("identity", "columns", "bodies", "provenance"),
}
HARMLESS = {("checkpoint", None), ("written", 3), ("bodies", "junk")}
CHANGES = [(file, f"no {key}", without(key)) for file, keys in KEYS.items() for key in keys]
CHANGES += [
    (file, f"{key} {junk!r}", other(key, junk))
    for file, keys in KEYS.items()
    for key in keys
    for junk in JUNK
    if json.dumps([key, junk]) not in {json.dumps(one) for one in HARMLESS}
]
CHANGES += [
    ("index.exu", "path", other("checkpoint", "../checkpoint-000001.exu")),
    ("run.exu", "text", lambda header: header["provenance"].pop("text")),
    ("run.exu", "every", lambda header: header["provenance"].__setitem__("checkpoint_every", "x")),
    ("run.exu", "row", lambda header: header["columns"][1].__setitem__("row", [7, 3])),
    ("run.exu", "units", lambda header: header["columns"][1].__setitem__("units", 1)),
]


def test_a_damaged_unfinished_run_is_refused_in_words(killed: Path, tmp_path: Path) -> None:
    """`exunet.resume` for all changes; what `exunet plot` reads, for those that it meets."""
    kinds = {"index.exu": "exunet index", "run.exu": "exunet run"}
    for number, (file, _words, change) in enumerate(CHANGES):
        folder = tmp_path / str(number)
        shutil.copytree(killed, folder)
        path = folder / "unfinished" / file
        header, arrays = read_arrays(path, kinds[file], 1)
        change(header)
        write_arrays(path, kinds[file], 1, header, arrays)
        with suppress(exunet.InputError):
            exunet.load_result(folder)
        with pytest.raises(exunet.InputError, match=r"."):
            exunet.resume(folder)
        shutil.rmtree(folder)
