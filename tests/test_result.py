"""The result file: exact round trip, the same bytes each time, whole or absent, and refusals in one line."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from result_samples import net, result, square_net, unfolding

from exunet.base.errors import InputError
from exunet.results.result import FILE_FORMAT, load_result, save


def assert_same(a, b):
    for field in fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if field.name == "net":
            assert_same(x, y)
        elif isinstance(x, np.ndarray):
            assert x.dtype == y.dtype, field.name
            np.testing.assert_array_equal(x, y, err_msg=field.name, strict=True)
        else:
            assert x == y, field.name


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "run.h5"
    save(unfolding(square_net(cells=3, strings=True)), path)
    return path


SAMPLES = {
    "square": unfolding(square_net(cells=5, strings=True), times=90),  # large enough to be compressed
    "no openings, no bullets": result(net([(0, 0, 0), (1, 0, 0)], [(0, 1)]), [0], [[(0, 0, 0), (1, 0, 0)]]),
    "no elements": result(net([(0, 0, 0)], [], bullets=(0,)), [0, 1], [[(0, 0, 0)], [(0, 0, 1e-300)]]),
    "incomplete": unfolding(square_net(), complete=False, verdict="element 3 (nodes 1–2) ran away: λ = 9"),
    "energies between": unfolding(square_net(), largest_elastic=np.arange(7.0), least_kinetic=np.zeros(7)),
    "awkward numbers": unfolding(square_net(), potential=np.array([-0.0, 5e-324, 1.7e308, 1, 1, 1, 1])),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_round_trip_is_exact(name, tmp_path):
    path = tmp_path / "run.h5"
    save(SAMPLES[name], path)
    assert_same(load_result(path), SAMPLES[name])
    assert list(tmp_path.iterdir()) == [path]  # nothing temporary is left


def test_sign_of_zero_survives(tmp_path):
    save(SAMPLES["awkward numbers"], tmp_path / "run.h5")
    assert np.signbit(load_result(tmp_path / "run.h5").potential[0])


def test_long_provenance(tmp_path):
    """Attributes of a fixed size are limited to 64 KiB by HDF5; case texts with many nodes are longer."""
    whole = replace(unfolding(square_net()), provenance={"case": "x" * 300_000, "é": [1, 2.5, None, True]})
    save(whole, tmp_path / "run.h5")
    assert load_result(tmp_path / "run.h5").provenance == whole.provenance


def test_same_result_gives_same_bytes(tmp_path):
    whole = SAMPLES["square"]
    save(whole, tmp_path / "a.h5")
    time.sleep(1.1)  # HDF5's own time stamps count seconds
    other_order = dict(reversed(whole.provenance.items()))
    save(replace(whole, provenance=other_order), tmp_path / "b.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    save(load_result(tmp_path / "a.h5"), tmp_path / "c.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "c.h5").read_bytes()


def test_every_dataset_has_units_and_description(stored):
    with h5py.File(stored) as file:
        found = []
        file.visititems(lambda name, item: found.append(item) if isinstance(item, h5py.Dataset) else None)
        assert len(found) == 11 + 10 + 4  # states, net arrays, and values with offsets for faces and mouth
        for dataset in found:
            assert dataset.attrs["units"], dataset.name
            assert dataset.attrs["description"], dataset.name
        assert file["position"].attrs["units"].decode() == "m"
        assert file.attrs["format"] == FILE_FORMAT


def test_a_result_without_energies_between_its_stored_times_is_an_older_one(stored):
    """They came later; a file without them is as whole as ever, one with them must fit."""
    assert load_result(stored).largest_elastic is None
    with h5py.File(stored, "a") as file:
        file["largest_elastic"] = np.zeros(6)
    assert "largest_elastic has shape" in refusal(stored)


@pytest.mark.parametrize("name", ["position", "tension", "kinetic"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_never_written(name, bad, tmp_path):
    whole = unfolding(square_net())
    values = getattr(whole, name).copy()
    values.flat[-1] = bad
    with pytest.raises(InputError, match=f"{name} is not finite"):
        save(replace(whole, **{name: values}), tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"time": np.zeros(7)}, "stored times"),
        ({"kinetic": np.zeros(6)}, "kinetic has shape"),
        ({"provenance": {"x": object()}}, "provenance"),
        ({"provenance": {"x": float("nan")}}, "provenance"),
        ({"net": replace(square_net(), mouth=(0, 1, 4))}, "node that it does not have"),
        ({"net": replace(square_net(), mass=np.full(4, np.nan))}, "net.mass is not finite"),
    ],
)
def test_save_refuses_what_does_not_fit(changes, said, tmp_path):
    with pytest.raises(InputError, match=said):
        save(replace(unfolding(square_net()), **changes), tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []


def test_failed_write_leaves_the_older_file(stored, monkeypatch):
    before = stored.read_bytes()

    def full(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"run\.h5: cannot be written: No space left on device"):
        save(unfolding(square_net()), stored)
    assert stored.read_bytes() == before
    assert list(stored.parent.iterdir()) == [stored]


def test_killed_process_leaves_the_older_file(stored):
    """A process that dies while it writes (no clean-up at all) has not touched the file of that name."""
    before = stored.read_bytes()
    program = (
        "import os, sys\n"
        "from exunet.base.files import replacing\n"
        "with replacing(sys.argv[1]) as part:\n"
        "    part.write_bytes(b'half')\n"
        "    os._exit(9)\n"
    )
    assert subprocess.run([sys.executable, "-c", program, str(stored)], check=False).returncode == 9
    assert stored.read_bytes() == before


@pytest.mark.parametrize("target", ["nowhere/run.h5", ".", "\0"])
def test_save_refuses_impossible_paths(target, tmp_path):
    with pytest.raises(InputError, match="cannot be written") as caught:
        save(unfolding(square_net()), f"{tmp_path}/{target}")
    assert "\n" not in str(caught.value)


def test_save_follows_the_umask_and_links(tmp_path):
    real, link = tmp_path / "real.h5", tmp_path / "link.h5"
    save(unfolding(square_net()), real)
    link.symlink_to(real)
    save(unfolding(square_net(cells=2)), link)
    assert link.is_symlink()
    assert load_result(real).net.n_nodes == 9  # 3 x 3 knots
    mask = os.umask(0)
    os.umask(mask)
    assert real.stat().st_mode & 0o777 == 0o666 & ~mask


def refusal(path):
    with pytest.raises(InputError) as caught:
        load_result(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_load_refuses_what_is_no_hdf5_file(tmp_path):
    assert "No such file" in refusal(tmp_path / "missing.h5")
    assert "cannot be read" in refusal(tmp_path)
    text = tmp_path / "case.toml"
    text.write_text("format = 1\n")
    assert "not an HDF5 file" in refusal(text)
    empty = tmp_path / "empty.h5"
    empty.touch()
    assert "not an HDF5 file" in refusal(empty)


def test_load_refuses_hdf5_files_of_others(tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["position"] = np.zeros(3)
    assert "some other program" in refusal(path)


def test_load_refuses_newer_format(stored):
    with h5py.File(stored, "a") as file:
        file.attrs["format"] = FILE_FORMAT + 1
    assert "a newer exunet wrote it" in refusal(stored)


@pytest.mark.parametrize("part", [0.01, 0.3, 0.9, 0.9999])
def test_load_refuses_truncated_file(stored, part):
    whole = stored.read_bytes()
    stored.write_bytes(whole[: int(part * len(whole))])
    assert "damaged or cut short" in refusal(stored)


@pytest.mark.parametrize("lost", ["time", "net/mass", "net/face_offsets", "net"])
def test_load_refuses_incomplete_file(stored, lost):
    with h5py.File(stored, "a") as file:
        del file[lost]
    assert "damaged or cut short" in refusal(stored)


def test_load_refuses_values_out_of_order(stored):
    with h5py.File(stored, "a") as file:
        file["velocity"][1, 0, 2] = np.nan
    assert "velocity is not finite" in refusal(stored)
    with h5py.File(stored, "a") as file:
        file["velocity"][1, 0, 2] = 0.0
        file["net/element_nodes"][0, 0] = 99
    assert "node that it does not have" in refusal(stored)
    with h5py.File(stored, "a") as file:
        file["net/element_nodes"][0, 0] = 1
        file["net/face_offsets"][1] = 99
    assert "damaged" in refusal(stored)


def test_importing_the_module_is_quick():
    """h5py and matplotlib are loaded when a file or a figure is made, not before."""
    program = "import sys, exunet.results.result, exunet.figures\n"
    program += "print('h5py' in sys.modules, 'matplotlib' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.split() == ["False", "False"]
