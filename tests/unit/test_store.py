"""Stored states that grow: the same rows from every store, after a kill, damage, on a full disk."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from result_samples import square_net, unfolding

from exunet.base.errors import InputError
from exunet.results import io
from exunet.results.io import head_of, load_result, open_unfinished, save, write_rows
from exunet.results.result import (
    BODY_QUANTITIES,
    PATHS,
    BodyConstants,
    BodyStates,
    StoredRows,
    blocks,
    body_path,
    declare,
)
from exunet.results.run_record import RunRecord
from exunet.results.store import STORE_FILE, FileStore, MemoryStore

NET = square_net(cells=2, strings=True)
TARGET = BodyConstants(2000.0, np.diag([1.0, 2.0, 3.0]))
BODIES = {"chaser": BodyConstants(500.0, np.eye(3)), "target": TARGET}
COLUMNS = declare(NET.n_nodes, NET.n_elements, BODIES)
RECORD = RunRecord(title="by hand", end=1e-9)
TIMES = 40


def rows_of(result):
    """The arrays of a result by column."""
    found = {path: getattr(result, name) for name, path in PATHS.items()}
    for name in BODIES:
        for quantity in BODY_QUANTITIES:
            found[body_path(name, quantity)] = getattr(result.bodies[name], quantity)
    return found


def sample(times=TIMES, seed=0):
    """A result whose numbers are all different."""
    random = np.random.default_rng(seed).normal
    body = random(size=(2, times, 13))
    return unfolding(
        NET, times, largest_elastic=random(size=times), least_kinetic=random(size=times),
        potential=random(size=times), run=RECORD,
        bodies={
            name: BodyStates(of.mass, of.inertia, own[:, :3], own[:, 3:6], own[:, 6:10], own[:, 10:])
            for (name, of), own in zip(BODIES.items(), body, strict=True)
        },
    )  # fmt: skip


SAMPLE = sample()
ROWS = rows_of(SAMPLE)


def cut(start, stop, rows=ROWS):
    return {path: values[start:stop] for path, values in rows.items()}


def new(folder):
    folder.mkdir(exist_ok=True)
    return FileStore.create(folder / STORE_FILE, COLUMNS, head_of(NET, BODIES, RECORD), {"case": "x"})


def reopened(store):
    """What another process finds."""
    return FileStore(store.path)


def stores(tmp_path):
    return [MemoryStore(COLUMNS), new(tmp_path / "store")]


def in_a_process(program, *arguments):
    """Run a program that imports this module as t."""
    here = Path(__file__).parent
    paths = os.pathsep.join(map(str, (here, here.parent)))
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(
        command, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )


def assert_rows(store, count, rows=ROWS):
    assert len(store) == count
    for path, values in rows.items():
        np.testing.assert_array_equal(store.read(path, 0, count), values[:count], strict=True)


def write(source, path):
    write_rows(source, path, NET, BODIES, RECORD)


def test_stores_return_what_they_were_given(tmp_path):
    for store in stores(tmp_path):
        at = 0
        for count in (1, 0, 5, 2, 20, 12):
            rows = {path: values.copy() for path, values in cut(at, at + count).items()}
            store.append(rows)
            for values in rows.values():
                values[...] = np.nan  # they were copied
            at += count
            assert_rows(store, at)
        for start, stop in ((0, 0), (3, 11), (13, 15), (34, 40), (39, 40)):
            found = store.read("net/position", start, stop)
            np.testing.assert_array_equal(found, SAMPLE.position[start:stop], strict=True)
    assert_rows(FileStore(store.path, read_only=True), TIMES)


@pytest.mark.parametrize("kept", [0, 6, 7, 8, 33, 40])
def test_a_run_that_goes_back_leaves_no_trace(kept, tmp_path):
    other = rows_of(sample(seed=1))
    for store in stores(tmp_path):
        for start in range(0, TIMES, 7):
            store.append(cut(start, min(start + 7, TIMES), other))
        store.drop_after(kept)
        assert_rows(store, kept, other)
        store.drop_after(0)
        store.append(cut(0, kept))
        store.append(cut(0, 25, other))
        store.drop_after(kept)
        store.append(cut(kept, TIMES))
        assert_rows(store, TIMES)
    store.close()
    assert_rows(reopened(store), TIMES)


@pytest.mark.parametrize(
    "wrong",
    [
        {"time": np.zeros(2)},
        {"net/position": np.zeros((3, NET.n_nodes))},
        {"other": np.zeros(3)},
    ],
    ids=["number of rows", "shape", "name"],
)
def test_rows_that_do_not_fit_are_refused(wrong, tmp_path):
    for store in stores(tmp_path):
        with pytest.raises(ValueError, match=r"columns|has shape"):
            store.append(cut(0, 3) | wrong)
        assert len(store) == 0


@pytest.mark.parametrize("back", [17, 9, 8, 0])
def test_a_later_process_goes_back_to_the_checkpoint(back, tmp_path):
    """Whatever was dropped and stored anew since, also of the rows of the checkpoint."""
    store = new(tmp_path)
    assert store.checkpoint is None
    for start, stop in ((0, 8), (8, 17)):
        store.append(cut(start, stop))
    store.keep_checkpoint(b"snapshot 1")
    store.drop_after(back)
    store.append(cut(back, 30, rows_of(sample(seed=1))))
    store.close()
    store = reopened(store)
    assert len(store) == 30
    assert store.back_to_checkpoint() == b"snapshot 1"
    assert_rows(store, 17)
    store.append(cut(17, TIMES))
    store.drop_after(back)
    store.append(cut(back, TIMES))
    store.keep_checkpoint(b"snapshot 2")
    assert store.back_to_checkpoint() == b"snapshot 2"
    assert_rows(store, TIMES)


def test_without_a_checkpoint_a_later_process_begins_anew(tmp_path):
    store = new(tmp_path)
    store.append(ROWS)
    store.close()
    store = reopened(store)
    assert store.back_to_checkpoint() is None
    assert len(store) == 0
    store.discard()
    assert list(tmp_path.iterdir()) == []


def test_files_have_the_same_bytes_whatever_the_store(monkeypatch, tmp_path):
    """Chunks of 50 rows of positions, which batches do not divide."""
    monkeypatch.setattr(io, "CHUNK_BYTES", 50 * 8 * 3 * NET.n_nodes)
    many = sample(times=333)
    save(many, tmp_path / "saved.h5")
    for store in (MemoryStore(COLUMNS[::-1]), new(tmp_path)):
        for start in range(0, 333, 40):
            store.append(cut(start, start + 40, rows_of(many)))
        write(store, tmp_path / "written.h5")
        assert (tmp_path / "written.h5").read_bytes() == (tmp_path / "saved.h5").read_bytes()
    assert_equal(load_result(tmp_path / "written.h5"), many)


@pytest.mark.parametrize(
    ("path", "bad"),
    [("net/position", np.nan), ("energy/potential", -np.inf), ("bodies/target/attitude", np.nan)],
)
def test_nan_and_infinity_are_not_written(path, bad, tmp_path):
    store = new(tmp_path)
    store.append(cut(0, 20))
    rows = {name: values.copy() for name, values in cut(20, 25).items()}
    rows[path].reshape(5, -1)[3, -1] = bad
    store.append(rows)
    with pytest.raises(InputError, match=rf"{path} contains NaN or infinity \(first at \[23"):
        write(store, tmp_path / "written.h5")
    assert not (tmp_path / "written.h5").exists()


def test_times_that_do_not_increase_are_not_written(tmp_path):
    store = MemoryStore(COLUMNS)
    for _ in range(2):
        store.append(cut(0, 5))
    for source in (store, MemoryStore(COLUMNS)):
        with pytest.raises(InputError, match="stored times"):
            write(source, tmp_path / "written.h5")


def assert_equal(found, expected):
    for path, values in rows_of(found).items():
        np.testing.assert_array_equal(np.asarray(values), rows_of(expected)[path], strict=True, err_msg=path)


# States of a run that has not come to its end


def test_an_unfinished_run_is_an_incomplete_result(tmp_path):
    store = new(tmp_path)
    with pytest.raises(InputError, match="has not stored a state yet"):
        load_result(tmp_path)
    store.append(cut(0, 14))
    found = load_result(tmp_path)
    store.append(cut(14, 20))
    for path, values in cut(0, 14).items():
        np.testing.assert_array_equal(np.asarray(rows_of(found)[path]), values, err_msg=path)
    assert not found.complete
    assert found.verdict.startswith("unfinished: 14 states until t = ")
    assert found.run.end == RECORD.end
    np.testing.assert_array_equal(found.bodies["target"].inertia, TARGET.inertia)
    np.testing.assert_array_equal(found.net.element_nodes, NET.element_nodes)
    assert (found.net.faces, found.net.mouth) == (NET.faces, NET.mouth)
    save(SAMPLE, tmp_path / "result.h5")
    assert load_result(tmp_path).complete
    with pytest.raises(InputError, match=r"neither a result\.h5 nor"):
        open_unfinished(tmp_path / "elsewhere")


# Larger than memory


def test_large_files_are_read_when_used(monkeypatch, tmp_path):
    save(SAMPLE, tmp_path / "result.h5")
    store = new(tmp_path)
    for start in range(0, TIMES, 7):
        store.append(cut(start, start + 7))
    monkeypatch.setattr(io, "IN_MEMORY", 1000)
    for found in (load_result(tmp_path / "result.h5"), open_unfinished(tmp_path)):
        assert isinstance(found.position, StoredRows)
        assert isinstance(found.bodies["target"].attitude, StoredRows)
        assert isinstance(found.kinetic, StoredRows)
        assert isinstance(found.time, np.ndarray)
        assert_equal(found, SAMPLE)
        save(found, tmp_path / "again.h5", overwrite=True)


VALUES = np.random.default_rng(3).normal(size=(50, 4, 3))
KEYS = {
    "one": 7,
    "last": -1,
    "numpy": np.int64(3),
    "slice": slice(3, 9),
    "step": slice(1, 40, 7),
    "back": slice(None, None, -2),
    "none of them": slice(9, 3),
    "near": [4, 5, 9, 4],
    "far": np.array([49, 0, -3]),
    "empty": np.array([], dtype=int),
    "mask": np.arange(50) % 3 == 0,
    "inner": (slice(2, 5), [0, 2]),
    "inner of one": (5, slice(None), 2),
    "vector and inner": (np.array([1, 8]), slice(None), 0),
    "far and inner": (np.array([1, 40]), [0, 2]),
    "all": ...,
    "new axis": None,
}


@pytest.mark.parametrize("name", KEYS)
def test_rows_are_chosen_as_in_an_array(name):
    found = StoredRows(lambda a, b: VALUES[a:b], VALUES.shape)[KEYS[name]]
    np.testing.assert_array_equal(found, VALUES[KEYS[name]], strict=True)


def test_stored_rows_work_in_formulas():
    stored = StoredRows(lambda a, b: VALUES[a:b].copy(), VALUES.shape)
    np.testing.assert_array_equal(2.0 * stored - stored**2, 2.0 * VALUES - VALUES**2)
    assert stored.max() == VALUES.max() == np.max(stored)
    assert (len(stored), stored.shape, stored.ndim, stored.dtype) == (50, (50, 4, 3), 3, np.float64)
    np.testing.assert_array_equal(list(stored), VALUES)
    for wrong in (50, -51):
        with pytest.raises(IndexError):
            stored[wrong]


def test_only_the_chosen_rows_are_read():
    asked = []
    stored = StoredRows(lambda a, b: (asked.append((a, b)), VALUES[a:b])[1], VALUES.shape)
    _ = stored[7], stored[10:20], stored[[3, 5]], stored[[0, 40]]
    assert asked == [(7, 8), (10, 20), (3, 6), (0, 1), (40, 41)]


def test_blocks_cover_every_row_once(monkeypatch):
    monkeypatch.setattr("exunet.results.result.BLOCK_BYTES", 8 * 8 * 12)
    found = list(blocks(VALUES))
    assert [len(block) for block in found] == [8] * 6 + [2]
    np.testing.assert_array_equal(np.concatenate(found), VALUES)
    assert [block.shape for block in blocks(VALUES[:0])] == [(0, 4, 3)]


# Kills, damage, full disks

# Appends rows, goes back, makes checkpoints, and kills itself before its n-th statement of SQLite. Before
# each action it logs the numbers of rows and the checkpoints before and after it.
KILLED = """
import os, random, signal, sys
import test_store as t

folder, seed = t.Path(sys.argv[1]), int(sys.argv[2])
store, choose, left = t.new(folder), random.Random(seed), random.Random(seed).randrange(1, 300)
log = os.open(folder / 'log', os.O_CREAT | os.O_WRONLY)

def counted(_statement):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)

def act(rows, checkpoint, action, *arguments):
    global before
    os.write(log, f'{before[0]} {rows} {before[1]} {checkpoint}\\n'.encode())
    action(*arguments)
    before = rows, checkpoint

before = 0, 0
store._db.set_trace_callback(counted)
while True:
    rows = len(store)
    more = min(choose.randrange(1, 4), t.TIMES - rows)
    act(rows + more, before[1], store.append, t.cut(rows, rows + more))
    if choose.random() < 0.3:
        act(len(store), len(store), store.keep_checkpoint, str(len(store)).encode())
    if len(store) == t.TIMES or choose.random() < 0.2:
        kept = max(0, len(store) - choose.randrange(12))
        act(kept, before[1], store.drop_after, kept)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")
def test_a_store_outlives_a_kill_at_any_moment(tmp_path):
    """12 kills before seeded statements, the first to the 300th."""
    for seed in range(12):
        folder = tmp_path / str(seed)
        assert in_a_process(KILLED, folder, seed).returncode == -signal.SIGKILL
        *_, last = (folder / "log").read_text().splitlines()
        before, after, old, new_one = map(int, last.split())
        store = FileStore(folder / STORE_FILE)
        assert len(store) in (before, after)
        assert int(store.checkpoint or 0) in (old, new_one)
        assert_rows(store, len(store))
        rows = int(store.back_to_checkpoint() or 0)
        assert_rows(store, rows)
        store.append(cut(rows, TIMES))
        assert_rows(store, TIMES)


def test_damage_is_found(tmp_path):
    """Bits of the numbers, of the checkpoint, of any byte; a file cut short anywhere, or of something else.

    SQLite reads a page that is cut as zeros. That is refused, or the rows and the checkpoint are right.
    """
    store = new(tmp_path)
    store.append(cut(0, 25))
    store.keep_checkpoint(b"s" * 30_000)
    store.append(cut(25, TIMES))
    store.close()
    sound, number = store.path.read_bytes(), itertools.count()

    def opened(content):
        path = tmp_path / str(next(number)) / STORE_FILE
        path.parent.mkdir()
        path.write_bytes(content)
        return FileStore(path)

    def refused(content):
        try:
            damaged = opened(content)
            assert_rows(damaged, TIMES)
            assert damaged.back_to_checkpoint() == b"s" * 30_000
            assert_rows(damaged, 25)
        except InputError as error:
            return STORE_FILE in str(error)
        return False

    assert not refused(sound)
    random = np.random.default_rng(5)
    ends = [0, 4, 16, 9000, *random.integers(len(sound), size=12).tolist()]
    assert all(refused(sound[:end]) for end in ends)
    flips = [bytearray(sound) for _ in range(40)]
    for flipped in flips:
        flipped[int(random.integers(len(sound)))] ^= 1 << int(random.integers(8))
    assert sum(map(refused, flips)) > 10  # others are in what is not used
    names = sound.replace(b'"energy/kinetic"', b'"energy/kinetik"', 1)  # of a column
    assert refused(names)
    assert refused(b"text")


FULL = """
import resource, sys
import test_store as t
from exunet.base.errors import InputError
store = t.new(t.Path(sys.argv[1]))
store.append(t.cut(0, 5))
store.keep_checkpoint(b"5")
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, resource.RLIM_INFINITY))
try:
    while True:
        store.append(t.cut(5, 20))
except InputError as error:
    print(error)
assert len(store) > 5
assert (store.read("time", 0, 5) == t.ROWS["time"][:5]).all()
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
store.drop_after(20)
store.append(t.cut(20, 30))
store.close()
"""


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_full_disk_loses_no_committed_row(tmp_path):
    done = in_a_process(FULL, tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"{tmp_path / STORE_FILE}: cannot be written: " in done.stdout
    store = FileStore(tmp_path / STORE_FILE)
    assert_rows(store, 30)
    assert store.back_to_checkpoint() == b"5"


def test_folders_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        FileStore.create(tmp_path / "absent" / STORE_FILE, COLUMNS, b"", {})
    with pytest.raises(InputError, match="no stored states of an unfinished run"):
        FileStore(tmp_path / STORE_FILE)


def test_ctrl_c_within_a_write_comes_after_it(monkeypatch, tmp_path):
    """Between the commit and the count, an interrupt would leave rows that are counted twice."""
    store = new(tmp_path)
    store._db.set_trace_callback(lambda words: words == "COMMIT" and signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        store.append(cut(0, 20))
    assert_rows(store, 20)
    store.close()
    assert_rows(reopened(store), 20)
