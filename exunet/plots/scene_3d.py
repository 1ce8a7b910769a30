"""Pictures of a scene in three dimensions: shaded bodies, and the threads that they do not hide.

The projection is orthographic, so lengths across the line of sight are true. Faces of bodies are sorted by
depth. Threads are divided, and the parts behind a body are left out: whether a face is in front of a point is
exact, as faces are plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba_array
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from exunet.base.arrays import Bools, Floats
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Shape, TriangleMesh
from exunet.bodies.touched import surface_shown
from exunet.plots.style import BLACK, BLUE, RED, SMALL
from exunet.results.clearance import rounded_shapes
from exunet.results.loads import attached_nodes, broken_at
from exunet.results.measures import centre_of_mass
from exunet.results.penetration import contact_places
from exunet.results.result import Result

FROM_FRONT, FROM_SIDE = (0.0, 0.0, 1.0), (1.0, 0.55, 0.6)  # to the viewer; the y axis points upwards
TARGET, OTHER = 0.86, 0.58  # grey levels of bodies in full light
_DARKEST = 0.55  # light on a face that is turned away, relative to full light
_PIECES = 6  # of an element: parts behind a body are left out
_FEW = 4  # styles of threads
_PAIRS = 1 << 20  # of points and faces that are compared at a time
_DEEP = 0.3  # of the edge radius, to which threads press into a body
_FLAT = 0.01  # extent relative to the size of the net below which it is seen from the front
_FAR = 3.0  # sizes of the net; of a larger scene the views are centred on the net
_FARTHEST = 20.0  # sizes of the net, beyond which a failed run is cut off


class BodySurface(NamedTuple):
    """A body in a picture: its surface, how deep in it threads may lie [m], and the grey level."""

    name: str
    surface: TriangleMesh | None
    slack: float
    grey: float


@dataclass(frozen=True)
class Camera:
    """An orthographic view.

    axes  : (3, 3) rows: to the right, upwards, to the viewer
    half  : half of the width and of the height that it shows [m]
    follows : True if the centre of mass of the net is in the middle of the view
    middle : (3,) point in the middle; relative to the centre of mass if the view follows it [m]
    """

    axes: Floats
    half: tuple[float, float]
    follows: bool
    middle: Floats


@dataclass(frozen=True)
class Scene3D:
    """A result and a view of it."""

    result: Result
    camera: Camera
    bodies: tuple[BodySurface, ...]
    centre: Floats
    balls: NDArray[np.int64]

    def origin(self, k: int) -> Floats:
        """Return the point in the middle of the view at a stored time [m]."""
        return np.asarray(self.camera.middle + (self.centre[k] if self.camera.follows else 0.0))


def scene_3d(result: Result, chosen: Sequence[int]) -> Scene3D:
    """Choose the view of stored times: all of the scene, or of a scene that is much larger the net."""
    net, shapes = result.net, rounded_shapes(result)
    rule, default = result.run.capture, "target" if "target" in shapes else next(iter(shapes), None)
    first = default if rule is None else rule.target
    bodies = tuple(
        BodySurface(
            name,
            surface_shown(shapes[name]) if name in shapes else None,
            _slack(shapes[name]) if name in shapes else 0.0,
            TARGET if name == first else OTHER,
        )
        for name in result.bodies
    )
    centre = centre_of_mass(result)
    states = np.asarray(result.position[list(chosen)])
    places = [_corners(result, body, k) for body in bodies for k in chosen]
    size = net.size if net.n_net_elements else float(np.ptp(states, axis=(0, 1)).max()) or 1.0
    own = states[:, : net.n_net_nodes] - centre[list(chosen)][:, None]
    everything = np.concatenate([states.reshape(-1, 3), *places])
    extent = np.ptp(everything, axis=0)
    axes = _axes(FROM_FRONT if extent[2] < _FLAT * max(size, extent.max()) else FROM_SIDE)
    travelled = float(np.linalg.norm(centre[list(chosen)] - centre[chosen[0]], axis=1).max())
    alone = not bodies and travelled > 0.5 * size
    follows = bool(net.n_net_elements and (extent.max() > _FAR * size or alone))
    points = own.reshape(-1, 3) if follows else everything
    limit = _FARTHEST * size
    seen = np.clip(points, np.median(points, axis=0) - limit, np.median(points, axis=0) + limit) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = np.maximum(0.53 * (high - low)[:2], 0.2 * (high - low)[:2].max() or 0.5)
    balls = np.concatenate([net.bullet_nodes, free_nodes(result)])
    middle = 0.5 * (low + high) @ axes
    return Scene3D(
        result, Camera(axes, (float(half[0]), float(half[1])), follows, middle), bodies, centre, balls
    )


def _slack(shape: Shape) -> float:
    """Return how deep in the surface a thread may lie [m]: round edges of a mesh are drawn sharp."""
    return shape.edge_radius * (_DEEP if shape.mesh is None else 1.0)


def _axes(towards: tuple[float, float, float]) -> Floats:
    forward = np.array(towards) / np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _corners(result: Result, body: BodySurface, k: int) -> Floats:
    """Return the corners (n, 3) [m] of a body at a stored time; of one without a shape its centre of mass."""
    states = result.bodies[body.name]
    place = np.asarray(states.position[k])
    if body.surface is None:
        return place[None]
    return np.asarray(body.surface.vertices @ rotation_matrix(np.asarray(states.attitude[k])).T + place)


def free_nodes(result: Result) -> NDArray[np.int64]:
    """Return the nodes to which no thread, no bullet and no body is attached."""
    held = [attached_nodes(result, name) for name in result.bodies]
    used = np.concatenate([result.net.element_nodes.ravel(), result.net.bullet_nodes, *held])
    return np.setdiff1d(np.arange(result.net.n_nodes), used)


def draw(axes: Axes, scene: Scene3D, k: int, colors: Any = BLUE, width: float = 0.8) -> list[Artist]:
    """Draw a stored time.

    colors : one colour of all threads, or (n_elements, 4) colours
    width  : of threads [points]
    """
    result, net, camera = scene.result, scene.result.net, scene.camera
    limit = 1e3 * (camera.half[0] + camera.half[1])

    def seen(points: Floats) -> Floats:
        return np.clip((points - scene.origin(k)) @ camera.axes.T, -limit, limit)

    position = seen(np.asarray(result.position[k]))
    faces, shades, edges = [], [], []
    for body in scene.bodies:
        corners = seen(_corners(result, body, k))
        if body.surface is None:
            continue
        triangles = corners[body.surface.triangles]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        front = normals[:, 2] > 0.0
        light = np.clip(normals[front] @ _LIGHT, 0.0, 1.0)
        faces.append(triangles[front])
        shades.append(body.grey * (_DARKEST + (1.0 - _DARKEST) * light))
        edges.append(np.full(int(front.sum()), body.slack))
    hiding = np.concatenate([np.zeros((0, 3, 3)), *faces])
    slack = np.concatenate([np.zeros(0), *edges])
    drawn: list[Artist] = []
    if len(hiding):
        order = np.argsort(hiding[:, :, 2].mean(axis=1), kind="stable")
        grey = np.repeat(np.concatenate(shades)[order][:, None], 3, axis=1)
        bodies = PolyCollection(list(hiding[order][:, :, :2]), facecolors=grey, edgecolors=grey)
        bodies.set(zorder=1.0, linewidths=0.3, joinstyle="round")
        drawn.append(axes.add_collection(bodies, autolim=False))

    broken = [element for element, time in broken_at(result).items() if time <= result.time[k]]
    kept = np.setdiff1d(np.arange(net.n_elements), broken)
    widths = np.where(net.is_string, 1.3, 1.0) * width
    widths[net.n_net_elements :] = 1.6 * width
    of_all = np.broadcast_to(np.asarray(to_rgba_array(colors)), (net.n_elements, 4))
    drawn += _lines(axes, position[net.element_nodes[kept]], of_all[kept], widths[kept], hiding, slack, 2.0)
    path = np.array(result.run.closing_path, dtype=np.int64)
    line = np.stack([position[path[:-1]], position[path[1:]]], axis=1)
    black = np.broadcast_to(np.asarray(to_rgba_array(BLACK)), (len(line), 4))
    drawn += _lines(axes, line, black, np.full(len(line), 1.8 * width), hiding, slack, 2.2)

    places = contact_places(result, [k])[0]
    touching = np.flatnonzero(~np.isnan(places))
    start, end = (position[net.element_nodes[touching, side]] for side in (0, 1))
    points = start + places[touching, None] * (end - start)
    shapeless = [seen(_corners(result, body, k)) for body in scene.bodies if body.surface is None]
    marks: tuple[tuple[Floats, dict[str, Any]], ...] = (
        (points, {"s": 2.0 + 4.0 * width, "color": RED}),
        (position[scene.balls], {"s": 4.0 + 8.0 * width, "color": BLACK}),
        (np.concatenate([np.zeros((0, 3)), *shapeless]), {"s": 14.0, "color": "0.4", "marker": "D"}),
    )
    for spots, style in marks:
        shown = spots[~hidden(spots, hiding, slack)]
        if len(shown):
            drawn.append(axes.scatter(shown[:, 0], shown[:, 1], linewidths=0, zorder=3, **style))
    return drawn


_LIGHT = np.array([-0.35, 0.65, 0.67])  # from the upper left, in the axes of the view


def _lines(
    axes: Axes, segments: Floats, colors: Floats, widths: Floats, hiding: Floats, slack: Floats, order: float
) -> list[Artist]:
    """Draw the visible parts of segments (n, 2, 3): by style, or of many styles the farthest first."""
    if not len(segments):
        return []
    part = np.linspace(0.0, 1.0, _PIECES + 1)[:, None, None]
    cuts = segments[:, 0] * (1.0 - part) + segments[:, 1] * part  # (pieces + 1, n, 3)
    behind = hidden((0.5 * (cuts[1:] + cuts[:-1])).reshape(-1, 3), hiding, slack).reshape(_PIECES, -1)
    whole = ~behind.any(axis=0)
    pieces, rows = np.nonzero(~behind & ~whole)
    lines = np.concatenate([segments[whole], np.stack([cuts[pieces, rows], cuts[pieces + 1, rows]], axis=1)])
    of = np.concatenate([np.flatnonzero(whole), rows])
    styles, number = np.unique(np.column_stack([colors, widths])[of], axis=0, return_inverse=True)
    if len(styles) <= _FEW:  # joined, with gaps: much faster than one by one
        gaps = np.concatenate([lines[:, :, :2], np.full((len(lines), 1, 2), np.nan)], axis=1)
        paths = [gaps[number.ravel() == k].reshape(-1, 2) for k in range(len(styles))]
    else:
        far = np.argsort(lines[:, :, 2].mean(axis=1), kind="stable")
        paths, styles = list(lines[far][:, :, :2]), styles[number.ravel()[far]]
    drawn = LineCollection(
        paths, colors=styles[:, :4], linewidths=styles[:, 4], capstyle="round", zorder=order
    )
    return [axes.add_collection(drawn, autolim=False)]


def hidden(points: Floats, faces: Floats, slack: Floats) -> Bools:
    """Find points (n, 3) that are behind faces (m, 3, 3), corners in the axes of a view.

    slack : (m,) how far behind a face is still in front of it [m]: rounded edges are inside the faces
    """
    found = np.zeros(len(points), dtype=bool)
    if not len(faces) or not len(points):
        return found
    low, high = faces[:, :, :2].min(axis=(0, 1)), faces[:, :, :2].max(axis=(0, 1))
    near = np.flatnonzero(((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1))
    a, b, c = faces[:, 0], faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    solid = np.flatnonzero(np.abs(area) > 0.0)
    a, b, c, area, slack = a[solid], b[solid], c[solid], area[solid], slack[solid]
    size = max(1, _PAIRS // max(1, len(solid)))
    for first in range(0, len(near), size):
        rows = near[first : first + size]
        x, y = (points[rows, axis, None] - a[:, axis] for axis in (0, 1))
        s, t = (x * c[:, 1] - y * c[:, 0]) / area, (y * b[:, 0] - x * b[:, 1]) / area
        depth = a[:, 2] + s * b[:, 2] + t * c[:, 2] - slack
        found[rows] = ((s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (depth > points[rows, 2, None])).any(axis=1)
    return found


def prepare(axes: Axes, scene: Scene3D) -> None:
    """Set limits and equal scales; the axes are not drawn."""
    x, y = scene.camera.half
    axes.set(xlim=(-x, x), ylim=(-y, y), aspect="equal", xticks=[], yticks=[])
    axes.set_axis_off()


def scale_of(camera: Camera) -> float:
    """Return a length of 1, 2 or 5 times a power of ten, about a quarter of the view [m]."""
    wanted = 0.5 * camera.half[0]
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= wanted))


def draw_scale(axes: Axes, camera: Camera) -> None:
    """Draw a bar of known length, and the directions of the axes, in the lower corners of a view."""
    (x, y), length = camera.half, scale_of(camera)
    left, bottom = -0.97 * x, -0.94 * y
    axes.plot([left, left + length], [bottom, bottom], color=BLACK, linewidth=1.2, solid_capstyle="butt")
    style: dict[str, Any] = {"fontsize": SMALL, "va": "bottom", "ha": "left"}
    axes.text(left, bottom + 0.02 * y, f"{length:g} m", **style)
    arm, corner = 0.13 * min(x, y), np.array([0.8 * x, -0.8 * y])
    for name, direction in zip("xyz", camera.axes.T[:, :2], strict=True):
        if np.linalg.norm(direction) > 0.2:
            tip = corner + arm * direction
            axes.plot(*np.stack([corner, tip], axis=1), color="0.4", linewidth=0.7)
            at = corner + 1.35 * arm * direction
            style = {"fontsize": SMALL, "ha": "center", "va": "center", "color": "0.3", "style": "italic"}
            axes.text(at[0], at[1], name, **style)


def entries(scene: Scene3D, thread: str | None = BLUE) -> list[Any]:
    """Return the entries of a legend; thread: colour of threads, None: they have several."""
    result, net = scene.result, scene.result.net
    found: list[Any] = []
    if thread is not None and net.n_elements:
        found.append(Line2D([], [], color=thread, linewidth=1.0, label="threads"))
    if result.run.closing_path:
        found.append(Line2D([], [], color=BLACK, linewidth=1.6, label="closing line"))
    if len(net.bullet_nodes):
        found.append(_dot(BLACK, "bullets"))
    if result.contacts:
        found.append(_dot(RED, "contact of a thread"))
    for grey in (TARGET, OTHER):
        names = [body.name for body in scene.bodies if body.surface is not None and body.grey == grey]
        if names:
            words = ", ".join(names) if len(names) < 4 else f"{len(names)} bodies"
            found.append(Patch(facecolor=str(0.85 * grey), edgecolor="0.3", linewidth=0.4, label=words))
    points = [body.name for body in scene.bodies if body.surface is None]
    if points:
        found.append(
            Line2D([], [], color="0.4", linestyle="", marker="D", markersize=3, label=", ".join(points))
        )
    return found


def _dot(color: str, label: str) -> Line2D:
    return Line2D([], [], color=color, linestyle="", marker="o", markersize=3, label=label)
