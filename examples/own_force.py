"""A spring with friction between a body and a node of the net: python examples/own_force.py [BACKEND]"""

import math
import sys
from collections import namedtuple
from pathlib import Path
from typing import Any

import exunet as ex

CASE = str(Path(__file__).parents[1] / "cases" / "bodies" / "uneven_launch.toml")
Spring = namedtuple("Spring", "node body stiffness length friction")  # entries; [N/m], [m], [N]


def line(x: Any, v: Any, s: Any) -> Any:
    """From node to body: direction, length [m], its rate [m/s]."""
    apart, speed = (
        x[s.body : s.body + 3] - x[s.node : s.node + 3],
        v[s.body : s.body + 3] - v[s.node : s.node + 3],
    )
    length = math.sqrt((apart * apart).sum())
    return apart / length, length, (apart * speed).sum() / length


def add(t: float, x: Any, v: Any, s: Any, force: Any) -> None:
    direction, length, rate = line(x, v, s)
    pull = (s.stiffness * (length - s.length) + s.friction * math.tanh(rate / 0.1)) * direction
    force[s.node : s.node + 3] += pull
    force[s.body : s.body + 3] -= pull


def potential(x: Any, s: Any) -> Any:
    return 0.5 * s.stiffness * (line(x, x, s)[1] - s.length) ** 2


def power(t: float, x: Any, v: Any, s: Any) -> Any:
    rate = line(x, v, s)[2]
    return s.friction * math.tanh(rate / 0.1) * rate


def spring(blocks: ex.Blocks) -> list[ex.KernelTerm]:
    node = blocks.net.node("centre")
    data, inverse = Spring(3 * node, blocks.centre("chaser"), 50.0, 0.6, 0.1), 1.0 / blocks.mass[node]
    rates = {"stiffness_rate": data.stiffness * inverse, "damping_rate": data.friction / 0.1 * inverse}
    return [ex.KernelTerm("bodies", add, data, potential, (line,), bodies=("chaser",), power=power, **rates)]


def main(backend: str = "compiled", end: str = "0.2") -> ex.Result:
    """Return the result of a throw in which the net's centre is pulled towards its chaser."""
    case = ex.load(CASE, [f"engine.backend={backend}", f"time.end={end}", "solver.accuracy=1e-6"])
    return ex.run(ex.prepare(case.scene).with_forces(spring))


if __name__ == "__main__":
    result = main(*sys.argv[1:])
    taken = result.dissipated[-1] - result.dissipated[0]
    print(f"friction takes out {taken:.3g} J; energy balance {ex.energy_balance(result):.1e}")
