"""`exunet compare` and what it is made of."""

import dataclasses

import numpy as np
import pytest

import exunet
from exunet.cli import main
from exunet.compare import States, compare, match_nodes, read_states
from exunet.errors import InputError
from reference_impl.__main__ import main as reference_main

CASE = "cases/planar_undamped.toml"
SHORT = ["time.end=0.5", "time.output_step=0.005"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Paths of exunet's result and the reference's, of the same short run."""
    folder = tmp_path_factory.mktemp("compare")
    ours, theirs = folder / "result.h5", folder / "reference.npz"
    exunet.save(exunet.run(exunet.load(CASE, SHORT)), ours)
    sets = [word for option in SHORT for word in ("--set", option)]
    assert reference_main([CASE, "-o", str(theirs), *sets]) == 0
    return ours, theirs


def run(monkeypatch, *arguments):
    """Exit code of the command."""
    monkeypatch.setattr("sys.argv", ["exunet", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def test_the_two_codes_agree_on_a_short_run(files, monkeypatch, capsys):
    assert run(monkeypatch, "compare", *files) == 0
    printed = capsys.readouterr().out
    assert "101, 0 s to 0.5 s" in printed
    assert "never" in printed
    found = compare(*map(read_states, files))
    assert found.position_difference.max() < 1e-7  # a tenth of the run's accuracy of 1e-5 of the speed x time


def test_a_run_compared_with_itself_does_not_differ(files):
    ours = read_states(files[0])
    found = compare(ours, ours)
    assert not found.position_difference.any()
    assert found.agrees_until is None


def test_only_times_in_common_are_compared(files):
    ours = read_states(files[0])
    every_other = dataclasses.replace(
        ours, time=ours.time[::2], position=ours.position[::2], velocity=ours.velocity[::2]
    )
    assert np.array_equal(compare(ours, every_other).time, every_other.time)


def test_other_numbering_is_matched_by_place(files):
    ours = read_states(files[0])
    order = np.random.default_rng(5).permutation(len(ours.reference_position))
    rank = np.argsort(order)
    shuffled = States(
        ours.time,
        ours.position[:, order],
        ours.velocity[:, order],
        ours.reference_position[order],
        rank[ours.element_nodes][::-1, ::-1],
        rank[ours.bullet_nodes],
        True,
    )
    assert np.array_equal(match_nodes(ours, shuffled), rank)
    assert not compare(ours, shuffled).position_difference.any()


def test_a_swapped_element_is_not_the_same_net(files):
    ours = read_states(files[0])
    elements = ours.element_nodes.copy()
    elements[3, 1] = next(k for k in range(40) if k not in elements[3])
    with pytest.raises(InputError, match="elements join different nodes"):
        compare(ours, dataclasses.replace(ours, element_nodes=elements))


def test_bad_files_are_refused(files, tmp_path, monkeypatch, capsys):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK")
    for other, reason in ((broken, "not a readable"), (tmp_path / "none.h5", "none.h5")):
        assert run(monkeypatch, "compare", files[0], other) == 2
        assert reason in capsys.readouterr().err
