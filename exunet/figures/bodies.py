"""Bodies in a picture of the net: their shapes, and a mark of each at its centre of mass.

The mark of a body with a shape is open and small, so that it hides no shape.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.bodies.rotations import rotation_matrix
from exunet.figures.style import RED
from exunet.results.result import BodyStates, Result

Floats = NDArray[np.float64]

_MARKS = "Ds^vpP*X"  # of each body; a round one is a bullet's
_WIDTHS = (2.2, 1.0)  # of the x and y axes of a rigid body without a shape


def body_entries(result: Result) -> list[Line2D]:
    """For the legend: each body with its mark; of more bodies than marks only their number."""
    names, bodies = list(result.bodies), list(result.bodies.values())
    if len(names) > len(_MARKS):
        names = [f"{len(names)} bodies"]
    entries = [Line2D([], [], label=name, **_style(k, bodies[k])) for k, name in enumerate(names)]
    if any(body.wireframe is None and body.attitude is not None for body in result.bodies.values()):
        words = "body axes: $x$ broad, $y$ thin"
        entries.append(Line2D([], [], color=RED, linewidth=_WIDTHS[0], label=words))
    return entries


def body_places(result: Result, chosen: list[int]) -> Floats:
    """(k, n, 3) [m] of the bodies' centres of mass and the lines of their shapes, at chosen stored times."""
    places = [np.zeros((len(chosen), 0, 3))]
    for body in result.bodies.values():
        places.append(np.asarray(body.position[chosen])[:, None])
        if body.wireframe is not None:
            places.append(np.stack([_lines(body, k).reshape(-1, 3) for k in chosen]))
    return np.concatenate(places, axis=1)


def draw_bodies(
    axes: Axes, result: Result, k: int, origin: Floats, plane: tuple[int, int], arm: float, scale: float
) -> None:
    """The bodies at a stored time, relative to `origin` (3,) [m].

    arm   : length of the axes of a rigid body without a shape [m]
    scale : of lines and marks
    """
    for number, body in enumerate(result.bodies.values()):
        at = (body.position[k] - origin)[list(plane)]
        if body.wireframe is not None:
            lines = (_lines(body, k) - origin)[..., list(plane)]
            axes.add_collection(LineCollection(list(lines), colors=RED, linewidths=0.6), autolim=False)
        elif body.attitude is not None:
            arms = arm * rotation_matrix(np.asarray(body.attitude[k]))[list(plane)]
            for axis, width in enumerate(_WIDTHS):
                ends = np.stack([at, at + arms[:, axis]], axis=1)
                axes.plot(*ends, color=RED, linewidth=scale * width)
        mark = _style(number if len(result.bodies) <= len(_MARKS) else 0, body)
        axes.plot(*at, zorder=4, **(mark | {"markersize": scale * mark["markersize"]}))


def _style(number: int, body: BodyStates) -> dict[str, Any]:
    if body.wireframe is None:
        form = {"markersize": 5.5, "markeredgecolor": "white", "markeredgewidth": 0.4}
    else:
        form = {"markersize": 4.0, "markerfacecolor": "none", "markeredgecolor": RED, "markeredgewidth": 0.7}
    return {"color": RED, "linestyle": "", "marker": _MARKS[number], **form}


def _lines(body: BodyStates, k: int) -> Floats:
    """(n, 2, 3) [m] of its shape at a stored time."""
    assert body.wireframe is not None
    assert body.attitude is not None
    turn = rotation_matrix(np.asarray(body.attitude[k]))
    return np.asarray(body.wireframe @ turn.T + body.position[k])
