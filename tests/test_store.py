"""Stored states that grow: the same rows from every store, after a kill at any moment, and when damaged."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from result_samples import square_net, unfolding

from exunet.base.errors import InputError
from exunet.base.files import cannot_write
from exunet.results import from_rows, segments
from exunet.results.columns import PATHS, BodyConstants, body_path, body_quantities, declare
from exunet.results.reading import load_result, open_unfinished
from exunet.results.result import BodyStates
from exunet.results.rows import StoredRows, blocks
from exunet.results.segments import SegmentStore
from exunet.results.store import MemoryStore
from exunet.results.writing import join, save

NET = square_net(cells=2, strings=True)
RIGID = BodyConstants(2000.0, np.diag([1.0, 2.0, 3.0]))
BODIES = {"chaser": BodyConstants(500.0), "target": RIGID}
COLUMNS = declare(NET.n_nodes, NET.n_elements, BODIES)
ROW_BYTES = sum(column.row_bytes for column in COLUMNS)
PROVENANCE = {"method": "by hand", "tolerance": 1e-9}
TIMES = 40


def rows_of(result):
    """The arrays of a result by column."""
    found = {path: getattr(result, name) for name, path in PATHS.items()}
    for name, properties in BODIES.items():
        for quantity in body_quantities(properties):
            found[body_path(name, quantity)] = getattr(result.bodies[name], quantity)
    return found


def sample(times=TIMES, seed=0):
    """A result whose numbers are all different."""
    random = np.random.default_rng(seed).normal
    body = random(size=(2, times, 13))
    return unfolding(
        NET, times, largest_elastic=random(size=times), least_kinetic=random(size=times),
        potential=random(size=times), provenance=PROVENANCE,
        bodies={
            "chaser": BodyStates(500.0, None, body[0, :, :3], body[0, :, 3:6]),
            "target": BodyStates(
                2000.0, RIGID.inertia, body[1, :, :3], body[1, :, 3:6], body[1, :, 6:10], body[1, :, 10:]
            ),
        },
    )  # fmt: skip


SAMPLE = sample()
ROWS = rows_of(SAMPLE)


def cut(start, stop):
    return {path: values[start:stop] for path, values in ROWS.items()}


def new(folder):
    return SegmentStore.create(folder, COLUMNS, NET, BODIES, PROVENANCE)


@pytest.fixture
def small_segments(monkeypatch):
    """Segments of seven rows."""
    monkeypatch.setattr(segments, "SEGMENT_BYTES", 7 * ROW_BYTES)


def stores(tmp_path):
    return [MemoryStore(COLUMNS), new(tmp_path / "store")]


def assert_rows(store, count, rows=ROWS):
    assert len(store) == count
    for path, values in rows.items():
        np.testing.assert_array_equal(store.read(path, 0, count), values[:count], strict=True)


def test_stores_give_back_what_they_were_given(small_segments, tmp_path):
    for store in stores(tmp_path):
        at = 0
        for some in (1, 0, 5, 2, 20, 12):  # 40 rows: within a segment, over its end, over several
            store.append(cut(at, at + some))
            at += some
            assert_rows(store, at)
        for start, stop in ((0, 0), (3, 11), (13, 15), (34, 40), (39, 40)):
            found = store.read("net/position", start, stop)
            np.testing.assert_array_equal(found, SAMPLE.position[start:stop], strict=True)
            found[...] = np.nan  # the caller's own
        assert_rows(store, TIMES)


def test_rows_are_copied_when_they_are_appended(tmp_path):
    for store in stores(tmp_path):
        rows = {path: values.copy() for path, values in cut(0, 3).items()}
        store.append(rows)
        for values in rows.values():
            values[...] = np.nan
        assert_rows(store, 3)


@pytest.mark.parametrize("kept", [0, 1, 6, 7, 8, 14, 33, 35, 40])
def test_a_run_that_goes_back_leaves_no_trace(kept, small_segments, tmp_path):
    """40 rows in five segments of seven and a rest of five."""
    other = rows_of(sample(seed=1))
    for store in stores(tmp_path):
        store.append(other)
        store.drop_after(kept)
        assert_rows(store, kept, other)
        store.drop_after(0)
        store.append(cut(0, kept))
        store.append({path: values[:25] for path, values in other.items()})
        store.drop_after(kept)
        store.append(cut(kept, TIMES))
        assert_rows(store, TIMES)
    store.close()
    assert_rows(SegmentStore(store.folder), TIMES)
    assert len(list(store.folder.glob("segment-*.exu"))) == len(store._segments)


def test_more_rows_than_there_are_cannot_be_kept(tmp_path):
    for store in stores(tmp_path):
        with pytest.raises(ValueError, match="cannot keep 1 of 0 rows"):
            store.drop_after(1)


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


def test_only_whole_segments_are_written_unless_asked(small_segments, tmp_path):
    store = new(tmp_path)
    store.append(cut(0, 16))
    assert len(segments.Segments(tmp_path)) == 14  # two of seven
    store.flush()
    assert_rows(segments.Segments(tmp_path), 16)
    store.append(cut(16, 18))
    store.close()
    assert_rows(segments.Segments(tmp_path), 18)


def test_memory_is_bounded(small_segments, tmp_path):
    """No array in memory is longer than a segment, whatever is appended and read."""
    store = new(tmp_path)
    store.append(ROWS)
    for path in ROWS:
        store.read(path, 0, TIMES)
    assert all(len(values) == 7 for values in store._block._arrays.values())
    assert all(len(values) <= 7 for _, values in store._read.values())


def test_a_later_process_goes_back_to_the_checkpoint(small_segments, tmp_path):
    """Rows that were dropped and stored anew after a checkpoint do not count for it."""
    store = new(tmp_path)
    store.append(cut(0, 17))
    assert store.checkpoint is None
    store.flush(checkpoint="snapshot 1")
    store.drop_after(9)
    other = rows_of(sample(seed=1))
    store.append({path: values[9:30] for path, values in other.items()})
    del store  # as a kill would leave it: the lock goes with the object, as it does with the process
    segments_left = SegmentStore(tmp_path)
    assert segments_left.checkpoint == "snapshot 1"
    assert len(segments_left) == 9 + 21  # all of them in full segments
    segments_left.back_to_checkpoint()
    assert_rows(segments_left, 17)
    segments_left.append(cut(17, TIMES))
    assert_rows(segments_left, TIMES)
    segments_left.close()
    with pytest.raises(ValueError, match="no checkpoint"):
        new(tmp_path / "other").back_to_checkpoint()


def test_one_process_at_a_time_writes(tmp_path):
    store = new(tmp_path)
    store.append(cut(0, 3))
    with pytest.raises(InputError, match="another process is writing there"):
        SegmentStore(tmp_path)
    with pytest.raises(InputError, match="another process is writing there"):
        new(tmp_path)
    store.close()
    store.close()  # nothing happens
    assert_rows(SegmentStore(tmp_path), 3)


def test_a_new_run_takes_the_place_of_an_earlier_one(small_segments, tmp_path):
    store = new(tmp_path)
    store.append(ROWS)
    store.close()
    store = new(tmp_path)
    assert len(store) == 0
    assert not list(tmp_path.glob("segment-*.exu"))
    store.append(cut(0, 8))
    store.close()
    assert_rows(SegmentStore(tmp_path), 8)


def test_discard_leaves_nothing_of_its_own(small_segments, tmp_path):
    store = new(tmp_path / "store")
    store.append(ROWS)
    store.discard()
    assert list(tmp_path.iterdir()) == []
    store = new(tmp_path / "store")
    (store.folder / "snapshot").touch()
    store.discard()
    assert [path.name for path in store.folder.iterdir()] == ["snapshot"]


def test_files_have_the_same_bytes_whatever_the_store_and_its_segments(monkeypatch, tmp_path):
    save(SAMPLE, tmp_path / "saved.h5")
    expected = (tmp_path / "saved.h5").read_bytes()
    memory = MemoryStore(COLUMNS[::-1])
    memory.append(ROWS)
    made = [memory]
    for k, (rows, pieces) in enumerate(((1, (40,)), (3, (7, 33)), (16, (5,) * 8), (99, (40,)))):
        monkeypatch.setattr(segments, "SEGMENT_BYTES", rows * ROW_BYTES)
        store, at = new(tmp_path / str(k)), 0
        for some in pieces:
            store.append(cut(at, at + some))
            at += some
        made.append(store)
    monkeypatch.undo()
    for source in made:
        join(source, tmp_path / "joined.h5", NET, BODIES, PROVENANCE, "ok", True)
        assert (tmp_path / "joined.h5").read_bytes() == expected


def test_large_files_have_the_same_bytes_too(monkeypatch, tmp_path):
    """Chunks of 50 rows of positions, cut by segments of 7: the same chunks as from arrays."""
    monkeypatch.setattr("exunet.results.writing.CHUNK_BYTES", 50 * 8 * 3 * NET.n_nodes)
    monkeypatch.setattr(segments, "SEGMENT_BYTES", 7 * ROW_BYTES)
    many = sample(times=333)
    save(many, tmp_path / "saved.h5")
    store = new(tmp_path / "store")
    store.append(rows_of(many))
    join(store, tmp_path / "joined.h5", NET, BODIES, PROVENANCE, "ok", True)
    assert (tmp_path / "joined.h5").read_bytes() == (tmp_path / "saved.h5").read_bytes()
    assert_equal(load_result(tmp_path / "joined.h5"), many)


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
@pytest.mark.parametrize("path", ["net/position", "energy/potential", "bodies/target/attitude"])
def test_nan_and_infinity_are_not_joined(path, bad, tmp_path):
    store = new(tmp_path / "store")
    store.append(cut(0, 20))
    rows = {name: values.copy() for name, values in cut(20, 25).items()}
    rows[path].reshape(5, -1)[3, -1] = bad
    store.append(rows)
    with pytest.raises(InputError, match=rf"{path} contains NaN or infinity \(first at \[23"):
        join(store, tmp_path / "joined.h5", NET, BODIES, PROVENANCE, "ok", True)
    assert not (tmp_path / "joined.h5").exists()


def test_times_that_do_not_increase_are_not_joined(tmp_path):
    store = MemoryStore(COLUMNS)
    for _ in range(2):
        store.append(cut(0, 5))
    for source in (store, MemoryStore(COLUMNS)):
        with pytest.raises(InputError, match="stored times must be at least one, and increase"):
            join(source, tmp_path / "joined.h5", NET, BODIES, PROVENANCE, "ok", True)


def assert_equal(found, expected):
    for path, values in rows_of(found).items():
        np.testing.assert_array_equal(np.asarray(values), rows_of(expected)[path], strict=True, err_msg=path)


# --- states of a run that has not come to its end


@pytest.mark.parametrize("place", ["", "unfinished"])
def test_an_unfinished_run_is_an_incomplete_result(place, small_segments, tmp_path):
    store = new(tmp_path / place)
    with pytest.raises(InputError, match="has not stored a state yet"):
        load_result(tmp_path)
    store.append(cut(0, 18))
    found = load_result(tmp_path)
    assert_equal(found, next(SAMPLE.parts(14)))
    assert not found.complete
    end = SAMPLE.time[13]
    assert found.verdict == f"unfinished: 14 states until t = {end:.6g} s were stored"
    assert found.provenance == PROVENANCE
    assert found.bodies["target"].inertia is not None
    np.testing.assert_array_equal(found.bodies["target"].inertia, RIGID.inertia)
    np.testing.assert_array_equal(found.net.element_nodes, NET.element_nodes)
    assert (found.net.faces, found.net.mouth) == (NET.faces, NET.mouth)


def test_a_folder_with_a_result_is_read_for_it(tmp_path):
    new(tmp_path / "unfinished")
    save(SAMPLE, tmp_path / "result.h5")
    assert load_result(tmp_path).complete
    with pytest.raises(InputError, match=r"neither a result\.h5 nor"):
        open_unfinished(tmp_path / "elsewhere")


# --- larger than memory


def test_large_files_are_read_when_asked(monkeypatch, small_segments, tmp_path):
    save(SAMPLE, tmp_path / "result.h5")
    store = new(tmp_path / "unfinished")
    store.append(ROWS)
    store.flush()
    monkeypatch.setattr(from_rows, "IN_MEMORY", 1000)
    for found in (load_result(tmp_path / "result.h5"), open_unfinished(tmp_path)):
        assert isinstance(found.position, StoredRows)
        assert isinstance(found.bodies["target"].attitude, StoredRows)
        assert isinstance(found.kinetic, StoredRows)
        assert isinstance(found.time, np.ndarray)
        assert_equal(found, SAMPLE)
        save(found, tmp_path / "again.h5", overwrite=True)
        parts = list(found.parts(11))
        assert [len(part.time) for part in parts] == [11, 11, 11, 7]
        assert all(isinstance(part.bodies["chaser"].position, np.ndarray) for part in parts)
        for name in ("time", "position", "tension", "least_kinetic"):
            whole = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_array_equal(whole, getattr(SAMPLE, name), strict=True)


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
    monkeypatch.setattr("exunet.results.rows.BLOCK_BYTES", 8 * 8 * 12)
    found = list(blocks(VALUES))
    assert [len(block) for block in found] == [8] * 6 + [2]
    np.testing.assert_array_equal(np.concatenate(found), VALUES)
    assert [block.shape for block in blocks(VALUES[:0])] == [(0, 4, 3)]


# --- kills

# Appends rows one by one in segments of three, with drops and checkpoints, and kills itself instead of its
# n-th system call of those that a file's fate depends on. Before each step it tells the numbers of indexed
# rows, and the checkpoints, before and after it. A kill, unlike a power cut, needs no synchronised disk.
KILLED = """
import os, random, signal, sys
sys.path.insert(0, sys.argv[1])
import test_store as t
from exunet.results import segments
segments.SEGMENT_BYTES = 3 * t.ROW_BYTES

def main(folder, calls):
    left = calls
    def counted(call):
        def instead(*arguments, **options):
            nonlocal left
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)
        return instead
    log = os.open(folder + '.log', os.O_CREAT | os.O_WRONLY)
    os.fsync = counted(lambda descriptor: None)
    for name in ('replace', 'unlink', 'open'):
        setattr(os, name, counted(getattr(os, name)))
    store, choose = t.new(folder), random.Random(calls)
    def tell(indexed, checkpoint):
        now = sum(segment.rows for segment in store._segments)
        os.write(log, f'{now} {indexed} {store.checkpoint or 0} {checkpoint or 0}\\n'.encode())
    while True:
        indexed = sum(segment.rows for segment in store._segments)
        rows = len(store) + 1
        tell(rows if rows - indexed == 3 else indexed, store.checkpoint)
        store.append(t.cut(rows - 1, rows))
        what, back = choose.random(), choose.randrange(8)
        if what < 0.2:
            tell(rows, store.checkpoint)
            store.flush()
        elif what < 0.4:
            tell(rows, str(rows))
            store.flush(checkpoint=str(rows))
        kept = 2 if rows == t.TIMES else max(0, rows - back)
        if rows == t.TIMES or 0.4 < what < 0.5:
            indexed = sum(segment.rows for segment in store._segments)
            tell(min(indexed, kept), store.checkpoint)
            store.drop_after(kept)

for number in range(int(sys.argv[3])):
    calls = random.Random(number).randrange(1, 400)
    child = os.fork()
    if child == 0:
        main(f'{sys.argv[2]}/{number}', calls)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")
def test_a_store_outlives_a_kill_at_any_moment(monkeypatch, tmp_path):
    """30 kills at seeded numbers of system calls, from the first (no store yet) to the 400th."""
    kills = 30
    command = [sys.executable, "-c", KILLED, str(Path(__file__).parent), str(tmp_path), str(kills)]
    subprocess.run(command, check=True)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    between = 0
    for number in range(kills):
        folder = tmp_path / str(number)
        told = (tmp_path / f"{number}.log").read_text().splitlines()
        if not told and not (folder / "index.exu").exists():
            continue  # killed before the store was there
        before, after, old, new_one = map(int, (told or ["0 0 0 0"])[-1].split())
        store = SegmentStore(folder)
        assert len(store) in (before, after)
        assert int(store.checkpoint or 0) in (old, new_one)
        between += before != after
        assert_rows(store, len(store))
        assert not list(folder.glob(".exunet-*"))
        if store.checkpoint is not None:
            store.back_to_checkpoint()
            assert_rows(store, int(store.checkpoint))
        store.append(cut(len(store), TIMES))
        assert_rows(store, TIMES)
        store.discard()
    assert between > 10  # most calls are made while a segment and its index are written


# --- damage


@pytest.fixture
def stored(small_segments, tmp_path):
    """A closed store of six segments."""
    store = new(tmp_path / "store")
    store.append(ROWS)
    store.close()
    return tmp_path / "store"


@pytest.mark.parametrize("file", ["index.exu", "run.exu", "segment-000003.exu"])
def test_every_flipped_byte_is_refused_with_the_name_of_the_file(file, stored):
    """One byte of each hundred and three, which hits headers, digests and values."""
    whole = (stored / file).read_bytes()
    for at in range(0, len(whole), 103):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << at % 8
        (stored / file).write_bytes(flipped)
        with pytest.raises(InputError, match=file):
            open_unfinished(stored)
    (stored / file).write_bytes(whole)
    assert_equal(open_unfinished(stored), SAMPLE)


@pytest.mark.parametrize("file", ["run.exu", "segment-000003.exu"])
def test_a_lost_file_is_named(file, stored):
    (stored / file).unlink()
    with pytest.raises(InputError, match=f"{file}: cannot be read"):
        open_unfinished(stored)


def test_files_of_another_run_are_refused(stored, tmp_path):
    other = new(tmp_path / "other")
    other.append(ROWS)
    other.close()
    mine, theirs = stored / "segment-000002.exu", other.folder / "segment-000002.exu"
    kept = mine.read_bytes()
    mine.write_bytes(theirs.read_bytes())
    with pytest.raises(InputError, match=r"segment-000002\.exu: it is not the segment that the index names"):
        open_unfinished(stored)
    mine.write_bytes(kept)
    (stored / "run.exu").write_bytes((other.folder / "run.exu").read_bytes())
    with pytest.raises(InputError, match="different runs"):
        open_unfinished(stored)


def test_segments_that_the_index_does_not_name_do_not_count(stored):
    extra = stored / "segment-000099.exu"
    extra.write_bytes((stored / "segment-000001.exu").read_bytes())
    assert_equal(open_unfinished(stored), SAMPLE)
    assert_rows(SegmentStore(stored), TIMES)
    assert not extra.exists()


FULL = """
import resource, sys
sys.path.insert(0, sys.argv[1])
import test_store as t
from exunet.base.errors import InputError
from exunet.results import segments
store = t.new(sys.argv[2])
store.append(t.cut(0, 5))
store.flush()
resource.setrlimit(resource.RLIMIT_FSIZE, (9999, resource.RLIM_INFINITY))
store.append(t.cut(5, 20))
try:
    store.flush()
except InputError as error:
    print(error)
t.assert_rows(store, 20)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
store.close()
"""


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_full_disk_loses_no_row(tmp_path):
    """What could not be written stays in memory, and is written when there is room again."""
    folder = tmp_path / "store"
    command = [sys.executable, "-c", FULL, str(Path(__file__).parent), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{folder}/segment-000002.exu: cannot be written: File too large"
    assert_rows(SegmentStore(folder), 20)


def test_rows_whose_index_cannot_be_written_are_not_taken_for_stored(monkeypatch, small_segments, tmp_path):
    store = new(tmp_path)
    store.append(cut(0, 9))  # a segment of seven, and two
    store.flush(checkpoint="9")

    def full(*_):
        raise cannot_write(tmp_path / segments.INDEX, OSError(28, "No space left on device"))

    with monkeypatch.context() as patch:
        patch.setattr(segments, "_write_index", full)
        store.append(cut(9, 12))
        with pytest.raises(InputError, match="No space left on device"):
            store.flush(checkpoint="12")
        assert (store.written, store.checkpoint) == (9, "9")
        assert_rows(store, 12)
    store.close()
    assert_rows(SegmentStore(tmp_path), 12)


def test_folders_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        new(tmp_path / "file")
    with pytest.raises(InputError, match="no stored states of an unfinished run"):
        SegmentStore(tmp_path)


def test_ctrl_c_within_a_write_comes_after_it(monkeypatch, small_segments, tmp_path):
    """Between the file of a segment and the index, an interrupt would leave rows that are counted twice."""
    store = new(tmp_path)
    write = segments.write_arrays

    def interrupted(*arguments):
        write(*arguments)
        monkeypatch.setattr(segments, "write_arrays", write)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(segments, "write_arrays", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.append(cut(0, 20))
    assert_rows(store, 20)
    store.close()
    assert_rows(SegmentStore(tmp_path), 20)
