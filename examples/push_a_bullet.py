"""Step a simulation and push one bullet: python examples/push_a_bullet.py [CASE]

A force of 1 N along the launch acts on the first bullet for 0.1 s. The interval is then repeated without it,
from a snapshot.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import exunet

CASE = str(Path(__file__).parents[1] / "cases" / "planar_deployment.toml")


def main(case: str = CASE) -> float:
    """Print and return the displacement of the bullet by the push [m]."""
    simulation = exunet.Simulation(case, ["engine.backend=compiled"])
    bullet = simulation.net.bullets[0]
    simulation.advance(0.05)
    here = simulation.snapshot()

    simulation.set_force(bullet, [0.0, 0.0, 1.0])  # newtons, until another is set
    simulation.advance(0.1)
    simulation.set_force(bullet, [0.0, 0.0, 0.0])
    simulation.advance(0.05)
    pushed = simulation.net.position[bullet]

    simulation.restore(here)
    simulation.advance(0.1)
    simulation.advance(0.05)
    moved = float(np.linalg.norm(pushed - simulation.net.position[bullet]))
    print(f"at {simulation.time:.2f} s the push has moved node {bullet} by {1e3 * moved:.2f} mm")
    return moved


if __name__ == "__main__":
    main(*sys.argv[1:])
