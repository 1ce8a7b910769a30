"""A case as an environment: Gymnasium's own checks, read-outs, seeds, ends of episodes, wrong arguments."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.kernels.compile import KERNELS
from exunet.studies import environment as module

SNAP = Path(__file__).parent.parent / "cases" / "bodies" / "snap.toml"
# As in examples/controller.py and reinforcement.py, which so share the compiled code.
CHANGES = ["engine.backend=compiled", "effects.material_damping.relaxation_time=1e-3"]
SEEN = [
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
    usual = {"actions": {"wrench/chaser": (-MOST, MOST)}, "observations": SEEN, "period": 0.1}
    return exunet.NetEnvironment(SNAP, CHANGES, **(usual | given))


def kernels() -> set[str]:
    return {name for name in sys.modules if name.startswith(KERNELS)}


def test_it_needs_gymnasium(monkeypatch):
    monkeypatch.setattr(module, "Box", None)
    with pytest.raises(MissingExtra, match=r"pip install 'exunet\[gym\]'"):
        exunet.NetEnvironment(SNAP, CHANGES, actions={}, observations=[], period=0.1)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"actions": {"wrench/tow": (-1.0, 1.0)}}, "not a free body .free bodies: chaser, target"),
        ({"actions": {"motor": (-1.0, 1.0)}}, "there is no input 'motor'"),
        ({"actions": {"wrench/chaser": (1.0, 1.0)}}, "the least below the largest"),
        ({"actions": {"wrench/chaser": (-1.0, np.inf)}}, "a finite number or 6 of them"),
        ({"actions": {"wrench/chaser": 1.0}}, "a pair of least and largest values"),
        ({"actions": {"wrench/chaser": (-MOST[:3], MOST[:3])}}, "or 6 of them"),
        ({"actions": {}}, "at least one input"),
        ({"observations": []}, "at least one, such as 'time'"),
        ({"observations": ["position/6"]}, r"no 'position/6': .* nodes \(0 to 5\)"),
        ({"observations": ["attitude/3"]}, "attitude/ and angular_velocity/ with chaser, target"),
        ({"observations": ["tension/tow"]}, "tension/ with net, tether tow"),
        ({"actions": None}, "actions: bounds by the name of each input, got None"),
        ({"actions": ["wrench/chaser"]}, "actions: bounds by the name of each input"),
        ({"observations": "time"}, "observations: a list of names, got 'time'"),
        ({"period": 1e-20}, "period: 1e-09 s or more, got 1e-20"),
        ({"period": 0.0}, "period: a finite number above 0, got 0.0"),
        ({"end": np.nan}, "end: a finite number above 0"),
        ({"moved": -1.0}, "moved: a finite number, 0 or more"),
    ],
)
def test_wrong_arguments_are_told(given, words):
    with pytest.raises(InputError, match=words):
        made(**given)


def test_only_the_compiled_loop():
    pytest.importorskip("gymnasium")
    with pytest.raises(InputError, match=r'engine\.backend = "compiled"'):
        exunet.NetEnvironment(SNAP, actions={}, observations=["time"], period=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 1e-3])
def test_gymnasium_finds_nothing_wrong(moved):
    environment = made(moved=moved)
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # bounds that are not [-1, 1], observations without bounds
        check_env(environment)


@pytest.mark.ci
@pytest.mark.slow
def test_what_is_seen_is_what_the_simulation_has():
    environment = made(end=1.0)
    seen, info = environment.reset()
    steps = 0
    while True:
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
        if steps == 10:
            break
        kept = seen.copy()
        action = environment.action_space.high * (-1.0) ** steps
        after, reward, terminated, truncated, info = environment.step(action)
        np.testing.assert_array_equal(seen, kept)  # a later step leaves it as it is
        assert reward == -1.0  # all of the bounds are used
        assert not terminated
        assert truncated == (steps == 9)
        seen, steps = after, steps + 1
    assert seen[-1] > 100.0  # in the snap
    with pytest.raises(InputError, match="the episode is over at t = 1 s: call reset"):
        environment.step(np.zeros(6))
    environment.reset()
    with pytest.raises(InputError, match="6 finite numbers"):
        environment.step(np.full(6, np.nan))
    with pytest.raises(InputError, match="6 finite numbers"):
        environment.step(np.zeros(3))


@pytest.mark.slow
def test_seeds_repeat_and_resets_build_nothing(monkeypatch):
    environment = made(moved=1e-3)
    rest, _ = made().reset()
    environment.reset()
    for name in ("start_of", "with_wrenches"):  # the case is neither read nor prepared again
        monkeypatch.setattr(module, name, None)
    before = kernels()

    def way(seed: int | None) -> list[np.ndarray]:
        start, _ = environment.reset(seed=seed)
        agent = np.random.default_rng(5)
        return [start, *(environment.step(agent.uniform(-MOST, MOST))[0] for _ in range(8))]

    one, onward, other, again, again_onward = way(1), way(None), way(2), way(1), way(None)
    np.testing.assert_array_equal(one, again)
    np.testing.assert_array_equal(onward, again_onward)
    assert not np.array_equal(one, other)
    assert not np.array_equal(one, onward)
    for start in (one[0], other[0], onward[0]):
        assert 0.0 < np.abs(start - rest)[1:4].max() <= 1e-3  # the place of the chaser
    assert kernels() == before


@pytest.mark.slow
def test_an_episode_can_be_set_back_by_a_snapshot_and_end_early():
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
        with pytest.raises(InputError, match=r"the episode is over at t = .* s: call reset"):
            environment.step(np.zeros(6))
        ends.append((steps, *seen))
    assert ends[0] == ends[1]


@pytest.mark.slow
def test_a_step_that_a_guard_stops_truncates_the_episode():
    """1e6 N on 100 kg for 0.1 s go 50 m, the tether has 8 m."""
    environment = made(actions={"wrench/chaser": (-1e6, 1e6)})
    environment.reset()
    seen, _, terminated, truncated, info = environment.step([0.0, 0.0, -1e6, 0.0, 0.0, 0.0])
    assert "diverged at t = " in info["stopped"]
    assert truncated
    assert not terminated
    assert np.isfinite(seen).all()
    assert seen[0] == environment.simulation.time < 0.1
    with pytest.raises(InputError, match="the episode is over"):
        environment.step(np.zeros(6))
    assert environment.reset()[0][0] == 0.0
    assert environment.step(np.zeros(6))[0][0] == 0.1


class Counts:
    """A controller that counts how often it has acted."""

    period = 0.01

    def __init__(self) -> None:
        self.acted = 0

    def act(self, simulation: Any) -> None:
        self.acted += 1

    def state(self) -> dict[str, Any]:
        return {"acted": self.acted}

    def restore(self, state: Any) -> None:
        self.acted = int(state["acted"])


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 1e-6])
def test_a_controller_stays_at_a_reset(moved: float) -> None:
    """Five periods in one of the environment; set back at the next reset."""
    case = Path(__file__).parents[1] / "cases/bodies/snap.toml"
    actions = {"wrench/chaser": (-20.0, 20.0)}
    env = exunet.NetEnvironment(
        case, ["engine.backend=compiled"], actions=actions, observations=["time"], period=0.05, moved=moved
    )
    counts = Counts()
    env.simulation.attach(counts)
    for seed in (1, 2):
        env.reset(seed=seed)
        env.step(np.zeros(6))
        assert counts.acted == 5
