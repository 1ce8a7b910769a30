"""Random scenes: each ends in a sound result or a typed refusal. What failed once is in cases/hard/found."""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from fuzz_captures import Ended, judge_capture
from fuzz_scenes import document, judge, judge_case

import exunet
from exunet.results.measures import energy_balance

FOUND = Path(__file__).parent.parent / "cases" / "hard" / "found"
SCENES = 2000
MOST = 60.0  # [s] of processor time a scene; the slowest takes 15
# Sets of effects whose kernels other quick tests compile too.
QUICK_EFFECTS: tuple[set[str], ...] = (set(), {"effects.rayleigh_damping"}, {"effects.gravity"})
QUICK = [s for s in range(150) if {n for n in document(s) if "effects" in n} in QUICK_EFFECTS][:40]


class TooLong(BaseException):
    """A scene that does not end; no `except Exception` of the program swallows it."""


def bounded(seed: int) -> tuple[int, str, str]:
    """Seed, how the scene ended, what is wrong; within bounded time, and whatever is raised."""
    end, fault, *_ = within_time(judge, seed)
    return seed, end, fault


def bounded_capture(seed: int) -> tuple[int, Ended]:
    """The same of a capture, with whether anything touched and rubbed."""
    found = within_time(judge_capture, seed)
    return seed, found if isinstance(found, Ended) else Ended(*found, touched=False, rubbed=False)


def within_time(judged: Callable[[int, Path], Any], seed: int) -> Any:
    """What is found of a scene: how it ended, what is wrong, and what else `judged` tells."""

    def give_up(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, MOST)  # whatever else the machine has to do
    try:
        with TemporaryDirectory() as folder:
            return judged(seed, Path(folder))
    except TooLong:
        return "hang", f"does not end within {MOST:g} s"
    except Exception:  # noqa: BLE001 - anything that is raised here is a finding
        return "raised", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def tell(findings: list[tuple[int, str, str]]) -> Counter[str]:
    wrong = [f"seed {seed}, {end}: {fault}" for seed, end, fault in findings if fault]
    assert wrong == []
    return Counter(end for _, end, _ in findings)


def run(seeds: range) -> Counter[str]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return tell(list(pool.map(bounded, seeds, chunksize=10)))


def test_the_same_seed_is_the_same_scene():
    assert document(7) == document(7)
    assert document(7) != document(8)


@pytest.mark.slow
def test_forty_random_scenes():
    ends = tell([bounded(seed) for seed in QUICK])
    assert ends.total() == 40
    assert ends["sound"] >= 15  # else the scenes try nothing
    assert ends["stopped"] >= 3


@pytest.mark.slow
def test_random_scenes_for_ci():
    assert run(range(150, 300))["sound"] >= 70


@pytest.mark.slow
def test_two_thousand_random_scenes():
    ends = run(range(SCENES))
    # Else one of the ends is hardly tried: a half, a twentieth, a twentieth of the scenes.
    assert ends["sound"] >= SCENES // 2
    assert ends["stopped"] >= SCENES // 20
    assert ends["refused"] >= SCENES // 20


def run_captures(seeds: range) -> tuple[Counter[str], int, int]:
    """How many ended in which way, in how many something touched, and rubbed."""
    pytest.importorskip("trimesh")  # for targets that are meshes
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        every = list(pool.map(bounded_capture, seeds, chunksize=10))
    ends = tell([(seed, found.end, found.fault) for seed, found in every])
    return ends, sum(found.touched for _, found in every), sum(found.rubbed for _, found in every)


@pytest.mark.ci
@pytest.mark.slow
def test_random_captures_for_ci():
    ends, touched, rubbed = run_captures(range(SCENES, SCENES + 100))
    assert ends["sound"] >= 80
    assert (touched >= 50, rubbed >= 33) == (True, True), (touched, rubbed)


@pytest.mark.slow
def test_two_thousand_random_captures():
    ends, touched, rubbed = run_captures(range(SCENES))
    assert ends["sound"] >= SCENES * 8 // 10
    assert (touched >= SCENES // 2, rubbed >= SCENES // 3) == (True, True), (touched, rubbed)


@pytest.mark.ci_for("all_dissipated")
@pytest.mark.slow_for("all_dissipated", "jump_far_ahead", "at_rest_in_orbit")
@pytest.mark.parametrize("path", sorted(FOUND.glob("*.toml")), ids=lambda path: path.stem)
def test_what_failed_once(path, tmp_path):
    end, fault = judge_case(path.read_text(encoding="utf-8"), tmp_path)
    assert (end, fault) == ("sound", "")


def test_the_round_off_of_a_potential_is_no_energy_error():
    assert energy_balance(exunet.run(exunet.load(FOUND / "at_rest_in_orbit.toml"))) == 0.0
