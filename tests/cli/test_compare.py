"""`exunet compare` and what it is made of."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.base.errors import InputError
from exunet.cli.compare import BEYOND, BEYOND_A, BEYOND_B, NO_RANGE, SAME, WITHIN, differences
from exunet.cli.main import main
from exunet.results.comparison import compare, compare_bodies, match_nodes, read_reference, read_states
from exunet.results.result import BodyStates
from exunet.results.summary import summarise
from reference_impl.__main__ import main as reference_main

CASE = str(Path(__file__).parents[2] / "cases" / "planar_undamped.toml")
SHORT = ["time.end=0.5", "time.output_step=0.005"]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Path of the result of a short run."""
    path = tmp_path_factory.mktemp("compare") / "result.h5"
    exunet.save(exunet.run(exunet.load(CASE, SHORT)), path)
    return path


def run(monkeypatch, *arguments):
    """Exit code of the command."""
    monkeypatch.setattr("sys.argv", ["exunet", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


@pytest.mark.ci
@pytest.mark.slow
def test_the_two_codes_agree_on_a_short_run(file, tmp_path):
    sets = [word for option in SHORT for word in ("--set", option)]
    assert reference_main([CASE, str(tmp_path / "reference.npz"), *sets]) == 0
    found = compare(file, read_reference(tmp_path / "reference.npz"))
    assert len(found.time) == 101
    assert found.agrees_until is None
    assert found.position_difference.max() < 1e-7  # a tenth of the run's accuracy of 1e-5 of the speed x time


def test_a_run_compared_with_itself_does_not_differ(file, monkeypatch, capsys):
    ours = read_states(file)
    found = compare(ours, ours)
    assert found.identical
    assert found.agrees_until is None
    assert run(monkeypatch, "compare", file, file) == 0
    printed = capsys.readouterr().out
    assert "t = " not in printed
    assert "none" in printed.splitlines()[-2]
    assert (file.parent / "compare.png").stat().st_size > 1000


def test_only_times_in_common_are_compared(file):
    ours = read_states(file)
    every_other = dataclasses.replace(
        ours, time=ours.time[::2], position=ours.position[::2], velocity=ours.velocity[::2]
    )
    assert np.array_equal(compare(ours, every_other).time, every_other.time)


def test_other_numbering_is_matched_by_place(file):
    ours = read_states(file)
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


def test_a_swapped_element_is_not_the_same_net(file):
    ours = read_states(file)
    elements = ours.element_nodes.copy()
    elements[3, 1] = next(k for k in range(40) if k not in elements[3])
    with pytest.raises(InputError, match="elements join different nodes"):
        compare(ours, dataclasses.replace(ours, element_nodes=elements))


def test_nets_that_differ_in_mass_or_stiffness_are_not_the_same(file):
    ours = read_states(file)
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
def test_what_is_no_number_does_not_agree(file, name):
    ours = read_states(file)
    values = getattr(ours, name).copy()
    values[40, ours.bullet_nodes[0]] = np.nan
    other = dataclasses.replace(ours, **{name: values})
    for a, b in ((ours, other), (other, ours)):
        found = compare(a, b)
        assert found.agrees_until == pytest.approx(0.2)  # 40 times the output step of 0.005 s
        assert found.apart_from is None  # there alone


def test_runs_that_meet_again_are_apart_for_good_from_their_last_parting_on(file):
    """Positions 1 mm apart at rows 30 and 31 and from row 60 on; rows are 0.005 s apart."""
    ours = read_states(file)
    position = ours.position.copy()
    position[[30, 31, *range(60, 101)], 3, 2] += 1e-3
    found = compare(ours, dataclasses.replace(ours, position=position))
    assert found.agrees_until == pytest.approx(30 * 0.005)
    assert found.apart_from == pytest.approx(60 * 0.005)
    assert np.flatnonzero(found.position_difference).tolist() == [30, 31, *range(60, 101)]
    # 2e-5 of the diagonal of 7 m x 7 m: strings of sqrt(2) m stand 1 m out of the corners of 5 m x 5 m
    assert found.allowed_position == pytest.approx(2e-5 * 7.0 * np.sqrt(2.0))


@pytest.mark.parametrize(
    ("apart", "until", "since"),
    [(slice(100, 101), 0.5, 0.5), (slice(0, 100), 0.0, None), (slice(0, 101), 0.0, 0.0)],
    ids=["at the last time", "but at the last time", "always"],
)
def test_times_from_which_runs_are_apart(file, apart, until, since):
    ours = read_states(file)
    position = ours.position.copy()
    position[apart, 3, 2] += 1e-3
    found = compare(ours, dataclasses.replace(ours, position=position))
    assert (found.agrees_until, found.apart_from) == (until, since)


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
    assert "body target: until 0 s" in printed
    assert "attitudes 1.0e-03 rad" in printed
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
    assert summary["check"]["bodies"]["target"]["attitude_rad"] == pytest.approx(1e-3, rel=1e-9)
    assert summarise(one, compare(one, one))["check"]["bodies"]["target"]["agrees_until_s"] is None


def metric(*values: float, unit: str = "m") -> dict[str, object]:
    """A metric of one run, or of perturbed runs from the smallest to the largest."""
    limits = {"low": min(values), "median": float(np.median(values)), "high": max(values)}
    limits = limits if len(values) > 1 else None
    return {"words": "m", "unit": unit, "text": str(values), "value": values[0], "range": limits}


@pytest.mark.parametrize(
    ("one", "other", "verdict", "change"),
    [
        (metric(1.0, 2.0, 3.0), metric(2.5, 4.0, 5.0), WITHIN, "+100.0%"),
        (metric(1.0, 2.0, 3.0), metric(3.5, 4.0, 5.0), BEYOND, "+100.0%"),
        (metric(1.0, 2.0, 3.0), metric(4.0), BEYOND_A, "+100.0%"),
        (metric(4.0), metric(1.0, 2.0, 3.0), BEYOND_B, "-50.0%"),
        (metric(0.9604), metric(2.161), NO_RANGE, "+125.0%"),
        (metric(2.0), metric(1.0), NO_RANGE, "-50.0%"),
        (metric(-2.0), metric(-1.0), NO_RANGE, "+50.0%"),
        (metric(-2.0), metric(1.0), NO_RANGE, "+3 m"),
        (metric(0.0), metric(0.5), NO_RANGE, "+0.5 m"),
        (metric(2.0), metric(2.0), SAME, ""),
    ],
)
def test_a_difference_of_designs_is_judged_by_both_ranges(one, other, verdict, change):
    (found,) = differences({"m": one}, {"m": other})
    assert (found.verdict, found.change) == (verdict, change)


def test_numbers_of_elements_have_no_difference():
    (found,) = differences(*({"element_of_largest_tension": metric(value)} for value in (4.0, 9.0)))
    assert (found.verdict, found.change) == (NO_RANGE, "")


def test_defaults_of_a_renamed_body_are_not_keys_that_differ(tmp_path, monkeypatch, capsys):
    """Mass, inertia and velocity are not; the attitude that is given is the default."""
    for name in ("a", "b"):
        exunet.save(
            exunet.run(exunet.load(CASE, ["time.end=0.02", spinning(f"only_{name}")])),
            tmp_path / f"{name}.h5",
        )
    assert run(monkeypatch, "compare", tmp_path / "a.h5", tmp_path / "b.h5") == 0
    printed = capsys.readouterr().out
    assert printed.count("bodies.only_a") == printed.count("bodies.only_b") == 3
    assert "bodies.only_a.motion" not in printed


@pytest.mark.slow
def test_different_nets_are_compared_by_keys_and_metrics(file, tmp_path, monkeypatch, capsys):
    other = exunet.run(exunet.load(CASE, [*SHORT, "net.mesh=0.5"]))
    exunet.save(other, tmp_path / "other.h5")
    assert run(monkeypatch, "compare", file, tmp_path / "other.h5") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "net.mesh: 1.0 -> 0.5" in printed
    assert "not the same net: 40 nodes" in printed


def test_a_quaternion_and_its_negative_are_the_same_attitude():
    one = np.array([[0.6, 0.8, 0.0, 0.0]])
    still = np.zeros((1, 3))
    at = np.array([0])
    bodies = [{"target": BodyStates(1.0, np.eye(3), still, still, q, still)} for q in (one, -one)]
    assert compare_bodies(*bodies, (at, at), np.zeros(1), (1.0, 1.0)).both["target"].attitude == 0.0
