"""Comparison of two runs, whichever code wrote them: nodes matched by place, times by value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr
from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError
from exunet.base.files import path_of
from exunet.results.io import load_result
from exunet.results.result import BLOCK_BYTES, BodyStates, Result, row_ranges


@dataclass(frozen=True)
class ComparedBreaks:
    """Elements that broke in two runs a and b, in a's numbers, until the last time that both have stored.

    both           : element, when it broke in a, and in b [s]
    only_a, only_b : elements that broke in one only
    """

    both: tuple[tuple[int, float, float], ...]
    only_a: tuple[int, ...]
    only_b: tuple[int, ...]

    @property
    def apart(self) -> float:
        """Largest difference [s] of the times at which an element broke."""
        return max((abs(a - b) for _, a, b in self.both), default=0.0)


@dataclass(frozen=True)
class BodyDifferences:
    """Differences of one body over the times that both runs have stored, (n,) each.

    position         : [m]
    velocity         : [m/s]
    attitude         : angle between the two [rad]
    angular_velocity : [rad/s], in body axes
    allowed_position, allowed_attitude : up to which the two agree [m], [rad]
    agrees_until     : when one of the two first exceeds what is allowed, or is NaN [s]; None: never
    """

    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats
    allowed_position: float
    allowed_attitude: float
    agrees_until: float | None


@dataclass(frozen=True)
class ComparedBodies:
    """The bodies of two runs a and b.

    both           : differences of those that both have, by name
    only_a, only_b : names of those that one has
    """

    both: Mapping[str, BodyDifferences] = field(default_factory=dict)
    only_a: tuple[str, ...] = ()
    only_b: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Agreement(ShortRepr):
    """Differences between a result and the reference's, at the times that both have stored.

    time                : (n,) [s]
    position_difference : (n,) [m], the largest over the nodes
    speed_difference    : (n,) [m/s], the largest over the bullets (over the nodes without bullets)
    allowed             : the speed difference up to which the two agree [m/s]
    allowed_position    : the same for positions [m]
    agrees_until        : when one of the two first exceeds what is allowed, or is NaN [s]; None: never
    apart_from          : the first stored time from which it never comes back within both [s], or None.
                          Earlier disagreement is that of single instants within a snap, where a shift of
                          its beginning by 1e-7 s shows as 1e-4 m/s
    reference_speeds    : (n, n_bullets) speeds of the bullets in the reference [m/s]
    bodies              : those beside the net, each judged by itself
    broken              : what broke, likewise; None: nothing did
    """

    time: Floats
    position_difference: Floats
    speed_difference: Floats
    allowed: float
    allowed_position: float
    agrees_until: float | None
    apart_from: float | None
    reference_speeds: Floats
    bodies: ComparedBodies = field(default_factory=ComparedBodies)
    broken: ComparedBreaks | None = None

    @property
    def identical(self) -> bool:
        """True if positions, speeds, bodies and breaks are the same at all times in common."""
        bodies, breaks = self.bodies, self.broken
        moved: list[Floats | None] = [self.position_difference, self.speed_difference]
        for body in bodies.both.values():
            moved += [body.position, body.velocity, body.attitude, body.angular_velocity]
        same_breaks = breaks is None or not (breaks.only_a or breaks.only_b or breaks.apart)
        return same_breaks and not (
            bodies.only_a or bodies.only_b or any(part is not None and np.any(part) for part in moved)
        )

    @property
    def speeds_of(self) -> str:
        """Whose speeds are compared: "bullets", or "nodes" of a net without bullets."""
        return "bullets" if self.reference_speeds.shape[1] else "nodes"


def compare_bodies(
    a: Mapping[str, BodyStates],
    b: Mapping[str, BodyStates],
    rows: tuple[Ints, Ints],
    time: Floats,
    allowed: tuple[float, float],
) -> ComparedBodies:
    """Compare the bodies of two runs at their rows (n,) of the same times (n,) [s].

    allowed : differences of position [m] and attitude [rad] up to which they agree
    """
    return ComparedBodies(
        {name: _of_body(body, b[name], rows, time, allowed) for name, body in a.items() if name in b},
        tuple(name for name in a if name not in b),
        tuple(name for name in b if name not in a),
    )


def _of_body(
    a: BodyStates, b: BodyStates, rows: tuple[Ints, Ints], time: Floats, allowed: tuple[float, float]
) -> BodyDifferences:
    at_a, at_b = rows
    position = np.linalg.norm(a.position[at_a] - b.position[at_b], axis=-1)
    velocity = np.linalg.norm(a.velocity[at_a] - b.velocity[at_b], axis=-1)
    turned = _angle(a.attitude[at_a], b.attitude[at_b])
    spin = np.linalg.norm(a.angular_velocity[at_a] - b.angular_velocity[at_b], axis=-1)
    within = (position <= allowed[0]) & (turned <= allowed[1])  # as a NaN is not
    until = None if within.all() else float(time[int(np.argmin(within))])
    return BodyDifferences(position, velocity, turned, spin, *allowed, until)


def _angle(a: Floats, b: Floats) -> Floats:
    """(n,) angles [rad] between unit quaternions (n, 4); q and -q are the same attitude.

    2 arcsin(|a - b| / 2) of the nearer of the two is precise for small angles, where 2 arccos(a . b) is not.
    """
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return 4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))


# Position difference up to which two runs count as agreeing, as a part of the diagonal of the box around
# the reference configuration: 2.0e-4 m in the paper's net.
# Bodies may differ by as much in position, and in attitude by this angle [rad], which moves a point that is
# as far away as the net is large by as much.
ALLOWED_PER_SIZE = 2e-5

# Speed difference up to which two runs count as agreeing, as a part of the largest initial speed:
# 1e-4 m/s at the paper's launch speed of 2.5 m/s.
ALLOWED_PER_SPEED = 4e-5

# Difference up to which masses, lengths and stiffnesses of two nets count as the same, as a part of each:
# the codes weave a net in different arithmetic, and agree to about 1e-15.
SAME_NET = 1e-9


class ComparedNet(Protocol):
    """Properties that exunet's nets and those of reference_impl share; shapes as in `Net`."""

    @property
    def reference_position(self) -> Floats: ...
    @property
    def element_nodes(self) -> NDArray[np.integer]: ...
    @property
    def reference_length(self) -> Floats: ...
    @property
    def area(self) -> Floats: ...
    @property
    def youngs_modulus(self) -> Floats: ...
    @property
    def mass(self) -> Floats: ...
    @property
    def bullet_nodes(self) -> NDArray[np.integer]: ...
    @property
    def fixed_nodes(self) -> NDArray[np.integer]: ...


@dataclass(frozen=True)
class ComparedRun:
    """Data by which two runs are compared; shapes as in `Result`, axial_stiffness E A (n_elements,) [N].

    bodies : those beside the net, by name
    broken : elements that broke and when [s], in order of time
    n_of_tethers : how many of the nodes, the last ones, are tethers' own; 0 too where that is not known
    """

    time: Floats
    position: Floats
    velocity: Floats
    complete: bool
    reference_position: Floats
    element_nodes: Ints
    bullet_nodes: Ints
    fixed_nodes: Ints
    mass: Floats
    reference_length: Floats
    axial_stiffness: Floats
    bodies: Mapping[str, BodyStates] = field(default_factory=dict)
    broken: tuple[tuple[int, float], ...] = ()
    n_of_tethers: int = 0

    @classmethod
    def of_net(
        cls, net: ComparedNet, time: Floats, position: Floats, velocity: Floats, complete: bool = True
    ) -> ComparedRun:
        """A run of a net of either code."""
        return cls(
            time,
            position,
            velocity,
            complete,
            net.reference_position,
            net.element_nodes.astype(np.int64),
            net.bullet_nodes.astype(np.int64),
            net.fixed_nodes.astype(np.int64),
            net.mass,
            net.reference_length,
            net.youngs_modulus * net.area,
        )

    @classmethod
    def of(cls, result: Result) -> ComparedRun:
        """The states of one of exunet's results."""
        net = cls.of_net(result.net, result.time, result.position, result.velocity, result.complete)
        broken = tuple((event.element, event.time_s) for event in result.run.breaks)
        of_tethers = result.net.n_nodes - result.net.n_net_nodes
        return replace(net, bodies=result.bodies, broken=broken, n_of_tethers=of_tethers)


def read_states(path: str | Path) -> ComparedRun:
    """Read the states of a result.h5 or a run's folder; raises InputError if it cannot be read."""
    return ComparedRun.of(load_result(path))


Run = Result | ComparedRun | str | Path


def _states(run: Run) -> ComparedRun:
    if isinstance(run, Result):
        return ComparedRun.of(run)
    return (
        run
        if isinstance(run, ComparedRun)
        else read_states(path_of(run, "compare", "a Result or the name of a file"))
    )


def match_nodes(a: ComparedRun, b: ComparedRun) -> Ints:
    """(n_nodes,) for each node of a, the node of b at the same reference position.

    Nets that list their nodes alike are matched by number, others by place; nodes of tethers, which have no
    place of their own in the reference configuration, by number. Raises InputError if the nets
    differ in nodes, elements or bullets.
    """
    if len(a.reference_position) != len(b.reference_position):
        raise InputError(
            f"not the same net: {len(a.reference_position)} nodes and {len(b.reference_position)} nodes"
        )
    match = np.arange(len(a.reference_position))
    n = len(match) - max(a.n_of_tethers, b.n_of_tethers)
    ours, theirs = a.reference_position[:n], b.reference_position[:n]
    near = 1e-9 * (float(np.ptp(ours, axis=0).max(initial=0.0)) or 1.0)
    if np.abs(ours - theirs).max(initial=0.0) > near:
        gap, match[:n] = scipy.spatial.cKDTree(theirs).query(ours)
        worst = int(np.argmax(gap))
        if gap[worst] > near:
            where = ", ".join(f"{c:.6g}" for c in ours[worst])
            raise InputError(f"not the same net: no counterpart of node {worst} at ({where}) m")
        if len(np.unique(match)) < len(match):
            raise InputError("cannot match the nodes: some share their reference position")
    if _undirected(match[a.element_nodes]) != _undirected(b.element_nodes):
        raise InputError("not the same net: the elements join different nodes")
    if set(match[a.bullet_nodes]) != set(b.bullet_nodes):
        raise InputError("not the same net: the bullets are different nodes")
    return match


def _undirected(elements: Ints) -> list[tuple[int, ...]]:
    return sorted(map(tuple, np.sort(elements, axis=1).tolist()))


def _match_elements(a: ComparedRun, b: ComparedRun, match: Ints) -> tuple[Ints, Ints]:
    """Elements (n_elements,) of a and those of b that are the same; raises InputError if they differ.

    match : of the nodes, which must not differ in what moves them either
    """
    if set(match[a.fixed_nodes]) != set(b.fixed_nodes):
        raise InputError("not the same net: different nodes are fixed")
    of_a, of_b = _in_order(match[a.element_nodes], a), _in_order(b.element_nodes, b)
    for what, unit, item, ours, theirs in (
        ("mass", "kg", "node", a.mass, b.mass[match]),
        ("reference length", "m", "element", a.reference_length[of_a], b.reference_length[of_b]),
        ("axial stiffness", "N", "element", a.axial_stiffness[of_a], b.axial_stiffness[of_b]),
    ):
        apart = ~(np.abs(ours - theirs) <= SAME_NET * np.abs(ours))
        if apart.any():
            k = int(np.argmax(apart))
            number = k if item == "node" else int(of_a[k])
            values = f"{ours[k]:.6g} {unit} and {theirs[k]:.6g} {unit}"
            raise InputError(f"not the same net: {what} of {item} {number} is {values}")
    return of_a, of_b


def _in_order(nodes: Ints, states: ComparedRun) -> Ints:
    """Order of the elements by their nodes (n_elements, 2), and among those between the same by stiffness."""
    low, high = np.sort(nodes, axis=1).T
    return np.lexsort((states.axial_stiffness, high, low))


def compare(a: Run, b: Run) -> Agreement:
    """How far run b is from run a at the times that both have stored, as an `Agreement`.

    a, b : results, or files of results: a result.h5 or a run's folder
    Nodes are matched by their reference positions. Raises InputError if there is no common time, if the nets
    are not the same, or if a file cannot be read.
    """
    a, b = _states(a), _states(b)
    match = match_nodes(a, b)
    elements = _match_elements(a, b, match)
    at_a, at_b = _common_times(a.time, b.time)
    if len(at_a) == 0:
        raise InputError("the two runs have no stored time in common")
    nodes = len(a.reference_position)
    found = [
        _differences(a, b, match, at_a[start:stop], at_b[start:stop])
        for start, stop in row_ranges(len(at_a), max(1, BLOCK_BYTES // (24 * nodes)))
    ]
    position, speed, reference_speeds = (np.concatenate(values) for values in zip(*found, strict=True))
    scale = float(np.linalg.norm(a.velocity[0], axis=-1).max()) or 1.0
    allowed = ALLOWED_PER_SPEED * scale
    allowed_position = ALLOWED_PER_SIZE * float(np.linalg.norm(np.ptp(a.reference_position, axis=0)))
    time = a.time[at_a]
    apart = ~((speed <= allowed) & (position <= allowed_position))  # as a NaN is
    first = int(np.argmax(apart)) if apart.any() else len(time)
    last_within = int(np.flatnonzero(~apart)[-1]) if not apart.all() else -1
    return Agreement(
        time=time,
        position_difference=position,
        speed_difference=speed,
        allowed=allowed,
        allowed_position=allowed_position,
        agrees_until=float(time[first]) if first < len(time) else None,
        apart_from=float(time[last_within + 1]) if last_within + 1 < len(time) else None,
        reference_speeds=reference_speeds,
        bodies=compare_bodies(a.bodies, b.bodies, (at_a, at_b), time, (allowed_position, ALLOWED_PER_SIZE)),
        broken=_compare_broken(a, b, elements, float(time[-1])),
    )


def _compare_broken(
    a: ComparedRun, b: ComparedRun, elements: tuple[Ints, Ints], until: float
) -> ComparedBreaks | None:
    """Compare the elements that broke in two runs until a time [s], by a's numbers; None without breaks."""
    ours = {element: time for element, time in a.broken if time <= until}
    numbers = dict(zip(elements[1].tolist(), elements[0].tolist(), strict=True))
    theirs = {numbers[element]: time for element, time in b.broken if time <= until}
    if not ours and not theirs:
        return None
    both = sorted(ours.keys() & theirs.keys())
    return ComparedBreaks(
        tuple((element, ours[element], theirs[element]) for element in both),
        tuple(sorted(ours.keys() - theirs.keys())),
        tuple(sorted(theirs.keys() - ours.keys())),
    )


def _differences(
    a: ComparedRun, b: ComparedRun, match: Ints, at_a: Ints, at_b: Ints
) -> tuple[Floats, Floats, Floats]:
    """Return largest differences of position, speed (k,) at some rows of both, b's bullet speeds (k, n)."""
    velocity_a, velocity_b = a.velocity[at_a], b.velocity[at_b][:, match]
    position = np.linalg.norm(a.position[at_a] - b.position[at_b][:, match], axis=-1)
    shown = a.bullet_nodes if len(a.bullet_nodes) else np.arange(len(a.reference_position))
    speeds_a, speeds_b = (np.linalg.norm(v[:, shown], axis=-1) for v in (velocity_a, velocity_b))
    return (
        position.max(axis=1),
        np.abs(speeds_a - speeds_b).max(axis=1),
        np.linalg.norm(velocity_b[:, a.bullet_nodes], axis=-1),
    )


def _common_times(a: Floats, b: Floats) -> tuple[Ints, Ints]:
    near = 1e-9 * max(a[-1], b[-1], 1e-300)
    at_b = np.clip(np.searchsorted(b, a - near), 0, len(b) - 1)
    at_a = np.flatnonzero(np.abs(b[at_b] - a) <= near)
    return at_a, at_b[at_a]


_SHARED = (
    "time",
    "position",
    "velocity",
    "reference_position",
    "element_nodes",
    "bullet_nodes",
    "fixed_nodes",
    "mass",
    "reference_length",
    "axial_stiffness",
)  # arrays that the file and `ComparedRun` have under the same name


def read_reference(path: str | Path) -> ComparedRun:
    """Read the states of the net and of the bodies, and what broke.

    Raises
    ------
    OSError, ValueError, KeyError
        If `path` is not such a file.
    """
    with np.load(path, allow_pickle=False) as file:
        bodies = {}
        for k, name in enumerate(file["body_names"].tolist()):
            turn = scipy.spatial.transform.Rotation.from_matrix(file["body_attitude"][:, k])
            bodies[name] = BodyStates(
                float(file["body_mass"][k]),
                file["body_inertia"][k],
                file["body_position"][:, k],
                file["body_velocity"][:, k],
                turn.as_quat(scalar_first=True),
                file["body_angular_velocity"][:, k],
            )
        broken = tuple(zip(file["break_element"].tolist(), file["break_time"].tolist(), strict=True))
        shared = {name: file[name] for name in _SHARED}
        return ComparedRun(complete=bool(file["complete"]), bodies=bodies, broken=broken, **shared)
