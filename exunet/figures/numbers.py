"""Numbers at nodes of a net, where they touch nothing."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from numpy.typing import NDArray

from exunet.figures.dimensions import Dimension
from exunet.figures.style import BLACK, SMALL
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

MOST_LABELS = 24


def number_nodes(
    axes: Axes, net: Net, plane: tuple[int, int], arrows: list[Dimension], words: list[Annotation]
) -> None:
    """Numbers at the bullets and corners, clear of the cables; at all nodes of small nets without any.

    A node whose number would touch another one, one of the `arrows` and `words` that are there, or the frame
    goes without.
    """
    labelled = list(dict.fromkeys([*net.bullet_nodes.tolist(), *net.mouth]))
    if not labelled and net.n_nodes <= MOST_LABELS:
        labelled = list(range(net.n_nodes))
    points = net.reference_position[:, plane]
    bullets = set(net.bullet_nodes.tolist())
    figure = axes.get_figure(root=True)
    assert figure is not None
    to_points = 72.0 / figure.dpi
    placed = [one for text in words for one in _characters(text, to_points)]
    for arrow in arrows:
        ends = np.array([arrow.start + arrow.offset, arrow.end + arrow.offset])
        start, end = axes.transData.transform(ends) * to_points
        count = 2 + int(np.linalg.norm(end - start) / 6.0)
        placed += [(start + part * (end - start), 0) for part in np.linspace(0.0, 1.0, count)]
    frame = axes.get_window_extent().get_points() * to_points
    for node in labelled[:: max(1, -(-len(labelled) // MOST_LABELS))]:
        size = len(str(node))
        at = axes.transData.transform(points[node]) * to_points
        spots = [(8 + 2.5 * size) * away for away in _free_directions(net, points, node)]
        inset = np.array([3.0 * size, 4.5])
        inside = [
            one
            for one in spots
            if np.all(np.abs(at + one - frame.mean(axis=0)) < np.ptp(frame, axis=0) / 2 - inset)
        ]
        spot = next((one for one in inside if not _covers(at + one, size, placed)), None)
        if spot is None:
            continue
        placed.append((at + spot, size))
        axes.annotate(
            str(node),
            points[node],
            xytext=tuple(spot),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=SMALL,
            fontweight="bold" if node in bullets else "normal",
            color=BLACK,
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=5,
        )


def _characters(text: Annotation, to_points: float) -> list[tuple[Floats, int]]:
    """Places, in points of 1/72 inch, that words of a length and a unit cover, as of single digits."""
    box = text.get_window_extent()
    corners = to_points * np.array([[box.x0, box.y0], [box.x1, box.y1]])
    if box.height > box.width or text.get_rotation() % 180 > 90:
        corners[:, 0] = corners[::-1, 0]
    inset = np.clip(to_points * min(box.width, box.height) / 2, 3.0, 6.0) * np.sign(corners[1] - corners[0])
    first, last = corners[0] + inset, corners[1] - inset
    return [(first + part * (last - first), 1) for part in np.linspace(0.0, 1.0, 8)]


def _covers(at: Floats, digits: int, placed: list[tuple[Floats, int]]) -> bool:
    """True if a number there, in points of 1/72 inch, would touch one that is placed."""
    return any(
        abs(at[0] - other[0]) < 3.0 * (digits + count) + 2.0 and abs(at[1] - other[1]) < 11.0
        for other, count in placed
    )


def _free_directions(net: Net, points: Floats, node: int) -> Floats:
    """Unit vectors (k, 2) from a node into gaps of 60 degrees or more between elements, innermost first."""
    ends = net.element_nodes
    others = np.concatenate([ends[ends[:, 0] == node, 1], ends[ends[:, 1] == node, 0]])
    arms = points[others] - points[node]
    angles = np.sort(np.arctan2(arms[:, 1], arms[:, 0]))
    if len(angles) == 0:
        return np.array([[0.0, 1.0]])
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    middles = angles + gaps / 2
    directions = np.column_stack([np.cos(middles), np.sin(middles)])
    inwards = directions @ (points.mean(axis=0) - points[node])
    wide = gaps >= min(np.radians(59), gaps.max())
    first = directions[wide][np.argsort(-inwards[wide], kind="stable")]
    if len(angles) > 1:
        return np.asarray(first)
    turned = angles[0] + np.pi + np.radians([0, 60, -60, 110, -110])  # beside the end of a string
    return np.column_stack([np.cos(turned), np.sin(turned)])
