"""Outcomes and causes of captures of which the truth is known from solid angles and distances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scenes import of_text
from scipy.spatial import ConvexHull

import exunet
from exunet.base.arrays import Floats
from exunet.net.arrays import Net
from exunet.results.observables import Observables
from exunet.results.outcome import Cause, Outcome, outcome, reason, summary_of_capture
from exunet.results.summary import summary_of
from exunet.scene.casefile import implausible

NET = """
format = 1
title = "A net is thrown at a ball"
[time]
end = 0.3
output_step = 0.01
[solver]
method = "RK44"
step = 1.4e-4
[engine]
backend = "compiled"
[net]
topology = "square"
size = 0.6
mesh = 0.15
[net.cable]
diameter = 0.001
density = 1390.0
youngs_modulus = 1e8
[net.bullets]
mass = 0.01
[initial]
packing = 0.98
velocity = [0.0, 0.0, 2.0]
[effects.material_damping]
relaxation_time = 1e-4
[effects.contact]
threads = ["ball_1"]
bullets = ["ball_1"]
bullet_radius = 0.01
law = "linear"
stiffness = 3e3
bullet_stiffness = 3e3
restitution = 0.3
impact_speed = 2.0
[bodies.ball_1]
shape = "sphere"
radius = 0.08
mass = 0.5
position = [0.02, 0.03, 0.3]
[capture]
target = "ball_1"
enclosed = 0.8
duration = 0.1
"""
AT = "bodies.ball_1.position=[%g, %g, %g]"
# The bullets fly ahead: a bag that is open towards +z, with its bottom at 0.09 m and its mouth at 0.3 m after
# 0.12 s. A small ball, which nothing touches, moves on a given way.
BAG = ("initial.velocity=", "launch={speed=3.0, spread_angle=0.3}", "effects.contact=", "capture.duration=0.03")
WAY = (
    "bodies.ball_1={shape='sphere', radius=0.01, mass=0.5, motion='prescribed', "
    "pose_times=[0.0, 0.11, 0.17, 1.0], pose_positions=%s}"
)
LINE = (
    "closing={kind='line', rings='edge', length=2.4, stiffness=100.0, linear_density=1e-3, "
    "ring_diameter=0.01, friction=0.0, winch={shortest=0.3, damping=0.5, largest_rate=6.0}}"
)
WINCH = (LINE, "capture.mouth=0.15", "time.end=0.6")
PULL = "closing.winch.commands=[{at=0.1, mode='tension', force=%g}%s]"
SCRIPT = "script=[{name='c', at=0.1, do='close', force=2.5}, {name='s_1', at=%g, on='closing', %s}]"
OPENING = ("initial.packing=0.2", "initial.velocity=", "launch={axial_speed=2.0, radial_speed=1.0}")
BULLETS = (
    "effects.contact={bullets=['ball_1'], bullet_radius=0.01, law='linear', bullet_stiffness=3e3, "
    "restitution=0.3, impact_speed=2.0}"
)
TOUCHES = "effects.contact.%s=['ball_1', 'wall_1']"
WALL = "bodies.wall_1={shape='box', size=[2, 2, 0.1], edge_radius=0.02, motion='fixed', position=[0, 0, 0.2]}"
TETHER = (
    "bodies.chaser={shape='box', size=[0.1, 0.1, 0.1], motion='fixed', position=[0.8, 0, -0.05]}",
    "tethers.tow={length=1.0, divisions=6, diameter=0.001, density=1390.0, youngs_modulus=1e8, "
    "start={body='chaser'}, end={node='centre'}}",
)


class Truth(NamedTuple):
    """What geometry says of a run.

    touched : a thread of the net came as near to the ball as both are thick, at a stored time
    inside  : the ball's centre was in the net's hull at a stored time; at_end: at the last
    crossed : what the ball's centre went through last: "net", "mouth" or ""
    """

    touched: bool
    inside: bool
    at_end: bool
    crossed: str = ""


class Scene(NamedTuple):
    """Changes of the scene, and what is right."""

    settings: tuple[str, ...]
    outcome: Outcome
    cause: Cause | None
    truth: Truth


NEVER, TOUCH, HELD = Truth(False, False, False), Truth(True, False, False), Truth(True, True, True)
UNDETERMINED, MISSED, TOUCHED, WRAPPED = Outcome.UNDETERMINED, Outcome.MISSED, Outcome.TOUCHED, Outcome.WRAPPED
SCENES = {
    "caught": Scene((), Outcome.CAPTURED, None, HELD),
    "inside, untouched": Scene(
        (*BAG, WAY % "[[0, 0, 0.18], [0, 0, 0.2], [0, 0, 0.21], [0, 0, 0.21]]", "time.end=0.14"),
        Outcome.CAPTURED, None, Truth(False, True, True, "mouth"),
    ),
    "left through the mouth": Scene(
        (*BAG, WAY % "[[0, 0, 0.2], [0, 0, 0.2], [0, 0, 0.7], [0, 0, 0.7]]", "time.end=0.2"),
        Outcome.ESCAPED, Cause.SLIPPED_OFF, Truth(False, True, False, "mouth"),
    ),
    "left through the side": Scene(
        (*BAG, WAY % "[[0, 0, 0.2], [0, 0, 0.2], [0.5, 0.2, 0.2], [0.5, 0.2, 0.2]]", "time.end=0.2"),
        Outcome.ESCAPED, Cause.SLIPPED_OFF, Truth(False, True, False, "net"),
    ),
    "passed above": Scene(
        (*BAG, WAY % "[[0, -0.5, 0.5], [0, -0.1, 0.5], [0.1, 0.3, 0.5], [4, 0, 0.5]]", "time.end=0.18"),
        MISSED, Cause.PASSED_BY, NEVER,
    ),
    "through a mesh": Scene(
        (AT % (0.075, 0.075, 0.3), "bodies.ball_1.radius=0.03"),
        MISSED, Cause.PASSED_BY, Truth(False, False, False, "net"),
    ),
    "late": Scene(("time.end=0.05",), UNDETERMINED, Cause.TOO_SLOW, NEVER),
    "slow": Scene(("initial.velocity=[0, 0, 0.05]",), UNDETERMINED, Cause.TOO_SLOW, NEVER),
    "far": Scene((AT % (0.1, 0.0, 50.0),), UNDETERMINED, Cause.TOO_SLOW, NEVER),
    "past it later": Scene((AT % (1.5, 0.0, 5.0),), MISSED, Cause.MISSED_SIDEWAYS, NEVER),
    "past it": Scene((AT % (1.5, 0.0, 0.3),), MISSED, Cause.MISSED_SIDEWAYS, NEVER),
    "flies away": Scene(("bodies.ball_1.velocity=[0, 0, 3]",), MISSED, Cause.NOT_REACHED, NEVER),
    "still opening": Scene((*OPENING, AT % (0.2, 0.2, 0.3), "time.end=0.05"), UNDETERMINED, Cause.TOO_SLOW, NEVER),
    "opened": Scene((*OPENING, AT % (0.2, 0.2, 0.3)), TOUCHED, Cause.PASSED_BY, TOUCH),
    "touches a tether": Scene(
        (*TETHER, AT % (0.5, 0.0, 0.1), "time.end=0.4"), MISSED, Cause.MISSED_SIDEWAYS, NEVER
    ),
    "wall": Scene(
        (WALL, TOUCHES % "threads", TOUCHES % "bullets", AT % (0.0, 0.0, 0.6)),
        MISSED, Cause.STOPPED_BY_BODY, NEVER,
    ),
    "bullets fly on alone": Scene(  # and the hull of net and bullets encloses the ball
        ("effects.breaking={force=1.0}", "initial.velocity=", "launch={speed=20.0, spread_angle=0.1}",
         AT % (0.0, 0.0, 0.5), "bodies.ball_1.velocity=[0, 0, 3]", "time.end=0.06"),
        MISSED, Cause.THREAD_BROKE, NEVER,
    ),
    "only bullets touch": Scene((BULLETS,), MISSED, Cause.FLEW_THROUGH, Truth(True, False, False, "net")),
    "moving in": Scene(("time.end=0.12",), UNDETERMINED, Cause.MOVING_IN, TOUCH),
    "weak": Scene((*WINCH, PULL % (0.1, "")), WRAPPED, Cause.WINCH_TOO_WEAK, HELD),
    "locked early": Scene(
        (*WINCH, PULL % (2.5, ", {at=0.2, mode='lock'}")), WRAPPED, Cause.WINCH_STOPPED, HELD
    ),
    "locked by the script": Scene((*WINCH, SCRIPT % (0.2, "do='lock'")), WRAPPED, Cause.WINCH_STOPPED, HELD),
    "released": Scene((*WINCH, SCRIPT % (0.3, "do='release'")), WRAPPED, Cause.WINCH_STOPPED, HELD),
    "paid out": Scene((*WINCH, SCRIPT % (0.4, "do='pay_out', rate=6.0")), WRAPPED, Cause.WINCH_STOPPED, HELD),
}  # fmt: skip


def solid_angles(point: Floats, triangles: Floats) -> Floats:
    """(n,) signed solid angles of triangles (n, 3, 3) [m]: Van Oosterom and Strackee, 1983, eq. (8)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    x, y, z = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    dots = (np.einsum("nk,nk->n", *pair) for pair in ((a, b), (a, c), (b, c)))
    ab, ac, bc = dots
    volume = np.einsum("nk,nk->n", a, np.cross(b, c))
    return 2.0 * np.arctan2(volume, x * y * z + ab * z + ac * y + bc * x)


def fan(loop: Floats) -> Floats:
    """(n, 3, 3) triangles from the mean of a loop of points (n, 3) [m]."""
    return np.stack([np.broadcast_to(loop.mean(axis=0), loop.shape), loop, np.roll(loop, -1, axis=0)], axis=1)


def angles_around(net: Net, x: Floats, point: Floats) -> tuple[float, float]:
    """Solid angles of the net's meshes and of its mouth, from a point."""
    meshes = np.concatenate([fan(x[list(face)]) for face in net.faces])
    return float(solid_angles(point, meshes).sum()), float(solid_angles(point, fan(x[list(net.rim)])).sum())


def in_hull(x: Floats, point: Floats) -> bool:
    """Whether the faces of the hull of points (n, 3) cover the whole sphere around a point."""
    if np.ptp(x, axis=0).min() < 1e-9:
        return False
    hull = ConvexHull(x)
    corners = x[hull.simplices]
    outward = np.einsum(
        "nk,nk->n", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), hull.equations[:, :3]
    )
    return bool(abs((np.sign(outward) * solid_angles(point, corners)).sum()) > 2.0 * np.pi)


def apart(x: Floats, ends: np.ndarray, point: Floats) -> float:
    """Least distance of a point from segments between nodes [m]."""
    start, way = x[ends[:, 0]], x[ends[:, 1]] - x[ends[:, 0]]
    part = np.einsum("nk,nk->n", point - start, way) / np.einsum("nk,nk->n", way, way)
    return float(np.linalg.norm(start + np.clip(part, 0.0, 1.0)[:, None] * way - point, axis=1).min())


def largest_piece(run: Observables, time: float) -> np.ndarray:
    """Elements of the net in its piece with most nodes at a time [s], by flooding it from each node."""
    net = run.result.net
    gone = {item["element"] for item in run.result.provenance.get("broken") or () if item["time_s"] <= time}
    left = [element for element in range(net.n_net_elements) if element not in gone]
    pieces = []
    for element in left:
        seen, size = set(net.element_nodes[element].tolist()), 0
        while len(seen) > size:
            size = len(seen)
            for item in left:
                if seen.intersection(pair := net.element_nodes[item].tolist()):
                    seen.update(pair)
        pieces.append([item for item in left if net.element_nodes[item][0] in seen])
    return np.array(max(pieces, key=len))


def truth_of(run: Observables, radius: float) -> tuple[Truth, float]:
    """What is true of a run, and the last time at which the ball was in the net's hull or touched [s]."""
    net, ball = run.result.net, np.asarray(run.result.bodies["ball_1"].position[:])
    thick = radius + float(np.sqrt(net.area[0] / np.pi))
    torn, piece = bool(run.result.provenance.get("broken")), np.arange(net.n_net_elements)
    touched, inside, angles = [], [], []
    for row, time in enumerate(run.time):
        piece = largest_piece(run, float(time)) if torn else piece
        x, ends = np.asarray(run.result.position[row]), net.element_nodes[piece]
        touched.append(apart(x, ends, ball[row]) <= thick)
        inside.append(in_hull(x[np.unique(ends)], ball[row]))
        angles.append(angles_around(net, x, ball[row]))
    jumps = np.abs(np.diff(angles, axis=0)) > 2.0 * np.pi
    crossed = [name for row in jumps for name, jump in zip(("net", "mouth"), row, strict=True) if jump]
    near = np.flatnonzero(np.logical_or(touched, inside))
    last = float(run.time[near[-1]]) if len(near) else 0.0
    return Truth(any(touched), any(inside), inside[-1], crossed[-1] if crossed and not torn else ""), last


@pytest.mark.parametrize("name", SCENES)
def test_an_outcome_and_its_cause_are_true(name: str) -> None:
    scene = SCENES[name]
    case = of_text(NET, *scene.settings)
    run = Observables(exunet.run(case))
    truth, last = truth_of(run, float(case.scene.bodies["ball_1"].radius or 0.0))
    found, why = outcome(run), reason(run)
    assert found is not None
    assert truth._replace(crossed=scene.truth.crossed and truth.crossed) == scene.truth
    assert (found.outcome, None if why is None else why.cause) == (scene.outcome, scene.cause)
    assert why is None or why.start <= why.end
    if found.outcome in (Outcome.ESCAPED, TOUCHED):
        assert found.time == pytest.approx(last, abs=0.011)  # an interval of output
    if found.outcome is Outcome.ESCAPED:
        through = (summary_of_capture(run) or {})["left_through"]
        assert through == {"net": "side", "mouth": "mouth"}[truth.crossed]
