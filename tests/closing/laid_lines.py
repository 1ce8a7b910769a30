"""Lines through rings at given places, for tests of their loops; these run as Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from exunet.forces import closing
from exunet.forces.blocks import Blocks
from exunet.forces.closing import Drawstring, states_of, way_of
from exunet.net.arrays import Net
from exunet.net.closing import ClosingLine

Floats = np.ndarray

RING = 0.01


def line(places: Floats, **given: Any) -> tuple[closing.Line, Blocks]:
    """A line from the first of some places through rings at the others to the last; EA = 500 N."""
    n = len(places)
    none, nothing = np.zeros(0), np.zeros(0, dtype=np.int64)
    ends = np.zeros((0, 2), dtype=np.int64)
    net = Net(places, np.ones(n), ends, none, none, none, none, none.astype(bool), nothing, nothing)
    numbers: dict[str, Any] = {"path": tuple(range(n)), "length": 2.0, "stiffness": 500.0, "friction": 0.0}
    numbers |= {"linear_density": 0.0, "ring_diameter": RING}
    numbers |= {"shortest": 0.5, "largest_rate": 5.0, "has_winch": True}
    time, ratio = given.pop("time", 0.0), given.pop("ratio", 1.0)
    drawn = ClosingLine(**(numbers | given))
    blocks = Blocks.of(net, places, (), (), states_of(drawn, places, ratio, time))
    string = Drawstring(drawn, blocks, ratio, time)
    return string.data(string.at_start), blocks


ZIGZAG = np.array([[0.0, 0.0, 0.0], [0.7, 0.4, 0.1], [0.9, -0.5, 0.2], [1.6, 0.1, -0.2], [2.0, 0.6, 0.3]])


def flat(places: Floats, *states: float) -> Floats:
    return np.concatenate([places.ravel(), states])


def turns(places: Floats) -> Floats:
    """Angles [rad] by which a polygon turns at its inner corners."""
    ways = np.diff(places, axis=0)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.arccos(np.einsum("ka,ka->k", ways[1:], ways[:-1]))


def slid(places: Floats, wound: float, friction: float, **given: Any) -> closing.Line:
    """A line of one tension, none unless stretched, from which a length was wound up at its start."""
    length = float(way_of(line_of(len(places)), places).sum()) / given.pop("stretched", 1.0)
    data, _ = line(places, length=length, friction=friction, **given)
    closing.settle_line(flat(places, wound, 0.0, 0.0, 0.0), data)
    return data


def line_of(n: int) -> ClosingLine:
    return ClosingLine(tuple(range(n)), 1.0, 1.0, 0.0, RING, 0.0)
