"""A case as an environment of Gymnasium: its own checks, observations, seeds, ends of episodes, arguments."""

from __future__ import annotations

import copy
import pickle
import sys
import warnings
from typing import Any

import numpy as np
import pytest
from scenes import CASES

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.kernels.compile import KERNELS
from exunet.studies import environment as module

SNAP = CASES / "bodies" / "snap.toml"
# As in examples/controller.py and reinforcement.py, which so share the compiled code.
CHANGES = ["engine.backend=compiled", "effects.material_damping.relaxation_time=1e-3"]
OBSERVED = [
    "time",
    "position/chaser",
    "velocity/target",
    "attitude/target",
    "angular_velocity/chaser",
    "position/3",
    "velocity/5",
    "tension/tether tow",
]
MOST = np.array([50.0, 50.0, 50.0, 5.0, 5.0, 5.0])


def made(**given: Any) -> exunet.NetEnvironment:
    pytest.importorskip("gymnasium")
    usual = {"actions": {"wrench/chaser": (-MOST, MOST)}, "observations": OBSERVED, "period": 0.1}
    return exunet.NetEnvironment(SNAP, CHANGES, **(usual | given))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"actions": {"wrench/tow": (-1.0, 1.0)}}, "tow"),
        ({"actions": {"motor": (-1.0, 1.0)}}, "actions: .*'motor'"),
        ({"actions": {"wrench/chaser": (1.0, 1.0)}}, "actions: wrench/chaser"),
        ({"actions": {"wrench/chaser": (-1.0, np.inf)}}, "actions: wrench/chaser"),
        ({"actions": {"wrench/chaser": 1.0}}, "actions: wrench/chaser"),
        ({"actions": {"wrench/chaser": (-MOST[:3], MOST[:3])}}, "actions: wrench/chaser"),
        ({"actions": {}}, "actions"),
        ({"actions": ["wrench/chaser"]}, "actions"),
        ({"observations": []}, "observations"),
        ({"observations": "time"}, "observations"),
        ({"observations": ["position/6"]}, r"'position/6': .*\(0 to 5\)"),
        ({"observations": ["attitude/3"]}, "'attitude/3'"),
        ({"observations": ["tension/tow"]}, "'tension/tow'"),
        ({"period": 1e-20}, "period"),
        ({"period": 0.0}, "period"),
        ({"end": np.nan}, "end"),
        ({"moved": -1.0}, "moved"),
    ],
)
def test_invalid_arguments(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        made(**given)


def test_it_requires_gymnasium(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("gymnasium")
    arguments: dict[str, Any] = {"actions": {}, "observations": ["time"], "period": 0.1}
    monkeypatch.setattr(module, "Box", None)
    with pytest.raises(MissingExtra, match="gym"):
        exunet.NetEnvironment(SNAP, CHANGES, **arguments)


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 1e-3])
def test_the_checks_of_gymnasium_pass(moved: float) -> None:
    environment = made(moved=moved)
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # bounds that are not [-1, 1], observations without bounds
        check_env(environment)


@pytest.mark.ci
@pytest.mark.slow
def test_observations_are_the_states_of_the_simulation() -> None:
    environment = made(end=1.0)
    seen, info = environment.reset()
    for step in range(11):
        simulation = environment.simulation
        net, bodies = simulation.net, simulation.bodies
        expected = [
            [simulation.time],
            bodies["chaser"].position,
            bodies["target"].velocity,
            bodies["target"].attitude,
            bodies["chaser"].angular_velocity,
            net.position[3],
            net.velocity[5],
            [net.tension[simulation.start.net.tether_elements["tow"]].max()],
        ]
        np.testing.assert_array_equal(seen, np.concatenate(expected))
        assert info == {}
        if step == 10:
            break
        kept = seen.copy()
        action = environment.action_space.high * (-1.0) ** step
        after, reward, terminated, truncated, info = environment.step(action)
        np.testing.assert_array_equal(seen, kept)  # a later step leaves it unchanged
        assert reward == -1.0  # all of the bounds are used
        assert (terminated, truncated) == (False, step == 9)
        seen = after
    assert seen[-1] > 100.0  # in the snap
    with pytest.raises(InputError, match="reset"):
        environment.step(np.zeros(6))
    environment.reset()
    for action in (np.full(6, np.nan), np.zeros(3)):
        with pytest.raises(InputError, match="6 finite numbers"):
            environment.step(action)


@pytest.mark.slow
def test_an_episode_of_three_periods_has_three_steps() -> None:
    """3 x 0.7 s is 1 unit of the last place before 2.1 s."""
    environment = made(period=0.7, end=2.1)
    environment.reset()
    assert [environment.step(np.zeros(6))[3] for _ in range(3)] == [False, False, True]


@pytest.mark.slow
def test_seeds_repeat_and_resets_build_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    environment = made(moved=1e-3)
    rest, _ = made().reset()
    environment.reset()
    for name in ("start_of", "with_wrenches"):  # the case is neither read nor prepared again
        monkeypatch.setattr(module, name, None)

    def kernels() -> set[str]:
        return {name for name in sys.modules if name.startswith(KERNELS)}

    def way(seed: int | None) -> list[np.ndarray]:
        start, _ = environment.reset(seed=seed)
        agent = np.random.default_rng(5)
        return [start, *(environment.step(agent.uniform(-MOST, MOST))[0] for _ in range(8))]

    before = kernels()
    one, onward, other, again, again_onward = way(1), way(None), way(2), way(1), way(None)
    np.testing.assert_array_equal(one, again)
    np.testing.assert_array_equal(onward, again_onward)
    assert not np.array_equal(one, other)
    assert not np.array_equal(one, onward)
    for start in (one[0], other[0], onward[0]):
        assert 0.0 < np.abs(start - rest)[1:4].max() <= 1e-3  # the position of the chaser
    assert kernels() == before


@pytest.mark.ci
@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 1e-3])
def test_pickled_and_copied_environments_continue_to_the_last_bit(moved: float) -> None:
    """Within an episode, through the snap, and in the next episode with its drawn start."""
    environment = made(moved=moved)
    environment.reset(seed=1)
    environment.step(MOST)
    every = [environment, copy.deepcopy(environment), pickle.loads(pickle.dumps(environment))]
    agent = np.random.default_rng(5)
    for action in agent.uniform(-MOST, MOST, size=(8, 6)):
        seen = [item.step(action)[:2] for item in every]
        for observation, reward in seen[1:]:
            np.testing.assert_array_equal(observation, seen[0][0])
            assert reward == seen[0][1]
    starts = [item.reset()[0] for item in every]
    np.testing.assert_array_equal(starts, [starts[0]] * 3)


@pytest.mark.slow
def test_an_episode_continues_from_a_snapshot_and_ends_early() -> None:
    environment = made(
        over=lambda simulation, seen: bool(seen[-1] > 100.0),
        reward=lambda simulation, seen, action: float(seen[0] + action[0]),
    )
    environment.reset(seed=0)
    for _ in range(4):
        environment.step(np.zeros(6))
    here = environment.simulation.snapshot()
    ends = []
    for _ in range(2):
        environment.simulation.restore(here)
        ended, steps = False, 0
        while not ended:
            seen, reward, ended, truncated, _ = environment.step(2.0 * MOST)
            assert reward == seen[0] + MOST[0]  # cut to the bounds
            steps += 1
        assert not truncated
        with pytest.raises(InputError, match="reset"):
            environment.step(np.zeros(6))
        ends.append((steps, *seen))
    assert ends[0] == ends[1]


@pytest.mark.slow
def test_a_step_that_a_guard_stops_truncates_the_episode() -> None:
    """1e6 N on 100 kg for 0.1 s go 50 m, the tether has 8 m."""
    environment = made(actions={"wrench/chaser": (-1e6, 1e6)})
    environment.reset()
    seen, _, terminated, truncated, info = environment.step([0.0, 0.0, -1e6, 0.0, 0.0, 0.0])
    assert "diverged" in info["stopped"]
    assert (terminated, truncated) == (False, True)
    assert np.isfinite(seen).all()
    assert seen[0] == environment.simulation.time < 0.1
    with pytest.raises(InputError, match="reset"):
        environment.step(np.zeros(6))
    assert environment.reset()[0][0] == 0.0
    assert environment.step(np.zeros(6))[0][0] == 0.1


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 1e-6])
def test_a_controller_stays_at_a_reset(moved: float) -> None:
    """Five periods in one of the environment; restored at the next reset."""

    class Counts:
        period, acted = 0.02, 0

        def act(self, simulation: Any) -> None:
            self.acted += 1

        def state(self) -> dict[str, Any]:
            return {"acted": self.acted}

        def restore(self, state: Any) -> None:
            self.acted = int(state["acted"])

    environment, counts = made(moved=moved), Counts()
    environment.simulation.attach(counts)
    for seed in (1, 2):
        environment.reset(seed=seed)
        environment.step(np.zeros(6))
        assert counts.acted == 5
