"""The result file: exact round trip, the same bytes each time, whole or absent, and refusals in one line."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from result_samples import net, result, square_net, unfolding

from exunet.base.errors import InputError
from exunet.results.io import FILE_FORMAT, load_result, save
from exunet.results.result import BodyStates, TermStates
from exunet.results.run_record import CaseText, RunRecord
from exunet.results.summary import summarise


def assert_same(a, b):
    """Two results, nets or motions of a body: the same types, shapes and bits."""
    for field in fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if field.name == "net":
            assert_same(x, y)
        elif field.name == "bodies":
            assert list(x) == list(y)
            for name in x:
                assert_same(x[name], y[name])
        elif isinstance(x, np.ndarray):
            assert x.dtype == y.dtype, field.name
            np.testing.assert_array_equal(x, y, err_msg=field.name, strict=True)
        else:
            assert x == y, field.name


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "run.h5"
    save(unfolding(square_net(cells=3, strings=True), bodies=BODIES), path)
    return path


BODIES = {
    "chaser": BodyStates(
        500.0,
        np.eye(3),
        np.arange(21.0).reshape(7, 3),
        np.ones((7, 3)),
        np.tile([1.0, 0.0, 0.0, 0.0], (7, 1)),
        np.zeros((7, 3)),
    ),
    "target": BodyStates(
        2000.0,
        np.diag([1.0, 2.0, 3.0]),
        np.zeros((7, 3)),
        np.full((7, 3), -0.0),
        np.tile([1.0, 0.0, 0.0, 0.0], (7, 1)),
        np.linspace(0, 1, 21).reshape(7, 3),
    ),
}


SAMPLES = {
    "square": unfolding(square_net(cells=5, strings=True), times=90),  # large enough to be compressed
    "no openings, no bullets": result(net([(0, 0, 0), (1, 0, 0)], [(0, 1)]), [0], [[(0, 0, 0), (1, 0, 0)]]),
    "no elements": result(net([(0, 0, 0)], [], bullets=(0,)), [0, 1], [[(0, 0, 0)], [(0, 0, 1e-300)]]),
    "incomplete": unfolding(square_net(), run=RunRecord(verdict="element 3 (nodes 1–2) ran away: λ = 9")),
    "energies between": unfolding(square_net(), largest_elastic=np.arange(7.0), least_kinetic=np.zeros(7)),
    "bodies": unfolding(square_net(), bodies=BODIES),
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


def test_long_record(tmp_path):
    """Attributes of a fixed size are limited to 64 KiB by HDF5; case texts with many nodes are longer."""
    whole = replace(unfolding(square_net()), run=RunRecord(title="é", case=CaseText(text="x" * 300_000)))
    save(whole, tmp_path / "run.h5")
    assert load_result(tmp_path / "run.h5").run == whole.run


def test_same_result_gives_same_bytes(tmp_path):
    whole = SAMPLES["square"]
    save(whole, tmp_path / "a.h5")
    save(whole, tmp_path / "b.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    save(load_result(tmp_path / "a.h5"), tmp_path / "c.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "c.h5").read_bytes()


def test_files_hold_no_time_stamps(stored):
    """HDF5's own, which count seconds, would make files of the same result differ."""
    with h5py.File(stored) as file:
        tracked = []
        file.visititems(
            lambda name, item: tracked.append((name, item.id.get_create_plist().get_obj_track_times()))
        )
        assert tracked
        assert not any(times for _, times in tracked), tracked


def test_every_dataset_has_units_and_description(stored):
    with h5py.File(stored) as file:
        found = []
        file.visititems(lambda name, item: found.append(item) if isinstance(item, h5py.Dataset) else None)
        # states; net arrays, and values with offsets for faces and mouth; of two bodies
        assert len(found) == 11 + 11 + 4 + 2 * (2 + 4)
        for dataset in found:
            assert dataset.attrs["units"], dataset.name
            assert dataset.attrs["description"], dataset.name
        assert file["net/position"].attrs["units"].decode() == "m"
        assert file["bodies/target/angular_velocity"].attrs["units"].decode() == "rad/s"
        assert file.attrs["format"] == FILE_FORMAT


def test_energies_between_the_stored_times_need_not_be_there(stored):
    """Results that were not made by a run have none; where they are, they must fit."""
    assert load_result(stored).largest_elastic is None
    with h5py.File(stored, "a") as file:
        file["energy/largest_elastic"] = np.zeros(6)
    assert "energy/largest_elastic has shape" in refusal(stored)


@pytest.mark.parametrize("name", ["position", "tension", "kinetic"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_and_infinity_are_never_written(name, bad, tmp_path):
    whole = unfolding(square_net())
    values = getattr(whole, name).copy()
    values.flat[-1] = bad
    with pytest.raises(InputError, match=f"/{name} contains NaN or infinity"):
        save(replace(whole, **{name: values}), tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"time": np.zeros(7)}, "stored times"),
        ({"kinetic": np.zeros(6)}, "energy/kinetic has shape"),
        ({"bodies": {"a/b": BODIES["chaser"]}}, "name of a body"),
        ({"bodies": {"a": replace(BODIES["chaser"], velocity=np.zeros((7, 2)))}}, "bodies/a/velocity has"),
        ({"run": RunRecord(energy_scale_J=float("nan"))}, "record"),
        ({"net": replace(square_net(), mouth=(0, 1, 4))}, "node that the net does not have"),
        ({"net": replace(square_net(), mass=np.full(4, np.nan))}, "mass of the net contains NaN"),
    ],
)
def test_save_refuses_what_does_not_fit(changes, said, tmp_path):
    with pytest.raises(InputError, match=said):
        save(replace(unfolding(square_net()), **changes), tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []


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
    save(unfolding(square_net(cells=2)), link, overwrite=True)
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
    assert "neither a result.h5 nor the states of an unfinished run" in refusal(tmp_path)
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


def test_load_refuses_another_format(stored):
    with h5py.File(stored, "a") as file:
        file.attrs["format"] = FILE_FORMAT + 1
    refusal(stored)


@pytest.mark.parametrize("part", [0.01, 0.3, 0.9, 0.9999])
def test_load_refuses_truncated_file(stored, part):
    whole = stored.read_bytes()
    stored.write_bytes(whole[: int(part * len(whole))])
    assert "damaged or cut short" in refusal(stored)


@pytest.mark.parametrize(
    "lost", ["time", "net/tension", "net/reference/mass", "net/reference/face_offsets", "net", "energy"]
)
def test_load_refuses_incomplete_file(stored, lost):
    with h5py.File(stored, "a") as file:
        del file[lost]
    assert "damaged or cut short" in refusal(stored)


def test_load_refuses_values_out_of_order(stored):
    with h5py.File(stored, "a") as file:
        file["net/velocity"][1, 0, 2] = np.nan
    assert "net/velocity contains NaN or infinity (first at [1, 0, 2])" in refusal(stored)
    with h5py.File(stored, "a") as file:
        file["net/velocity"][1, 0, 2] = 0.0
        file["net/reference/element_nodes"][0, 0] = 99
    assert "node that the net does not have" in refusal(stored)
    with h5py.File(stored, "a") as file:
        file["net/reference/element_nodes"][0, 0] = 1
        file["bodies/target/inertia"][0, 0] = np.nan
    assert "inertia" in refusal(stored)
    with h5py.File(stored, "a") as file:
        file["bodies/target/inertia"][0, 0] = 1.0
        file["net/reference/face_offsets"][1] = 99
    assert "damaged" in refusal(stored)


@pytest.mark.ci
@pytest.mark.slow
def test_importing_the_module_is_quick():
    """h5py and matplotlib are loaded when a file or a figure is made, not before."""
    program = "import sys, exunet.results.io, exunet.results.io, exunet.plots\n"
    program += "print('h5py' in sys.modules, 'matplotlib' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.split() == ["False", "False"]


SMALL_FILE = """
import resource, sys
sys.path.insert(0, sys.argv[1])
from result_samples import square_net, unfolding
from exunet.base.errors import InputError
from exunet.results.io import save
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]),) * 2)
try:
    save(unfolding(square_net(cells=12), times=400), sys.argv[2], overwrite=True)
except InputError as error:
    print(error)
"""


@pytest.mark.ci_for("0.0")
@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
@pytest.mark.parametrize("part", [0.0, 0.01, 0.3, 0.9, 0.99999])
def test_a_file_that_cannot_grow_is_one_line_and_leaves_the_older_file(part, tmp_path):
    """Limited to a part of its length; inside HDF5 a failed write would end the process."""
    path = tmp_path / "run.h5"
    save(unfolding(square_net(cells=12), times=400), path)
    limit = int(part * path.stat().st_size)
    save(unfolding(square_net()), path, overwrite=True)
    before = path.read_bytes()
    command = [sys.executable, "-c", SMALL_FILE, str(Path(__file__).parents[1]), str(path), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == f"{path}: cannot be written: File too large"
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == before


def test_bodies_have_a_row_in_the_summary():
    """The sample's chaser goes from (0, 1, 2) m to (18, 19, 20) m: 18 m along each axis."""
    summary = summarise(unfolding(square_net(), bodies=BODIES))
    assert summary["bodies"] == {
        "chaser": {"mass_kg": 500.0, "mass_of_nodes_kg": 0.0},
        "target": {"mass_kg": 2000.0, "mass_of_nodes_kg": 0.0},
    }
    found = {name: one["value"] for name, one in summary["metrics"].items()}
    assert found["body_chaser_displacement_m"] == pytest.approx(18 * 3**0.5)
    assert found["body_target_displacement_m"] == 0.0


def test_representations_are_short_and_name_the_fields():
    """Of results in memory and in a file; the parts of states are those of their values."""
    states = {"contact/pressed": TermStates("N", np.arange(700.0).reshape(7, 100))}
    result = replace(unfolding(square_net(cells=20)), bodies=BODIES, states=states)
    for value in (result, result.net, *result.bodies.values(), *result.states.values()):
        shown = repr(value)
        assert len(shown) < 1000, shown
        names = [field.name for field in fields(value) if getattr(value, field.name) is not None]
        assert all(f"{name}=" in shown for name in names)
    pressed = result.states["contact/pressed"]
    assert pressed[-1, 3] == 603.0
    assert np.asarray(pressed).shape == pressed[...].shape == (7, 100)
