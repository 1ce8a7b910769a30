"""Dimension lines of a flat net: its width (and height), and the length of one mesh side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Annotation
from numpy.typing import NDArray

from exunet.figures.style import number
from exunet.figures.views import net_size
from exunet.net.arrays import Net

Floats = NDArray[np.float64]
GREY = "0.25"


@dataclass(frozen=True)
class Dimension:
    """A double arrow parallel to start-end, moved by `offset`; all (2,) [m] in the x-y plane."""

    start: Floats
    end: Floats
    offset: Floats
    text: str


def dimensions(net: Net, away: float) -> list[Dimension]:
    """Width below the net, one mesh side above it and, for rectangular cells, the height if that differs.

    They are so far `away` from the net [m], that of the mesh side a little less.

    Empty for a net without openings and for one that does not lie in a plane z = constant.
    """
    points, height = net.reference_position[:, :2], net.reference_position[: net.n_net_nodes, 2]
    if not any(len(face) > 2 for face in net.faces) or np.ptp(height) > 0.0:
        return []
    sides = net.element_nodes[: net.n_net_elements][~net.is_string[: net.n_net_elements]]
    woven = points[np.unique(sides)]
    low, high = woven.min(axis=0), woven.max(axis=0)
    knots = _top_face(net, points)
    corners = points[knots]
    rectangular = _is_rectangle(corners)
    same = bool(np.isclose(high[0] - low[0], high[1] - low[1], rtol=1e-9))
    names = ("", "", "")
    if rectangular:
        names = ("$L$ = ", "", "$\\ell$ = ") if same else ("$L_x$ = ", "$L_y$ = ", "")
    below, left = (_clear(points, low, high, axis) + away for axis in (1, 0))
    found = [_dimension(low, np.array([high[0], low[1]]), np.array([0.0, -below]), names[0])]
    if rectangular and not same:
        found.append(_dimension(low, np.array([low[0], high[1]]), np.array([-left, 0.0]), names[1]))
    a, b = points[_top_side(net, knots)]
    outward = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
    outward *= np.sign(outward @ (a + b - 2 * corners.mean(axis=0))) or 1.0
    return [*found, _dimension(a, b, 0.7 * away * outward, names[2])]


def _dimension(start: Floats, end: Floats, offset: Floats, name: str) -> Dimension:
    return Dimension(start, end, offset, f"{name}{number(float(np.linalg.norm(end - start)))} m")


def _clear(points: Floats, low: Floats, high: Floats, axis: int) -> float:
    """How far strings reach beyond the net's low side along `axis`, where a dimension would stand."""
    across = points[:, 1 - axis]
    beside = (across >= low[1 - axis]) & (across <= high[1 - axis])
    return float(low[axis] - points[beside, axis].min())


def _top_face(net: Net, points: Floats) -> NDArray[np.int64]:
    """Nodes (n,) at the corners of the opening that reaches highest, of several the middle one."""
    faces = [np.array(face) for face in net.faces if len(face) > 2]
    tops = np.array([points[face, 1].max() for face in faces])
    offs = np.array([abs(points[face, 0].mean() - points[:, 0].mean()) for face in faces])
    highest = np.flatnonzero(tops >= tops.max() - 1e-9 * net_size(net))
    nodes = faces[highest[np.argmin(offs[highest])]]
    loop = points[nodes]
    back, ahead = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    turn = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0]
    bent = np.abs(turn) > 1e-9 * np.linalg.norm(back, axis=1) * np.linalg.norm(ahead, axis=1)
    return nodes[bent] if bent.sum() > 2 else nodes


def _is_rectangle(corners: Floats) -> bool:
    sides = np.roll(corners, -1, axis=0) - corners
    return len(corners) == 4 and bool(np.all(np.min(np.abs(sides), axis=1) < 1e-9 * np.abs(sides).max()))


def _top_side(net: Net, knots: NDArray[np.int64]) -> NDArray[np.int64]:
    """Nodes (2,) of the highest side of a face, of those on the net's edge: beyond them is room for words."""
    sides = np.column_stack([knots, np.roll(knots, -1)])
    inside = np.array([sum({*side} <= {*face} for face in net.faces) > 1 for side in sides.tolist()])
    height = net.reference_position[sides, 1].sum(axis=1)
    return np.asarray(sides[np.argmax(height if inside.all() else np.where(inside, -np.inf, height))])


def draw_dimension(axes: Axes, shown: Dimension) -> Annotation:
    """The arrow with its extension lines, and the length beside it, which is returned."""
    a, b = shown.start + shown.offset, shown.end + shown.offset
    unit = shown.offset / np.linalg.norm(shown.offset)
    arrow = {"arrowstyle": "<|-|>", "color": GREY, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tuple(a), tuple(b), arrowprops=arrow)
    gap = np.linalg.norm(shown.end - shown.start) * 0.02 * unit
    for at in (shown.start, shown.end):
        axes.plot(*np.array([at + gap, at + 1.03 * shown.offset]).T, color=GREY, linewidth=0.6)
    return axes.annotate(
        shown.text,
        tuple((a + b) / 2),
        xytext=tuple(9 * unit),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=8,
        rotation=_upright(b - a),
        rotation_mode="anchor",
        color=GREY,
    )


def _upright(along: Floats) -> float:
    """Angle of a line in degrees, turned so that text along it does not stand on its head."""
    angle = float(np.degrees(np.arctan2(along[1], along[0])))
    return (angle + 90) % 180 - 90 if abs(abs(angle) - 90) > 1e-6 else 90.0
