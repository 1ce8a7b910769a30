"""`exunet compare` and what it is made of."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.base.errors import InputError
from exunet.cli.main import main
from exunet.results.body_comparison import compare_bodies
from exunet.results.comparison import compare, match_nodes, read_states
from exunet.results.result import BodyStates
from exunet.results.summary import summarise
from exunet.results.table import rows
from reference_impl.__main__ import main as reference_main

CASE = str(Path(__file__).parents[1] / "cases" / "planar_undamped.toml")
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


@pytest.mark.ci
@pytest.mark.slow
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
    shuffled = dataclasses.replace(
        ours,
        position=ours.position[:, order],
        velocity=ours.velocity[:, order],
        reference_position=ours.reference_position[order],
        mass=ours.mass[order],
        element_nodes=rank[ours.element_nodes][::-1, ::-1],
        reference_length=ours.reference_length[::-1],
        axial_stiffness=ours.axial_stiffness[::-1],
        bullet_nodes=rank[ours.bullet_nodes],
    )
    assert np.array_equal(match_nodes(ours, shuffled), rank)
    assert not compare(ours, shuffled).position_difference.any()


def test_a_swapped_element_is_not_the_same_net(files):
    ours = read_states(files[0])
    elements = ours.element_nodes.copy()
    elements[3, 1] = next(k for k in range(40) if k not in elements[3])
    with pytest.raises(InputError, match="elements join different nodes"):
        compare(ours, dataclasses.replace(ours, element_nodes=elements))


def test_nets_that_differ_in_mass_or_stiffness_are_not_the_same(files):
    ours = read_states(files[0])
    for name, where in (
        ("mass", "mass of node 5 is"),
        ("axial_stiffness", "axial stiffness of element 5 is"),
        ("reference_length", "reference length of element 5 is"),
    ):
        values = getattr(ours, name).copy()
        values[5] *= 1.0 + 1e-6
        with pytest.raises(InputError, match=f"not the same net: {where}"):
            compare(ours, dataclasses.replace(ours, **{name: values}))
    with pytest.raises(InputError, match="different nodes are fixed"):
        compare(ours, dataclasses.replace(ours, fixed_nodes=np.array([4])))


@pytest.mark.parametrize("name", ["position", "velocity"])
def test_what_is_no_number_does_not_agree(files, name):
    ours = read_states(files[0])
    values = getattr(ours, name).copy()
    values[40, ours.bullet_nodes[0]] = np.nan
    other = dataclasses.replace(ours, **{name: values})
    for a, b in ((ours, other), (other, ours)):
        found = compare(a, b)
        assert found.agrees_until == pytest.approx(0.2)  # 40 times the output step of 0.005 s
        assert found.apart_from is None  # there alone


def test_runs_that_meet_again_are_apart_for_good_from_their_last_parting_on(files):
    """Positions 1 mm apart at rows 30 and 31 and from row 60 on; rows are 0.005 s apart."""
    ours = read_states(files[0])
    position = ours.position.copy()
    position[[30, 31, *range(60, 101)], 3, 2] += 1e-3
    found = compare(ours, dataclasses.replace(ours, position=position))
    assert found.agrees_until == pytest.approx(30 * 0.005)
    assert found.apart_from == pytest.approx(60 * 0.005)
    assert np.flatnonzero(found.position_difference).tolist() == [30, 31, *range(60, 101)]


@pytest.mark.parametrize(
    ("apart", "until", "since"),
    [(slice(100, 101), 0.5, 0.5), (slice(0, 100), 0.0, None), (slice(0, 101), 0.0, 0.0)],
    ids=["at the last time", "but at the last time", "always"],
)
def test_times_from_which_runs_are_apart(files, apart, until, since):
    ours = read_states(files[0])
    position = ours.position.copy()
    position[apart, 3, 2] += 1e-3
    found = compare(ours, dataclasses.replace(ours, position=position))
    assert (found.agrees_until, found.apart_from) == (until, since)


def test_the_first_and_the_last_time_are_printed(files, monkeypatch, capsys):
    """Twenty of the 101 times in common, from 0 s to 0.5 s."""
    assert run(monkeypatch, "compare", *files) == 0
    times = re.findall(r"^t = ([\d.]+) s", capsys.readouterr().out, re.MULTILINE)
    assert len(times) == 20
    assert (times[0], times[-1]) == ("0", "0.5")


def test_the_limit_that_decides_is_printed(files, tmp_path, monkeypatch, capsys):
    """Positions 1e-3 m apart from 0.25 s on; speeds are the same."""
    with np.load(files[1]) as file:
        arrays = dict(file)
    arrays["position"][50:, 3, 2] += 1e-3
    moved = tmp_path / "moved.npz"
    np.savez(moved, **arrays)
    assert run(monkeypatch, "compare", files[0], moved) == 0
    rows = {line[:18].strip(): line[18:].strip() for line in capsys.readouterr().out.splitlines()}
    assert rows["first beyond that"] == "t = 0.25 s"
    assert rows["largest"].startswith("positions 1.000e-03 m at t = 0.25 s")
    # 2e-5 of the diagonal of 7 m x 7 m: strings of sqrt(2) m stand 1 m out of the corners of 5 m x 5 m
    assert "positions 1.980e-04 m" in rows["allowed"]


OVER_TIME = ("body_position", "body_velocity", "body_attitude", "body_angular_velocity")
BROKEN = {
    "no number": ({"position": lambda x: x * np.nan}, "position contains NaN or infinity"),
    "infinite": ({"velocity": lambda v: np.where(v == v, np.inf, v)}, "velocity contains NaN or infinity"),
    "no times": ({"t": lambda t: t[:0]}, "shape"),
    "no states": (
        dict.fromkeys(("t", "position", "velocity", *OVER_TIME), lambda values: values[:0]),
        "at least one, and increase",
    ),
    "one time": ({"t": lambda t: t[0]}, r"t has shape \(\)"),
    "reversed": ({"t": lambda t: t[::-1]}, "the stored times must .* increase"),
    "one state": ({"position": lambda x: x[0]}, "position has shape"),
    "two nodes less": ({"velocity": lambda v: v[:, :-2]}, "velocity has shape"),
    "in the plane": ({"position": lambda x: x[..., :2]}, "position has shape"),
    "a net in the plane": ({"reference_position": lambda x: x[:, :2]}, "reference_position has shape"),
    "text": ({"position": lambda x: x.astype(str)}, "position holds <U.*, not real numbers"),
    "complex": ({"position": lambda x: x.astype(complex)}, "position holds complex128, not real numbers"),
    "objects": ({"position": lambda x: np.array([None, 1])}, "position holds objects, not real numbers"),
    "half a node": ({"bullet_nodes": lambda k: k + 0.5}, "bullet_nodes holds float64, not node numbers"),
    "no such node": ({"element_nodes": lambda k: -1 - k}, "element_nodes refers to a node"),
    "two verdicts": ({"complete": lambda c: np.array([True, False])}, "complete is not a single truth value"),
    "a later format": ({"format": lambda f: f + 98}, "its format is 99, this exunet reads format 1"),
    "other masses": ({"mass": lambda m: 3.0 * m}, "not the same net: mass of node 0"),
    "no attitudes": ({"body_attitude": None}, "bodies or breaks, but no array body_attitude"),
    "names that are numbers": (
        {"body_names": lambda names: np.zeros(0)},
        "body_names holds float64, not text",
    ),
    "no such element": (
        {"break_element": lambda k: np.array([10**6]), "break_time": lambda t: np.zeros(1)},
        "break_element refers to an element",
    ),
    "no masses": ({"mass": None}, "not a file of reference_impl: it has no array mass"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_arrays_that_make_no_sense_are_refused_in_one_line(what, files, tmp_path, monkeypatch, capsys):
    changes, reason = BROKEN[what]
    with np.load(files[1]) as file:
        arrays = dict(file)
    for name, change in changes.items():
        kept = arrays.pop(name)
        if change:
            arrays[name] = change(kept)
    bad = tmp_path / "bad.npz"
    np.savez(bad, **arrays)
    assert run(monkeypatch, "compare", files[0], bad) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(reason, line)


@pytest.mark.ci
@pytest.mark.slow
def test_bad_files_are_refused(files, tmp_path, monkeypatch, capsys):
    whole = files[1].read_bytes()
    named = {
        "zip.npz": (b"PK", "not an archive"),
        "empty.npz": (b"", "not an archive"),
        "text.npz": (b"hello", "not an archive"),
        "half.npz": (whole[: len(whole) // 2], "damaged or cut short"),
        "bit.npz": (whole[:99999] + bytes([whole[99999] ^ 255]) + whole[100000:], "damaged or cut short"),
    }
    for name, (content, _) in named.items():
        (tmp_path / name).write_bytes(content)
    reasons = {name: reason for name, (_, reason) in named.items()}
    for name, reason in (reasons | {"none.npz": "No such file", "none.h5": "none.h5"}).items():
        assert run(monkeypatch, "compare", files[0], tmp_path / name) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert reason in line
        assert "pickle" not in line


def spinning(name: str, *, angle: float = 0.0) -> str:
    """A body that has turned by an angle about z at the start."""
    turned = [float(np.cos(angle / 2)), 0.0, 0.0, float(np.sin(angle / 2))]
    return f"bodies.{name}={{mass=2.0,inertia=[1.0,1.0,1.0],velocity=[0.0,1.0,0.0],attitude={turned}}}"


def test_bodies_are_compared_by_name(tmp_path, monkeypatch, capsys):
    for name, body in (("a", spinning("target")), ("b", spinning("target", angle=1e-3))):
        extra = spinning(f"only_{name}")
        exunet.save(exunet.run(exunet.load(CASE, ["time.end=0.02", body, extra])),
                    tmp_path / f"{name}.h5")  # fmt: skip
    found = compare(read_states(tmp_path / "a.h5"), read_states(tmp_path / "b.h5")).bodies
    assert (found.only_a, found.only_b) == (("only_a",), ("only_b",))
    target = found.both["target"]
    assert target.attitude == pytest.approx(1e-3, rel=1e-9)
    assert target.agrees_until == 0.0
    assert target.allowed_attitude == pytest.approx(2e-5)
    assert not target.position.any()
    assert not target.velocity.any()
    assert not target.angular_velocity.any()
    assert run(monkeypatch, "compare", tmp_path / "a.h5", tmp_path / "b.h5") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "attitude 1.000e-03 rad at t" in printed
    assert "attitude 2.000e-05 rad; first beyond that: t = 0 s" in printed
    assert "body only_a only in" in printed
    assert "body only_b only in" in printed


def test_a_check_says_whose_speeds_and_judges_bodies_by_limits_of_their_own(tmp_path):
    """A net without bullets, and a body that is 1e-3 rad apart from the start."""
    net = "net={topology='explicit',nodes=[[0.0,0.0,0.0],[1.0,0.0,0.0]],elements=[[0,1]]," \
        "cable={diameter=1e-3,density=1390.0,youngs_modulus=7e10}}"  # fmt: skip
    sets = ["time.end=0.02", "time.output_step=0.01", net, "launch=", "initial={packing=1.0}"]
    one, other = (
        exunet.run(exunet.load(CASE, [*sets, spinning("target", angle=angle)])) for angle in (0.0, 1e-3)
    )
    summary = summarise(one, compare(one, other))
    assert summary["check"]["speeds_of"] == "nodes"
    assert summary["check"]["agrees_until_s"] is None
    assert summary["check"]["bodies"]["target"]["agrees_until_s"] == 0.0
    printed = dict(rows(summary))
    assert "speeds of the nodes within" in printed["check: agrees until"]
    assert "bullet" not in printed["check: agrees until"]
    words = printed["check: body target"]
    assert words.startswith("agrees until t = 0.000 s; over the run positions within 0.0e+00 m (allowed ")
    assert words.endswith("attitudes within 1.0e-03 rad (allowed 2.0e-05 rad)")
    same = dict(rows(summarise(one, compare(one, one))))
    assert same["check: body target"].startswith("agrees until the end; ")


def test_a_quaternion_and_its_negative_are_the_same_attitude():
    one = np.array([[0.6, 0.8, 0.0, 0.0]])
    still = np.zeros((1, 3))
    at = np.array([0])
    bodies = [{"target": BodyStates(1.0, np.eye(3), still, still, q, still)} for q in (one, -one)]
    assert compare_bodies(*bodies, (at, at), np.zeros(1), (1.0, 1.0)).both["target"].attitude == 0.0
