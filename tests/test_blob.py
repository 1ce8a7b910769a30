"""The checked container: bit for bit what was written, and refused for every byte that is not."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from exunet.base.blob import read_arrays, write_arrays
from exunet.base.errors import InputError

HEADER = {"step": 1e-3, "time": 0.1 + 0.2, "names": ["a", "ü"], "none": None, "deep": {"yes": True}}
ARRAYS = {
    "state": np.array([[0.0, -0.0, 5e-324], [np.nan, np.inf, -np.inf]]),
    "broken": np.array([True, False]),
    "steps": np.array(-7),
    "bytes": np.arange(256, dtype=np.uint8),
    "nothing": np.empty((0, 3)),
}


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "state.exu"
    write_arrays(path, "snapshot", 3, HEADER, ARRAYS)
    return path


def refusal(path, kind="snapshot", version=3, only=None):
    with pytest.raises(InputError) as caught:
        read_arrays(path, kind, version, only)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_round_trip_is_bit_for_bit(written):
    """Signs of zero, payloads of NaN, infinities and numbers below the normal range are bits like others."""
    header, arrays = read_arrays(written, "snapshot", 3)
    assert header == HEADER
    assert list(arrays) == list(ARRAYS)
    for name, values in ARRAYS.items():
        assert arrays[name].dtype == values.dtype
        assert arrays[name].shape == values.shape
        assert arrays[name].tobytes() == values.tobytes()
        assert arrays[name].flags.writeable
    assert list(written.parent.iterdir()) == [written]


def test_same_content_gives_same_bytes(written, tmp_path):
    write_arrays(tmp_path / "again.exu", "snapshot", 3, HEADER, ARRAYS)
    assert (tmp_path / "again.exu").read_bytes() == written.read_bytes()


def test_arrays_in_another_order_or_byte_order_are_kept_by_value(tmp_path):
    path = tmp_path / "a.exu"
    values = np.arange(6.0).reshape(2, 3)
    write_arrays(path, "x", 1, {}, {"fortran": np.asfortranarray(values), "big": values.astype(">f8")})
    for found in read_arrays(path, "x", 1)[1].values():
        np.testing.assert_array_equal(found, values)
        assert found.dtype == np.float64


def test_some_arrays_alone(written):
    header, arrays = read_arrays(written, "snapshot", 3, only=("steps",))
    assert (header, list(arrays), int(arrays["steps"])) == (HEADER, ["steps"], -7)
    assert "it has no array tension" in refusal(written, only=("tension", "steps"))


def test_every_flipped_byte_is_refused(written):
    whole = written.read_bytes()
    for at in range(len(whole)):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << at % 8
        written.write_bytes(flipped)
        refusal(written)


def test_every_length_but_the_right_one_is_refused(written):
    whole = written.read_bytes()
    for length in range(len(whole)):
        written.write_bytes(whole[:length])
        refusal(written)
    written.write_bytes(whole + b"\0")
    assert "longer than its contents" in refusal(written)


def test_damage_is_named(written):
    """The array of 256 bytes is the last one that is not empty."""
    whole = written.read_bytes()
    written.write_bytes(whole[:-9] + b"?" + whole[-8:])
    assert "the checksum of bytes does not match" in refusal(written)
    assert read_arrays(written, "snapshot", 3, only=("state",))  # which is not damaged
    written.write_bytes(whole[:-9])
    assert "it ends within bytes" in refusal(written)
    written.write_bytes(whole[:60])
    assert "it ends within its header" in refusal(written)


def test_other_files_are_refused(written, tmp_path):
    assert "another kind ('snapshot', not 'segment')" in refusal(written, kind="segment")
    assert "its version is 3, this exunet reads 2; a newer exunet wrote it" in refusal(written, version=2)
    assert refusal(written, version=4).endswith("its version is 3, this exunet reads 4")
    assert "No such file" in refusal(tmp_path / "missing.exu")
    assert "cannot be read" in refusal(tmp_path)
    (tmp_path / "text").write_text("hello")
    assert "not a file of exunet" in refusal(tmp_path / "text")


@pytest.mark.parametrize(
    ("header", "arrays", "said"),
    [
        ({"x": float("nan")}, {}, "header cannot be written as JSON"),
        ({"x": object()}, {}, "header cannot be written as JSON"),
        ({}, {"x": np.array([None])}, "x is of type object"),
        ({}, {"x": np.zeros(3, np.float32)}, "x is of type float32"),
        ({}, {"x": np.array(["text"])}, "x is of type <U4"),
    ],
)
def test_what_cannot_be_kept_is_refused(header, arrays, said, written):
    before = written.read_bytes()
    with pytest.raises(InputError, match=said):
        write_arrays(written, "snapshot", 3, header, arrays)
    assert written.read_bytes() == before


def test_folders_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_arrays(tmp_path / "nowhere" / "state.exu", "snapshot", 3, {}, {})


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_full_disk_leaves_the_older_file(written):
    program = (
        "import resource, sys, numpy\n"
        "from exunet.base.blob import write_arrays\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (9999, 9999))\n"
        "write_arrays(sys.argv[1], 'snapshot', 3, {}, {'x': numpy.zeros(9999)})\n"
    )
    before = written.read_bytes()
    done = subprocess.run(
        [sys.executable, "-c", program, written], capture_output=True, text=True, check=False
    )
    assert f"InputError: {written}: cannot be written: File too large" in done.stderr
    assert written.read_bytes() == before
    assert list(written.parent.iterdir()) == [written]
