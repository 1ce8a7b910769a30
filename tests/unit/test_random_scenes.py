"""Random scenes: each ends in a sound result or a typed refusal. What failed once is in cases/hard/found."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from random_scenes import Ended, document, judge, judge_capture, judge_scene, within_time
from scenes import CASES

import exunet
from exunet.results.measures import energy_balance

FOUND = CASES / "hard" / "found"
# Sets of effects whose kernels other tests compile too.
COMMON_EFFECTS: tuple[set[str], ...] = (set(), {"effects.rayleigh_damping"}, {"effects.gravity"})


def checked(ended: dict[int, Ended]) -> Counter[str]:
    """Fail for scenes that are wrong; how many ended in which way."""
    assert {seed: item for seed, item in ended.items() if item.fault} == {}
    return Counter(item.end for item in ended.values())


def judged(judge: Callable[[int, Path], Ended], seeds: range) -> dict[int, Ended]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return dict(zip(seeds, pool.map(partial(within_time, judge), seeds, chunksize=10), strict=True))


@pytest.mark.slow
def test_forty_random_scenes():
    seeds = [s for s in range(150) if {n for n in document(s) if "effects" in n} in COMMON_EFFECTS][:40]
    ends = checked({seed: within_time(judge_scene, seed) for seed in seeds})
    assert ends.total() == 40
    assert ends["sound"] >= 15  # else the scenes try nothing
    assert ends["stopped"] >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "sound", "others"), [(range(150, 300), 70, 1), (range(2000), 1000, 100)], ids=["150", "2000"]
)
def test_random_scenes(seeds, sound, others):
    """Half of them are sound, a twentieth stop, a twentieth are refused: else an end is hardly tried."""
    ends = checked(judged(judge_scene, seeds))
    assert ends["sound"] >= sound
    assert min(ends["stopped"], ends["refused"]) >= others


@pytest.mark.ci_for("100")
@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(2000, 2100), range(2000)], ids=len)
def test_random_captures(seeds):
    """In half of them something touches, in a third of them with friction."""
    pytest.importorskip("trimesh")  # for targets that are meshes
    ended = judged(judge_capture, seeds)
    assert checked(ended)["sound"] >= 0.8 * len(seeds)
    assert sum(item.touched for item in ended.values()) >= len(seeds) / 2
    assert sum(item.rubbed for item in ended.values()) >= len(seeds) // 3


@pytest.mark.slow_for("all_dissipated", "jump_far_ahead", "at_rest_in_orbit")
@pytest.mark.parametrize("path", sorted(FOUND.glob("*.toml")), ids=lambda path: path.stem)
def test_what_failed_once(path, tmp_path):
    ended, _ = judge(path.read_text(encoding="utf-8"), tmp_path)
    assert ended == Ended("sound")


def test_the_round_off_of_a_potential_is_no_energy_error():
    assert energy_balance(exunet.run(exunet.load(FOUND / "at_rest_in_orbit.toml"))) == 0.0
