"""Whole runs: the paper's net up to its first snap, scenes with an empty set, random scenes and captures."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from commands import command
from random_scenes import Ended, document, judge, judge_capture, judge_scene, within_time
from scenes import CASES

import exunet
from exunet.integrators.exudyn.build import expected_items
from exunet.results.ensemble import load_ensemble
from exunet.results.io import load_result
from exunet.results.measures import bullet_speeds, energy_balance
from exunet.results.summary import summarise
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import run_into

# The paper's net


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_case_flies_until_its_strings_snap(path):
    """Bullets leave at 2.5 m/s along the diagonals; the strings of sqrt(2) m, packed to a part p of that, are
    taut when they have gone sqrt(2) (1 - p) m. Without damping they fly freely, and the net lies still.

    Eq. (13) damps with alpha, and along the slack strings too, with up to beta EA / (L m) = 0.0124 / s: it
    slows the bullets and drags the light corners after them, so the strings snap later. It stops a launch, a
    packing, a damping or stored times that are not those of the case.
    """
    case = exunet.load(path, ["time.end=0.6", "time.output_step=0.05"])
    run = exunet.run(case)
    assert run.complete
    assert run.time == pytest.approx(0.05 * np.arange(13), abs=1e-12)
    snap = math.sqrt(2.0) * (1.0 - case.scene.initial.packing) / 2.5
    before = run.time < snap
    assert before.sum() == 11  # 0.50912 s and 0.53174 s, by packing
    assert not run.tension[before].any()

    damping = case.scene.effects.rayleigh_damping
    alpha, beta = (damping.alpha, damping.beta) if damping else (0.0, 0.0)
    rate = beta * 70e9 * math.pi / 4 * 0.004**2 / math.sqrt(2.0) / 0.5
    speeds = bullet_speeds(run)[before].T
    assert np.all(speeds <= 2.5 * np.exp(-alpha * run.time[before]) + 1e-9)
    assert np.all(speeds >= 2.5 * np.exp(-(alpha + rate) * run.time[before]) - 1e-9)
    knots = np.setdiff1d(np.arange(run.net.n_nodes), run.net.bullet_nodes)
    if not damping:
        assert np.abs(run.position[before][:, knots] - run.position[0, knots]).max() < 1e-12
    else:
        assert speeds[0, -1] < 2.5 * np.exp(-alpha * 0.5) - 1e-4

    peak = run.provenance["largest_tension"]
    assert run.net.is_string[peak["element"]]
    assert snap < peak["time_s"] < (0.6 if damping else snap + 5e-4)  # the snap lasts half a millisecond
    assert np.abs(run.velocity[-1, knots]).max() > 1.0  # 6 g a knot take much of a snap of 0.5 kg at 2.5 m/s
    assert energy_balance(run) < 1e-5
    assert np.abs(run.momentum).max() < 1e-9  # four bullets that mirror each other


# Scenes with an empty set: no element, no free node


FAULTS = Path(__file__).parents[1] / "data" / "faults"
ONE_ELEMENT = (
    "net.nodes=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]",
    "net.elements=[[0, 1]]",
    "net.node_masses=[0.1, 0.1]",
)
NO_ELEMENT = "no_elements.toml"


@pytest.mark.parametrize("backend", ["exudyn", "compiled"])
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (NO_ELEMENT, ()),
        (NO_ELEMENT, ONE_ELEMENT),
        ("all_fixed.toml", ()),
        ("tether_between_prescribed.toml", ()),
        ("thread_between_prescribed.toml", ()),
        ("slack_or_taut.toml", ()),
        ("self_contact_no_elements.toml", ()),
    ],
    ids=["no element", "one element", "all fixed", "tether", "thread", "slack or taut", "self-contact"],
)
def test_a_scene_with_an_empty_set_runs_with_checkpoints(
    tmp_path: Path, name: str, changes: tuple[str, ...], backend: str
) -> None:
    """No number of its result is NaN; a summary is made of it."""
    changes = ("time.end=0.2", "time.output_step=0.1", f"engine.backend={backend}", *changes)
    run_into(tmp_path, exunet.load(FAULTS / name, changes), checkpoint_every=0.1)
    result = load_result(tmp_path)
    assert np.isfinite(result.position).all()
    assert np.isfinite(result.kinetic + result.potential).all()
    assert summarise(result)["verdict"] == "ok"


def test_the_command_describes_a_scene_without_elements(tmp_path: Path) -> None:
    settings = ("--set", "time.end=0.2", "--set", "time.output_step=0.1", "--out", "out")
    ended = command("run", FAULTS / NO_ELEMENT, *settings, folder=tmp_path)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.ci
@pytest.mark.slow
def test_a_metric_may_be_absent_in_some_of_the_perturbed_runs(tmp_path: Path) -> None:
    """A net at the edge of slackness is taut in some runs only; a range of a tension does not go below 0."""
    ended = command("run", FAULTS / "slack_or_taut.toml", "--spread", 8, "--out", "out", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    ranges = load_ensemble(tmp_path / "out" / "ensemble.h5")
    tension = ranges.range("net_largest_tension_N")
    assert tension is not None
    assert 0 < tension.runs < tension.of_runs
    assert tension.low >= 0.0


@pytest.mark.slow
def test_a_long_fall_is_not_taken_for_a_divergence(tmp_path: Path) -> None:
    """The balance of free fall is off by round-off of the kinetic energy, 1e-10 of it after 4e6 steps."""
    case = exunet.load(FAULTS / "long_fall.toml", ["time.end=36.0", "solver.method=VelocityVerlet"])
    result = exunet.run(case)
    assert result.time[-1] == 36.0


# Against hand calculations, by Exudyn

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e9}
SPHERE = {"shape": "sphere", "radius": 0.1, "mass": 1.0}
PRESCRIBED = {
    "a": SPHERE | {"motion": "prescribed", "velocity": [0.0, 0.0, 0.1]},
    "b": SPHERE | {"motion": "prescribed", "position": [1.0, 0.0, 0.0], "velocity": [0.1, 0.0, 0.0]},
}
THREAD = {"nodes": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "elements": [[0, 1]]}


def run(net: dict[str, object], **tables: object) -> exunet.Result:
    """Run a scene; the items that Exudyn makes are those that `exunet check` reports."""
    document = {
        "format": 1,
        "title": "nothing is free",
        "time": {"end": 0.02, "output_step": 0.01},
        "engine": {"backend": "exudyn"},
        "net": {"topology": "explicit", "cable": CABLE, **net},
        "initial": {"packing": 1.0},
        "effects": {"gravity": {"acceleration": [0.0, 0.0, -9.81]}},
        **tables,
    }
    scene = Scene.model_validate(document)
    result = exunet.run(scene)
    assert result.provenance["items"] == expected_items(prepare(scene).system)
    return result


@pytest.mark.parametrize("between", ["thread", "tether"])
def test_an_element_between_prescribed_bodies(between: str) -> None:
    """From (0, 0, 0.1 t) to (1 + 0.1 t, 0, 0): by EA and the Green-Lagrange strain."""
    if between == "thread":
        ties = [{"attachments": {"x": {"point": [0.0, 0.0, 0.0], "node": node}}} for node in (0, 1)]
        tied = {name: PRESCRIBED[name] | tie for name, tie in zip("ab", ties, strict=True)}
        result = run(THREAD, bodies=tied)
    else:
        far = {"nodes": [[0.0, 30.0, 0.0]], "elements": [], "node_masses": [0.1], "fixed": [0]}
        tether = CABLE | {"length": 1.0, "start": {"body": "a"}, "end": {"body": "b"}}
        result = run(far, bodies=PRESCRIBED, tethers={"t": tether})
    squared = (1.0 + 0.1 * result.time) ** 2 + (0.1 * result.time) ** 2
    tension = 1e9 * np.pi * 1e-6 * 0.5 * (squared - 1.0) * np.sqrt(squared)
    assert result.tension[:, -1] == pytest.approx(tension, rel=1e-12)


def test_a_free_body_beside_a_net_of_fixed_nodes() -> None:
    result = run(THREAD | {"fixed": [0, 1]}, bodies={"a": SPHERE | {"position": [0.0, 3.0, 0.0]}})
    assert result.bodies["a"].position[:, 2] == pytest.approx(-0.5 * 9.81 * result.time**2, abs=1e-12)
    assert np.array_equal(result.position, np.broadcast_to(THREAD["nodes"], (3, 2, 3)))
    assert not result.tension.any()


# Random scenes: each ends in a sound result or a typed refusal; what failed once is in cases/hard/found


FOUND = CASES / "hard" / "found"
# Sets of effects whose kernels other tests compile too.
COMMON_EFFECTS: tuple[set[str], ...] = (set(), {"effects.rayleigh_damping"}, {"effects.gravity"})


def checked(ended: dict[int, Ended]) -> Counter[str]:
    """Fail for scenes that are wrong; how many ended in which way."""
    assert {seed: item for seed, item in ended.items() if item.fault} == {}
    return Counter(item.end for item in ended.values())


@pytest.mark.slow
def test_forty_random_scenes():
    seeds = [s for s in range(150) if {n for n in document(s) if "effects" in n} in COMMON_EFFECTS][:40]
    ends = checked({seed: within_time(judge_scene, seed) for seed in seeds})
    assert ends.total() == 40
    assert ends["sound"] >= 15  # else the scenes try nothing
    assert ends["stopped"] >= 3


@pytest.mark.slow
@pytest.mark.parametrize("first", range(150, 650, 100))
def test_random_scenes(first: int) -> None:
    """Some half of a hundred are sound, others stop or are refused: else an end is hardly tried."""
    ends = checked({seed: within_time(judge_scene, seed) for seed in range(first, first + 100)})
    assert ends["sound"] >= 40
    assert min(ends["stopped"], ends["refused"]) >= 1


@pytest.mark.ci_for("2000")
@pytest.mark.slow
@pytest.mark.parametrize("first", [*range(0, 400, 100), 2000])
def test_random_captures(first: int) -> None:
    """In half of a hundred something touches, in a third of them with friction."""
    pytest.importorskip("trimesh")  # for targets that are meshes
    ended = {seed: within_time(judge_capture, seed) for seed in range(first, first + 100)}
    assert checked(ended)["sound"] >= 80
    assert sum(item.touched for item in ended.values()) >= 50
    assert sum(item.rubbed for item in ended.values()) >= 33


@pytest.mark.slow_for("all_dissipated", "jump_far_ahead", "at_rest_in_orbit")
@pytest.mark.parametrize("path", sorted(FOUND.glob("*.toml")), ids=lambda path: path.stem)
def test_what_failed_once(path, tmp_path):
    ended, _ = judge(path.read_text(encoding="utf-8"), tmp_path)
    assert ended == Ended("sound")


def test_the_round_off_of_a_potential_is_no_energy_error():
    assert energy_balance(exunet.run(exunet.load(FOUND / "at_rest_in_orbit.toml"))) == 0.0
