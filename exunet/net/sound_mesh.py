"""What the faces and the mouth of a topology's mesh must be; no case can make them otherwise."""

from __future__ import annotations

import numpy as np

from exunet.net.arrays import Floats, Ints, Mesh

_GUIDE = "see docs/extending.md, A topology"


def refuse_unsound(mesh: Mesh, topology: str) -> None:
    """Raise ValueError, for who writes a topology, if its faces or its mouth are not what `Mesh` says.

    Measures of deployment, contact and closing would take them as they are, and be wrong.
    """
    where = f"the mesh of the topology {topology!r}"
    corners = np.unique(mesh.anchors)
    if len(mesh.mouth) and not np.array_equal(np.sort(mesh.mouth), corners):
        words = f"its mouth has the knots {_few(mesh.mouth)}, its corners (anchors) are {_few(corners)}"
        raise ValueError(f"{where}: {words}: the mouth is the ring of corners, each once; {_GUIDE}")
    if len(mesh.mouth) and (_turning(mesh.knots, mesh.mouth[None]) < 0.0).any():
        raise ValueError(f"{where}: its mouth is not anticlockwise as seen from +z; {_GUIDE}")
    joined = np.sort(_names(np.sort(mesh.sides, axis=1), len(mesh.knots)))
    for loops in mesh.faces:
        pairs = np.stack([loops, np.roll(loops, -1, axis=1)], axis=-1)
        names = _names(np.sort(pairs.reshape(-1, 2), axis=1), len(mesh.knots))
        if (wrong := joined[np.searchsorted(joined[:-1], names)] != names).any():
            pair = pairs.reshape(-1, 2)[int(np.argmax(wrong))].tolist()
            raise ValueError(f"{where}: a face goes from knot {pair[0]} to {pair[1]}: no side; {_GUIDE}")
        if (turns := _turning(mesh.knots, loops) < 0.0).any():
            face = _few(loops[int(np.argmax(turns))])
            raise ValueError(f"{where}: the face {face} is not anticlockwise as seen from +z; {_GUIDE}")


def _names(pairs: Ints, n_knots: int) -> Ints:
    """(n,) a number for each pair of knots (n, 2)."""
    return np.asarray(pairs[:, 0] * n_knots + pairs[:, 1])


def _turning(knots: Floats, loops: Ints) -> Floats:
    """(n_loops,) twice the area of loops of knots (n_loops, k) as seen from +z, below 0 if clockwise."""
    with np.errstate(over="ignore", invalid="ignore"):  # a net beyond floats is refused elsewhere
        x, y = np.moveaxis(knots[loops][..., :2] - knots[loops[:, :1]][..., :2], -1, 0)
        return np.asarray((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))


def _few(knots: Ints) -> str:
    shown = ", ".join(map(str, knots[:8].tolist()))
    return f"[{shown}{', ...' if len(knots) > 8 else ''}]"
