"""Marks of threads that touch bodies, in pictures of the net."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.figures.style import RED
from exunet.forces.contact.status import OF_BODY
from exunet.results.result import Result
from exunet.results.touching import contacts_at

HALO = 4.0  # points by which a thread that touches is broader


def draw_touching(axes: Axes, segments: NDArray[np.float64], width: float) -> None:
    """Under threads that touch; segments (n, 2, 2) in a plane, width: of the lines of threads."""
    if len(segments):
        lines = LineCollection(list(segments), colors=RED, linewidths=width + HALO, alpha=0.5, zorder=1.8)
        axes.add_collection(lines, autolim=False)


def touching_entries(result: Result) -> list[Line2D]:
    """For the legend, of a scene in which threads, nodes or bullets may touch bodies."""
    if not any(not what.startswith(OF_BODY) for one in contacts_at(result, 0).values() for what in one):
        return []
    return [Line2D([], [], color=RED, linewidth=HALO, alpha=0.5, label="touches a body")]
