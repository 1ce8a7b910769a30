"""Outcomes and causes of captures of which the truth is known from solid angles and distances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scenes import CASES, SMALL_NET_AT_BALL, of_text
from scipy.spatial import ConvexHull

import exunet
from exunet.base.arrays import Floats, Ints
from exunet.net.arrays import Net
from exunet.results.observables import Observables
from exunet.results.outcome import Cause, Outcome, outcome, reason, summary_of_capture
from exunet.scene.casefile import implausible

BULLET = 0.01  # its radius [m]
AT = "bodies.ball_1.position=[%g, %g, %g]"
# The bullets fly ahead: a bag that is open towards +z, with its bottom at 0.09 m and its mouth at 0.3 m after
# 0.12 s. A small ball, which nothing touches, moves on a given way.
BAG = (
    "initial.velocity=",
    "launch={speed=3.0, spread_angle=0.3}",
    "effects.contact=",
    "capture.duration=0.03",
)
WAY = (
    "bodies.ball_1={shape='sphere', radius=0.01, mass=0.5, motion='prescribed', "
    "pose_times=[0.0, 0.11, 0.17, 1.0], pose_positions=%s}"
)
LINE = (
    "closing={kind='line', rings='edge', length=2.4, stiffness=100.0, linear_density=1e-3, "
    "ring_diameter=0.01, friction=0.0, winch={shortest=0.3, damping=0.5, largest_rate=6.0}}"
)
WINCH = (LINE, "capture.mouth=0.15")
PULL = "closing.winch.commands=[{at=0.1, mode='tension', force=%g}%s]"
SCRIPT = "script=[{name='c', at=0.1, do='close', force=2.5}, {name='s_1', at=%g, on='closing', %s}]"
OPENING = ("initial.packing=0.2", "initial.velocity=", "launch={axial_speed=2.0, radial_speed=1.0}")
BULLETS = (
    "effects.contact={bullets=['ball_1'], bullet_radius=0.01, law='linear', bullet_stiffness=3e3, "
    "restitution=0.3, impact_speed=2.0}"
)
TOUCHES = "effects.contact.%s=['ball_1', 'wall_1']"
WALL = (
    "bodies.wall_1={shape='box', size=[2, 2, 0.1], edge_radius=0.02, motion='fixed', mass=1.0, "
    "position=[0, 0, 0.2]}"
)
TETHER = (
    "bodies.chaser={shape='box', size=[0.1, 0.1, 0.1], motion='fixed', mass=1.0, position=[0.8, 0, -0.05]}",
    "tethers.tow={length=1.0, divisions=6, diameter=0.001, density=1390.0, youngs_modulus=1e8, "
    "start={body='chaser'}, end={node='centre'}}",
)

BOX = (  # a net of 1.5 m and a box that tumbles, or another body of that name
    "solver.step=1e-4", "net.size=1.5", "net.mesh=0.25", "net.bullets.mass=0.02", "bodies.ball_1=",
    "bodies.box={shape='box', size=[0.5, 0.35, 0.3], edge_radius=0.06, mass=5.0, position=[0.02, 0.04, 0.5], "
    "angular_velocity=[0.3, 1.0, 0.2]}",
    "effects.contact={threads=['box'], bullets=['box'], bullet_radius=0.01, law='linear', stiffness=6000.0, "
    "bullet_stiffness=5000.0, restitution=0.3, impact_speed=2.0, friction={law='sticking', coefficient=0.4}}",
    "capture={target='box', enclosed=0.85, mcqi=0.1, mouth=0.3, duration=0.5}",
)  # fmt: skip
SPHERE = "bodies.box={shape='sphere', radius=%g, mass=2.0, position=[%g, %g, %g]}"
LINE_6 = (LINE, "closing.length=6.0", "closing.winch.shortest=0.58", "closing.strength=20.0")
LOCK_6 = (*LINE_6, PULL.replace("0.1", "0.2") % (2.5, ", {at=1.5, mode='lock'}"))
CLOSE_6 = (
    "script=[{name='c', at=0.2, do='close', force=2.5}, {name='l', at=1.5, do='lock', on='closing'}, "
    "{name='r', at=%g, do='pay_out', on='closing', rate=%g}]"
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
UNDETERMINED, MISSED, TOUCHED, WRAPPED = (
    Outcome.UNDETERMINED,
    Outcome.MISSED,
    Outcome.TOUCHED,
    Outcome.WRAPPED,
)
SCENES = {
    "caught": Scene((), Outcome.CAPTURED, None, HELD),
    "inside, untouched": Scene(
        (*BAG, WAY % "[[0, 0, 0.18], [0, 0, 0.2], [0, 0, 0.21], [0, 0, 0.21]]", "time.end=0.14"),
        Outcome.CAPTURED, None, Truth(False, True, True),
    ),
    "left through the mouth": Scene(
        (*BAG, WAY % "[[0, 0, 0.2], [0, 0, 0.2], [0, 0, 0.7], [0, 0, 0.7]]", "time.end=0.2"),
        Outcome.ESCAPED, Cause.SLIPPED_OFF, Truth(False, True, False, "mouth"),
    ),
    "left through the side": Scene(
        (*BAG, WAY % "[[0, 0, 0.2], [0, 0, 0.2], [-0.28, 0.08, 0.5], [-0.28, 0.08, 0.5]]", "time.end=0.2"),
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
    "past it later": Scene((AT % (1.5, 0.0, 5.0),), MISSED, Cause.WOULD_MISS, NEVER),
    "flies away": Scene(("bodies.ball_1.velocity=[0, 0, 3]",), MISSED, Cause.NOT_REACHED, NEVER),
    "still opening": Scene(
        (*OPENING, AT % (0.2, 0.2, 0.3), "time.end=0.05"), UNDETERMINED, Cause.TOO_SLOW, NEVER
    ),
    "opened": Scene(
        (*OPENING, AT % (0.2, 0.2, 0.3), "time.output_step=0.002"), TOUCHED, Cause.PASSED_BY, TOUCH
    ),
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
    "about it": Scene((*BAG, AT % (0, 0, 0.25), "time.end=0.07"), UNDETERMINED, Cause.MOVING_IN, NEVER),
    "closing": Scene((*WINCH, PULL % (0.1, "")), Outcome.CLOSING, Cause.STILL_CLOSING, HELD),
    "a key": Scene(
        ("capture={target='ball_1', relative_speed=0.01, duration=0.1}",), WRAPPED, Cause.CONDITION, HELD
    ),
    "weak": Scene((*WINCH, PULL % (0.1, ", {at=0.25, mode='lock'}")), WRAPPED, Cause.WINCH_TOO_WEAK, HELD),
    "locked early": Scene(
        (*WINCH, PULL % (2.5, ", {at=0.2, mode='lock'}")), WRAPPED, Cause.WINCH_STOPPED, HELD
    ),
    "locked by the script": Scene((*WINCH, SCRIPT % (0.2, "do='lock'")), WRAPPED, Cause.WINCH_STOPPED, HELD),
    "released": Scene((*WINCH, SCRIPT % (0.25, "do='release'")), WRAPPED, Cause.WINCH_STOPPED, HELD),
    "paid out": Scene(
        (*WINCH, SCRIPT % (0.25, "do='pay_out', rate=6.0")), WRAPPED, Cause.WINCH_STOPPED, HELD
    ),
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
    """Whether all faces of the hull of points (n, 3) have a point on their inner side."""
    if np.ptp(x, axis=0).min() < 1e-9:
        return False
    return bool((ConvexHull(x).equations @ [*point, 1.0] < 0.0).all())


def apart(x: Floats, ends: Ints, point: Floats) -> float:
    """Least distance of a point from segments between nodes [m]."""
    start, way = x[ends[:, 0]], x[ends[:, 1]] - x[ends[:, 0]]
    part = np.einsum("nk,nk->n", point - start, way) / np.einsum("nk,nk->n", way, way)
    return float(np.linalg.norm(start + np.clip(part, 0.0, 1.0)[:, None] * way - point, axis=1).min())


def largest_piece(run: Observables, time: float) -> Ints:
    """Elements of the net in its piece with most nodes at a time [s], by flooding it from each node."""
    net = run.result.net
    gone = {item.element for item in run.result.run.breaks if item.time_s <= time}
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
    """What is true of a run, and when the ball was in the net's hull, or touched, last [s]."""
    net, ball = run.result.net, np.asarray(run.result.bodies["ball_1"].position[:])
    thread = float(np.sqrt(net.area[0] / np.pi))
    torn, piece = bool(run.result.run.breaks), np.arange(net.n_net_elements)
    touched, inside, angles = [], [], []
    for row, time in enumerate(run.time):
        piece = largest_piece(run, float(time)) if torn else piece
        x, ends = np.asarray(run.result.position[row]), net.element_nodes[piece]
        bullets = x[np.intersect1d(net.bullet_nodes, ends)]
        gap = np.linalg.norm(bullets - ball[row], axis=1).min(initial=np.inf) - BULLET
        touched.append(min(apart(x, ends, ball[row]) - thread, gap) <= radius)
        inside.append(in_hull(x[np.unique(ends)], ball[row]))
        angles.append(angles_around(net, x, ball[row]))
    jumps = np.abs(np.diff(angles, axis=0)) > 2.0 * np.pi  # a whole sphere, less what moves in an interval
    out = np.abs(np.diff(angles, axis=1)[:, 0]) < 2.0 * np.pi
    rows = np.flatnonzero(jumps.any(axis=1) & (out[1:] | out.all()))
    crossed = ["net" if jumps[row, 0] else "mouth" for row in rows]  # both of a flat net
    near = np.flatnonzero(np.logical_or(touched, inside))
    last = float(run.time[near[-1]]) if len(near) else 0.0
    return Truth(any(touched), any(inside), inside[-1], crossed[-1] if crossed and not torn else ""), last


@pytest.mark.parametrize("name", SCENES)
def test_an_outcome_and_its_cause_are_true(name: str) -> None:
    scene = SCENES[name]
    case = of_text(SMALL_NET_AT_BALL, *scene.settings)
    run = Observables(exunet.run(case))
    truth, last = truth_of(run, float(case.scene.bodies["ball_1"].radius or 0.0))
    found, why = outcome(run), reason(run)
    assert found is not None
    assert truth._replace(crossed=scene.truth.crossed and truth.crossed) == scene.truth
    assert (found.outcome, None if why is None else why.cause) == (scene.outcome, scene.cause)
    assert why is None or (why.start <= why.end and why.subject in str(why))
    if found.outcome in (Outcome.ESCAPED, TOUCHED):
        assert found.time == pytest.approx(last, abs=0.011)  # an interval of output
    if found.outcome is Outcome.ESCAPED:
        through = (summary_of_capture(run) or {})["left_through"]
        assert through == {"net": "side", "mouth": "mouth"}[truth.crossed]


class Report(NamedTuple):
    """Changes of the scene with the box, and outcome, cause and numbers that are right."""

    settings: tuple[str, ...]
    outcome: Outcome
    cause: Cause
    numbers: dict[str, float]


# Numbers by other means: times and parts enclosed from stored states, distances from the motion of the net's
# centre, lengths and forces of the winch from its states between its commands.
REPORTS = {
    "rebound": Report(
        ("bodies.box={shape='box', size=[3, 3, 0.2], edge_radius=0.05, mass=500.0, position=[0, 0, 0.5]}",
         "time.end=1.5"),
        TOUCHED, Cause.REBOUNDED, {"enclosed": 0.0},
    ),
    "half in the net": Report(
        ("net.size=0.6", "net.mesh=0.1", "solver.step=5e-5", "time.end=1.2", *LOCK_6, "closing.length=2.4",
         "closing.winch.shortest=0.3"),
        TOUCHED, Cause.SLIPPED_OFF, {"enclosed": 0.57, "start": 0.30},
    ),
    "begins to wrap": Report(
        ("bodies.box.velocity=[0, 0, 1.9]", "time.end=2.2"),
        UNDETERMINED, Cause.MOVING_IN, {"speed_m_s": 0.098},
    ),
    "slow target": Report(
        (*LOCK_6, "bodies.box.velocity=[0, 0, 1.9]", "time.end=1.5"),
        UNDETERMINED, Cause.TOO_SLOW, {"speed_m_s": 0.0992},
    ),
    "misses later": Report(
        (*LOCK_6, SPHERE % (0.25, 3.0, 0.0, 10.0), "time.end=3.2"),
        MISSED, Cause.WOULD_MISS, {"offset_m": 3.0},
    ),
    "rectangle": Report(
        ("net={topology='rectangular', size=[4.0, 0.5], mesh=[0.25, 0.25], cable={diameter=0.001, "
         "density=1390.0, youngs_modulus=1e8}, bullets={mass=0.02}}", SPHERE % (0.04, 1.625, 0.125, 0.5),
         "time.end=0.6"),
        MISSED, Cause.PASSED_BY, {"mouth_m": 3.95, "largest_m": 3.95},
    ),
    "mouth alone": Report(
        ("time.end=1.0", "initial.packing=0.1", "launch={radial_speed=1.0, axial_speed=0.0}",
         "bodies.box.position=[3.0, 0.0, 0.5]",
         "capture={target='box', mouth=0.3, duration=0.1}"),
        MISSED, Cause.MISSED_SIDEWAYS, {"offset_m": 3.0},
    ),
    "relative speed alone": Report(
        ("initial.packing=0.3", "initial.frame={body='chaser', position=[0, 0, 0.7]}",
         "bodies.box.position=[2.0, 0.0, 0.5]",
         "bodies.chaser={shape='box', size=[0.4, 0.4, 0.4], mass=50.0, position=[0.0, 0.0, -0.7]}",
         "capture={target='box', relative_speed=0.5, duration=0.2}",
         "script=[{name='e', at=0.5, do='eject'}]", "time.end=1.0"),
        MISSED, Cause.MISSED_SIDEWAYS, {"offset_m": 2.0},
    ),
    "paying out": Report(
        (*LINE_6, CLOSE_6 % (2.0, 3.0), "time.end=2.45"), WRAPPED, Cause.WINCH_STOPPED, {"end": 1.5}
    ),
    "paid out": Report(
        (*LINE_6, CLOSE_6 % (2.3, 6.0), "bodies.box.angular_velocity=[0.3, 2.0, 0.2]", "time.end=4",
         "effects.contact.friction.coefficient=0.05"),
        WRAPPED, Cause.WINCH_STOPPED, {"wound_m": 5.33, "end": 1.5, "force_N": 2.5},
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.ci_for("rectangle", "paying", "mouth")
@pytest.mark.parametrize("name", REPORTS)
def test_what_is_reported_of_a_box(name: str) -> None:
    settings, known, cause, numbers = REPORTS[name]
    run = Observables(exunet.run(of_text(SMALL_NET_AT_BALL, *BOX, *settings)))
    found, why = outcome(run), reason(run)
    assert found is not None
    assert why is not None
    assert (found.outcome, why.cause) == (known, cause)
    assert 0.0 <= why.start <= why.end
    reported = {"start": why.start, "end": why.end, **why.numbers}
    for key, value in numbers.items():
        assert reported[key] == pytest.approx(value, rel=0.01), key


def test_a_check_gives_the_distance_from_nodes_to_the_surface() -> None:
    """The face of the box is 1.2 - 0.4 m from the plane of the net: 0.2 s at 4 m/s."""
    case = exunet.load(CASES / "capture" / "box.toml", ["time.end=0.05", "capture.duration=0.01"])
    (fault,) = implausible(case)
    assert fault.key == "time.end"
    assert "0.8 m" in fault.reason
    assert "0.2 s" in fault.reason
    assert implausible(exunet.load(CASES / "capture" / "box.toml")) == []
