"""Momentum of each part of a scene over time, and what effects and bodies of given motion have given."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.from_outside import OUTSIDE, effects_of
from exunet.results.ends import ends_of_result, momenta_of
from exunet.results.result import Result, blocks

Floats = NDArray[np.float64]

NET = "net"  # the name of the net among the parts
GIVEN_BY = "impulse of "  # before the name of what has given it
KINDS = ("linear", "angular")


class MomentumCourse(NamedTuple):
    """Linear [kg m/s] and angular about the scene's origin [kg m2/s], (t, 3) each, in the scene's axes."""

    linear: Floats
    angular: Floats


def part_names(bodies: Sequence[str], guided: Collection[str], outside: Sequence[str]) -> tuple[str, ...]:
    """Names of what has momentum, or has given some: free bodies, the net; guided bodies, and effects.

    Empty without bodies: of such scenes no book is kept.
    """
    if not bodies:
        return ()
    given = *(name for name in bodies if name in guided), *outside
    return (*(name for name in bodies if name not in guided), NET, *(GIVEN_BY + name for name in given))


def momenta_in(records: NDArray[np.void], guided: Sequence[bool], outside: int) -> Floats:
    """(t, n, 6) momentum and angular momentum of `part_names` from (t, n_bodies + n_outside + 1) `END`.

    guided : of each body whether its motion is given; outside : number of effects
    """
    bodies = np.arange(len(guided))
    of_guided = np.array(guided, dtype=bool)
    own = np.append(bodies[~of_guided], len(guided) + outside)
    given = np.append(bodies[of_guided], len(guided) + np.arange(outside))
    parts = (
        np.concatenate([records[name][:, rows] for name in names], axis=-1)
        for rows, names in (
            (own, ("momentum", "angular_momentum")),
            (given, ("impulse", "angular_impulse")),
        )
    )
    return np.concatenate(list(parts), axis=1)


def momenta_over_time(result: Result) -> Floats:
    """(t, n, 6) the same of a result; (t, 0, 6) without bodies."""
    if not result.bodies:
        return np.zeros((len(result.time), 0, 6))
    guided = [name for name in result.bodies if f"{name}/impulse" in result.states]
    names = part_names(list(result.bodies), guided, effects_of(result.states))
    every = _of_parts(result) | _given(result)
    none = MomentumCourse(*np.zeros((2, len(result.time), 3)))  # of a net without mass
    found = [np.concatenate(every.get(name, none), axis=1) for name in names]
    return np.stack(found, axis=1)


def momenta_at_start(
    ends: NDArray[np.void], bodies: Sequence[str], guided: Collection[str], outside: Sequence[str]
) -> Floats:
    """(n, 6) momenta of `part_names` at the start, before an ejection at time 0; ends : records `END`."""
    return momenta_in(ends[:1], [name in guided for name in bodies], len(outside))[0]


def gained_by_parts(result: Result) -> dict[str, MomentumCourse]:
    """Momentum that each free body and the net (with tethers and strings) have gained since the start."""
    return _since_start(result, _of_parts(result))


def given_impulses(result: Result) -> dict[str, MomentumCourse]:
    """Impulses of prescribed bodies and of effects from outside since the start."""
    return _since_start(result, _given(result))


def direction(changes: Mapping[str, Floats]) -> Floats:
    """(3,) unit vector of the largest of some changes (t, 3), its largest part positive; x without any."""
    found = max(changes.values(), key=lambda change: float(np.linalg.norm(change, axis=1).max()))
    row = found[int(np.linalg.norm(found, axis=1).argmax())]
    size = float(np.linalg.norm(row))
    if size == 0.0:
        return np.array([1.0, 0.0, 0.0])
    return np.asarray(row / size * np.sign(row[int(np.abs(row).argmax())])) + 0.0


def _of_parts(result: Result) -> dict[str, MomentumCourse]:
    found, mass = {}, result.net.mass.copy()
    for name, body in result.bodies.items():
        if body.nodes is not None:
            mass[body.nodes] = 0.0  # which the body has
        if f"{name}/impulse" not in result.states:
            found[name] = MomentumCourse(*momenta_of(body))
    if mass.any():
        linear, angular = [], []
        for position, velocity in zip(blocks(result.position), blocks(result.velocity), strict=True):
            linear.append(np.einsum("n,tna->ta", mass, velocity))
            angular.append(np.einsum("n,tna->ta", mass, np.cross(position, velocity)))
        found[NET] = MomentumCourse(np.concatenate(linear), np.concatenate(angular))
    return found


def _given(result: Result) -> dict[str, MomentumCourse]:
    guided = [name for name in result.bodies if f"{name}/impulse" in result.states]
    names = {
        **{name: name for name in guided},
        **{effect: OUTSIDE + effect for effect in effects_of(result.states)},
    }
    return {
        GIVEN_BY + name: MomentumCourse(
            *(np.asarray(result.states[f"{key}/{item}"].values[:]) for item in ("impulse", "angular_impulse"))
        )
        for name, key in names.items()
    }


def _since_start(result: Result, momenta: Mapping[str, MomentumCourse]) -> dict[str, MomentumCourse]:
    """Changes since the start, before an ejection at time 0: the throw is part of the run."""
    bodies, outside = list(result.bodies), effects_of(result.states)
    guided = [name for name in bodies if f"{name}/impulse" in result.states]
    start = momenta_at_start(ends_of_result(result), bodies, guided, outside)
    before = dict(zip(part_names(bodies, guided, outside), start, strict=True))
    return {
        name: MomentumCourse(one.linear - before[name][:3], one.angular - before[name][3:])
        for name, one in momenta.items()
    }
