"""Measures of a result: areas, the four measures of deployment, bullet speeds, the energy balance.

Two areas of a net are distinguished:

- the **mouth area** is the area of the closed polygon through the net's corner knots. When its corners do
  not lie in a plane, it is triangulated as a fan from the mean of its corners, and the area is the sum of the
  areas of the triangles. It says how much a net has opened; the four measures of deployment use it.
- the **mesh area** is the sum over all mesh openings of the opening's area, each triangulated in the same way
  from the mean of its nodes. Each opening counts as positive, so where the net is folded, layers that lie on
  each other count twice.

Both areas are unsigned and do not change when the net is moved or turned. They are exact for flat polygons
that are seen whole from the mean of their corners (all convex ones); others come out too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from exunet.net.arrays import Net
from exunet.results.result import Result
from exunet.results.rows import over_blocks

Floats = NDArray[np.float64]

_AT_ONCE = 2**12  # loops times states, for arrays that stay in the processor's cache
NEARLY_OPEN = 0.8  # part of the largest achievable area above which a net counts as deployed, paper sec. 4


@dataclass(frozen=True)
class Deployment:
    """The four measures of deployment of Botta et al. and Shan et al. (paper, section 4).

    largest_area    : the largest mouth area at a stored time [m2]
    time_of_largest : the time it takes to reach it: the first stored time with that area [s]
    distance        : straight distance between the net's centre of mass at the first stored time and at
                      `time_of_largest` [m] (not the length of its path)
    time_open       : total time during which the mouth area exceeds 80 % of `reference_area` [s]; the area is
                      taken as linear between stored times
    reference_area  : the largest achievable area: that of the mouth in the reference configuration [m2]
    relative_area   : largest_area / reference_area
    at_end          : the largest area is that of the last stored time, so the net may still be opening
    """

    largest_area: float
    time_of_largest: float
    distance: float
    time_open: float
    reference_area: float
    relative_area: float
    at_end: bool


def mouth_area(net: Net, position: Floats) -> Floats:
    """Area of the net's mouth [m2]; position (..., n_nodes, 3) [m] -> (...).

    The mouth is the closed polygon through the net's corner knots, triangulated as a fan from the mean of its
    corners; its area is the sum of the areas of the triangles. Zero for a net without a mouth.
    """
    return _loops_area((net.mouth,), position)


def mesh_area(net: Net, position: Floats) -> Floats:
    """Sum of the areas of the net's mesh openings [m2]; position (..., n_nodes, 3) [m] -> (...).

    Each opening is triangulated as a fan from the mean of its nodes and counts as positive: where the net is
    folded, layers that lie on each other count twice. Zero for a net without openings.
    """
    return _loops_area(net.faces, position)


def centre_of_mass(result: Result) -> Floats:
    """Centre of mass of net, strings and bullets, without other bodies: (n_times, 3) [m]."""
    return over_blocks(partial(_centre, result.net), result.position)


def _centre(net: Net, position: Floats) -> Floats:
    # By an element: in files of format 1 a chaser is the last node of the net, which no element holds.
    held = np.zeros(net.n_nodes, dtype=bool)
    held[net.element_nodes] = True
    mass = np.where(held, net.mass, 0.0) if held.any() else net.mass
    return np.einsum("n,tnk->tk", mass / mass.sum(), position)


def bullet_speeds(result: Result) -> Floats:
    """Speeds of the bullets, in the order of `net.bullet_nodes`: (n_times, n_bullets) [m/s]."""
    bullets = result.net.bullet_nodes
    return over_blocks(lambda velocity: np.linalg.norm(velocity[:, bullets], axis=-1), result.velocity)


def deployment(result: Result) -> Deployment | None:
    """The four measures of deployment, also of an incomplete result (over its stored times).

    None for a net without a mouth, or with a mouth of no area in the reference configuration.
    """
    return deployment_of(result.net, result.time, result.position)


def deployment_of(net: Net, time: Floats, position: Floats) -> Deployment | None:
    """`deployment` of a trajectory of either code; time (t,) [s], position (t, n_nodes, 3) [m]."""
    reference = float(mouth_area(net, net.reference_position))
    if reference == 0.0:
        return None
    area = over_blocks(partial(mouth_area, net), position)
    at = int(np.argmax(area))
    centre = _centre(net, position[np.array([0, at])])
    return Deployment(
        largest_area=float(area[at]),
        time_of_largest=float(time[at]),
        distance=float(np.linalg.norm(centre[1] - centre[0])),
        time_open=time_above(time, area, NEARLY_OPEN * reference),
        reference_area=reference,
        relative_area=float(area[at]) / reference,
        at_end=at == len(area) - 1,
    )


def time_above(time: Floats, values: Floats, level: float) -> float:
    """Total time [s] during which `values`, linear between the times (both (n,)), exceed `level`."""
    low = np.minimum(values[:-1], values[1:]) - level
    high = np.maximum(values[:-1], values[1:]) - level
    rise = np.where(high > low, high - low, 1.0)
    part = np.where(low > 0, 1.0, np.maximum(high, 0.0) / rise)
    return float(part @ np.diff(time))


def energy_balance(result: Result) -> float:
    """Largest error of the energy balance at the stored times, over the energy that can deform the net.

    The error is |K + U + V + W - (K + U + V + W at the first stored time)|, with the kinetic, elastic and
    potential energies K, U, V and the dissipated work W; for the divisor see `energy_scale`. If that is
    zero (a net at rest without loads), it is the largest of K, U and |W|; if that is zero too, nothing ever
    moved and the error is 0. So it is where it is no more than the round-off of V.
    """
    kinetic, elastic, potential = result.kinetic, result.elastic, result.potential
    total = kinetic + elastic + (potential - potential[0]) + result.dissipated
    scale = energy_scale(result)
    if scale == 0.0:
        scale = float(np.max([kinetic, elastic, np.abs(result.dissipated)]))
    error = float(np.max(np.abs(total - total[0])))
    return error / scale if error > 1e-14 * float(np.max(np.abs(potential))) else 0.0


def energy_scale(result: Result) -> float:
    """Energy [J] that could deform the net, over the stored times: what errors of the energy are measured by.

    A run tells it (see `exunet.system.energy_scale`): kinetic and elastic energy at the start without the
    translation of free parts, plus what potentials and forces have brought beside the work on their
    centres of mass. Of a result that does not tell, it is the initial K + U plus the largest change of V
    (V itself depends on the choice of the origin) and the largest work -W that forces have put in.
    """
    for name in ("energy_scale_J", "energy_in_play_J"):  # the second is what older files say
        if name in result.provenance:
            return float(result.provenance[name])
    change = float(np.max(np.abs(result.potential - result.potential[0])))
    put_in = float(np.max(-result.dissipated, initial=0.0))
    return float(result.kinetic[0] + result.elastic[0]) + change + put_in


def _loops_area(loops: Sequence[tuple[int, ...]], position: Floats) -> Floats:
    """Sum of the areas of closed loops of nodes, each a fan of triangles from the mean of its nodes."""
    groups: dict[int, list[tuple[int, ...]]] = {}
    for loop in loops:
        groups.setdefault(len(loop), []).append(loop)
    axes = np.moveaxis(position, -1, 0).reshape(3, -1, position.shape[-2])  # (3, n_states, n_nodes)
    area = np.zeros(axes.shape[1])
    for length, group in groups.items():
        if length > 2:
            nodes = np.array(group)
            many = max(1, _AT_ONCE // len(nodes))
            for at in range(0, len(area), many):
                area[at : at + many] += _fans(axes[:, at : at + many], nodes)
    return area.reshape(position.shape[:-2])


def _fans(axes: Floats, nodes: NDArray[np.int64]) -> Floats:
    """(n_states,) areas of loops, summed; axes (3, n_states, n_nodes) [m], nodes (n_loops, n_corners)."""
    corners = [axes[:, :, nodes[:, k]] for k in range(nodes.shape[1])]
    mean = sum(corners[1:], corners[0]) / len(corners)
    spokes = [corner - mean for corner in corners]
    doubled = np.zeros(axes.shape[1])
    for (ax, ay, az), (bx, by, bz) in zip(spokes, spokes[1:] + spokes[:1], strict=True):
        across = (ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2
        doubled += np.sqrt(across).sum(axis=-1)
    return 0.5 * doubled
