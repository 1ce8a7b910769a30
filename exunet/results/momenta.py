"""Momentum of each part of a scene over time, and what effects and bodies of given motion have given."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.from_outside import OUTSIDE, effects_of
from exunet.results.ends import momenta_of
from exunet.results.result import Result
from exunet.results.rows import blocks

Floats = NDArray[np.float64]


class MomentumCourse(NamedTuple):
    """Linear [kg m/s] and angular about the scene's origin [kg m2/s], (t, 3) each, in the scene's axes."""

    linear: Floats
    angular: Floats


def gained_by_parts(result: Result) -> dict[str, MomentumCourse]:
    """What each free body and the net (with tethers and strings) have got since the first stored time."""
    found, mass = {}, result.net.mass.copy()
    for name, body in result.bodies.items():
        if body.nodes is not None:
            mass[body.nodes] = 0.0  # which the body has
        if f"{name}/impulse" not in result.states:
            found[name] = _since_start(*momenta_of(body))
    if mass.any():
        linear, angular = [], []
        for position, velocity in zip(blocks(result.position), blocks(result.velocity), strict=True):
            linear.append(np.einsum("n,tna->ta", mass, velocity))
            angular.append(np.einsum("n,tna->ta", mass, np.cross(position, velocity)))
        found["net"] = _since_start(np.concatenate(linear), np.concatenate(angular))
    return found


def given_impulses(result: Result) -> dict[str, MomentumCourse]:
    """What bodies of given motion and effects from outside have given since the first stored time."""
    guided = [name for name in result.bodies if f"{name}/impulse" in result.states]
    names = {**{name: name for name in guided}, **{one: OUTSIDE + one for one in effects_of(result.states)}}
    return {
        f"impulse of {name}": _since_start(
            *(np.asarray(result.states[f"{key}/{one}"].values[:]) for one in ("impulse", "angular_impulse"))
        )
        for name, key in names.items()
    }


def _since_start(linear: Floats, angular: Floats) -> MomentumCourse:
    return MomentumCourse(linear - linear[0], angular - angular[0])
