"""A tow as an environment for learning: python examples/reinforcement.py [EPISODES] [CASE]

The agent is to stop a target that drifts away on a slack tether, without pulling too hard. The one here
pushes the chaser at random; one that learns takes its place. Needs the extra "gym"; CASE has free bodies
"chaser" and "target" and a tether "tow".
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import exunet

GENTLE = 100.0  # N, up to which a pull costs nothing
STOPPED = 0.05  # m/s, at which an episode ends
SEEN = ["velocity/target", "tension/tether tow", "position/chaser", "velocity/chaser", "attitude/chaser"]


def reward(simulation: exunet.Simulation, seen: np.ndarray, action: np.ndarray) -> float:
    """Minus the speed of the target [m/s] and what the tension is above GENTLE, in parts of that."""
    return -float(np.linalg.norm(seen[:3]) + max(0.0, seen[3] / GENTLE - 1.0))


def has_stopped(simulation: exunet.Simulation, seen: np.ndarray) -> bool:
    return bool(np.linalg.norm(seen[:3]) < STOPPED)


CASE = str(Path(__file__).parents[1] / "cases" / "bodies" / "snap.toml")


def make(case: str = CASE) -> exunet.NetEnvironment:
    """The environment: forces and torques on the chaser 20 times a second, starts perturbed by up to 1 mm."""
    return exunet.NetEnvironment(
        case,
        ["engine.backend=compiled", "effects.material_damping.relaxation_time=1e-3"],
        actions={"wrench/chaser": (-np.array([50.0] * 3 + [10.0] * 3), [50.0] * 3 + [10.0] * 3)},
        observations=SEEN,
        period=0.05,
        reward=reward,
        over=has_stopped,
        moved=1e-3,
    )


def episode(environment: exunet.NetEnvironment, agent: np.random.Generator, seed: int) -> tuple[float, float]:
    """Sum of the rewards, and the largest tension that was seen [N]."""
    seen, _ = environment.reset(seed=seed)
    space, total, pull, ended = environment.action_space, 0.0, 0.0, False
    while not ended:
        seen, given, terminated, truncated, _ = environment.step(agent.uniform(space.low, space.high))
        total, pull, ended = total + given, max(pull, seen[3]), terminated or truncated
    return total, pull


def main(episodes: str = "5", case: str = CASE) -> list[tuple[float, float]]:
    """Prints and returns what each episode has given; episode k starts from seed k, as does its agent."""
    environment = make(case)
    found = []
    for seed in range(int(episodes)):
        total, pull = episode(environment, np.random.default_rng(seed), seed)
        end = environment.simulation.time
        print(f"episode {seed}: return {total:.3f}, largest tension {pull:.0f} N, ended at {end:.2f} s")
        found.append((total, pull))
    again = episode(environment, np.random.default_rng(0), 0)
    print(f"episode 0 again: the same to the last bit: {again == found[0]}")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:3])
