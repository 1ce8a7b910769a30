"""Compares the states of two runs, whichever code wrote them: nodes matched by place, times by value."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from exunet.agreement import Agreement
from exunet.errors import InputError
from exunet.result import Result, load_result

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Position difference up to which two runs count as agreeing, as a part of the net's size: 1.4e-4 m in the
# paper's net.
ALLOWED_PER_SIZE = 2e-5

# Speed difference up to which two runs count as agreeing, as a part of the largest initial speed:
# 1e-4 m/s at the paper's launch speed of 2.5 m/s.
ALLOWED_PER_SPEED = 4e-5


@dataclass(frozen=True)
class States:
    """What two runs are compared by; shapes as in `Result`."""

    time: Floats
    position: Floats
    velocity: Floats
    reference_position: Floats
    element_nodes: Ints
    bullet_nodes: Ints
    complete: bool

    @classmethod
    def of(cls, result: Result) -> States:
        """The states of one of exunet's results."""
        net = result.net
        return cls(
            result.time,
            result.position,
            result.velocity,
            net.reference_position,
            net.element_nodes,
            net.bullet_nodes,
            result.complete,
        )


def read_states(path: str | Path) -> States:
    """States of a result.h5 of exunet or an .npz of reference_impl; raises InputError if it is neither."""
    if Path(path).suffix != ".npz":
        return States.of(load_result(path))
    try:
        with np.load(path, allow_pickle=False) as file:
            return States(
                file["t"],
                file["position"],
                file["velocity"],
                file["reference_position"],
                file["element_nodes"],
                file["bullet_nodes"],
                bool(file["complete"]),
            )
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except KeyError as error:
        raise InputError(f"{path}: not a file of reference_impl: {error.args[0]}") from error
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise InputError(f"{path}: not a readable .npz file: {error}") from error


def match_nodes(a: States, b: States) -> Ints:
    """(n_nodes,) for each node of a, the node of b at the same reference position.

    Nets that list their nodes alike are matched by number, others by place. Raises InputError if the nets
    differ in nodes, elements or bullets.
    """
    if len(a.reference_position) != len(b.reference_position):
        raise InputError(
            f"not the same net: {len(a.reference_position)} nodes and {len(b.reference_position)} nodes"
        )
    near = 1e-9 * (float(np.ptp(a.reference_position, axis=0).max(initial=0.0)) or 1.0)
    match = np.arange(len(a.reference_position))
    if np.abs(a.reference_position - b.reference_position).max(initial=0.0) > near:
        gap, match = cKDTree(b.reference_position).query(a.reference_position)
        worst = int(np.argmax(gap))
        if gap[worst] > near:
            where = ", ".join(f"{c:.6g}" for c in a.reference_position[worst])
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


def compare(a: States, b: States) -> Agreement:
    """How far b is from a at the times that both have stored; raises InputError if there are none."""
    match = match_nodes(a, b)
    at_a, at_b = _common_times(a.time, b.time)
    if len(at_a) == 0:
        raise InputError("the two runs have no stored time in common")
    velocity_a, velocity_b = a.velocity[at_a], b.velocity[at_b][:, match]
    position = np.linalg.norm(a.position[at_a] - b.position[at_b][:, match], axis=-1)
    shown = a.bullet_nodes if len(a.bullet_nodes) else np.arange(len(a.reference_position))
    speeds_a, speeds_b = (np.linalg.norm(v[:, shown], axis=-1) for v in (velocity_a, velocity_b))
    speed = np.abs(speeds_a - speeds_b).max(axis=1)
    scale = float(np.linalg.norm(a.velocity[0], axis=-1).max()) or 1.0
    allowed = ALLOWED_PER_SPEED * scale
    allowed_position = ALLOWED_PER_SIZE * float(np.linalg.norm(np.ptp(a.reference_position, axis=0)))
    time = a.time[at_a]
    apart = (speed > allowed) | (position.max(axis=1) > allowed_position)
    first = int(np.argmax(apart)) if apart.any() else len(time)
    last_within = int(np.flatnonzero(~apart)[-1]) if not apart.all() else -1
    return Agreement(
        time=time,
        position_difference=position.max(axis=1),
        speed_difference=speed,
        allowed=allowed,
        allowed_position=allowed_position,
        agrees_until=float(time[first]) if first < len(time) else None,
        apart_from=float(time[last_within + 1]) if last_within + 1 < len(time) else None,
        reference_speeds=np.linalg.norm(velocity_b[:, a.bullet_nodes], axis=-1),
    )


def _common_times(a: Floats, b: Floats) -> tuple[Ints, Ints]:
    near = 1e-9 * max(a[-1], b[-1], 1e-300)
    at_b = np.clip(np.searchsorted(b, a - near), 0, len(b) - 1)
    at_a = np.flatnonzero(np.abs(b[at_b] - a) <= near)
    return at_a, at_b[at_a]
