"""Measures of a result: deployment, bullet speeds, peak tensions, balances of energy and momentum."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.base.run_events import NetEjected
from exunet.bodies.kinematics import GIVEN, first_given
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.corner_units import NAME as UNITS
from exunet.forces.effects import EFFECTS
from exunet.forces.from_outside import OUTSIDE, effects_of
from exunet.methods.method import METHODS, Kind
from exunet.net.areas import achievable_area as achievable_area
from exunet.net.areas import mesh_area as mesh_area
from exunet.net.areas import mouth_area as mouth_area
from exunet.net.arrays import Net
from exunet.net.closing import NAME as CLOSING
from exunet.results.result import BodyStates, Result, blocks, over_blocks
from exunet.results.run_record import RunRecord

_ROUND_OFF = 1e-9  # of a quantity: far above round-off, far below what anyone can measure
NEARLY_OPEN = 0.8  # part of the achievable area above which a net counts as deployed, paper sec. 4


@dataclass(frozen=True)
class Deployment:
    """The four measures of deployment of Botta et al. and Shan et al. (paper, section 4).

    largest_area    : the largest mouth area at a stored time [m2]
    time_of_largest : the time it takes to reach it: the first stored time with that area [s]
    distance        : straight distance between the net's centre of mass at the first stored time and at
                      `time_of_largest` [m] (not the length of its path)
    time_open       : total time during which the mouth area exceeds 80 % of `achievable_area` [s]; the area
                      is taken as linear between stored times
    achievable_area : the largest area that the mouth can have with its border taut but not strained [m2], see
                      `exunet.net.areas.achievable_area`
    relative_area   : largest_area / achievable_area
    at_end          : the largest area is that of the last stored time, so the net may still be opening
    constant        : the area stays the same down to round-off, as that of a mouth which a body holds:
                      `time_of_largest` is the first stored time then
    """

    largest_area: float
    time_of_largest: float
    distance: float
    time_open: float
    achievable_area: float
    relative_area: float
    at_end: bool
    constant: bool = False


@takes(result=Result)
def centre_of_mass(result: Result) -> Floats:
    """Centre of mass of net, strings and bullets, without other bodies: (n_times, 3) [m]."""
    return over_blocks(partial(net_centre, result.net), result.position)


def mouth_areas(result: Result) -> Floats:
    """Area of the mouth at each stored time: (n_times,) [m2]; zeros for a net without one."""
    return over_blocks(partial(mouth_area, result.net), result.position)


def net_centre(net: Net, position: Floats) -> Floats:
    """Centre of mass of net, strings and bullets, without tethers, in each state: (t, 3) [m].

    position : (t, n_nodes, 3) [m]
    """
    # By an element: in files of format 1 a chaser is the last node of the net, which no element holds.
    held = np.zeros(net.n_nodes, dtype=bool)
    held[net.element_nodes[: net.n_net_elements]] = True
    mass = np.where(held, net.mass, 0.0) if held.any() else net.mass
    return np.einsum("n,tnk->tk", mass / mass.sum(), position)


@takes(result=Result)
def bullet_speeds(result: Result) -> Floats:
    """Speeds of the bullets, in the order of `net.bullet_nodes`: (n_times, n_bullets) [m/s]."""
    return over_blocks(partial(speeds_of, result.net.bullet_nodes), result.velocity)


def speeds_of(nodes: NDArray[np.int64], velocity: Floats) -> Floats:
    """Speeds of some nodes (k,) with velocities (t, n, 3) [m/s]: (t, k) [m/s]."""
    return np.asarray(np.linalg.norm(velocity[:, nodes], axis=-1))


@takes(result=Result)
def deployment(result: Result) -> Deployment | None:
    """The four measures of deployment, also of an incomplete result (over its stored times).

    None for a net without a mouth, or with a mouth that cannot have an area.
    """
    area, centre = mouth_areas(result), centre_of_mass(result)
    return deployment_from_area(result.time, area, centre, achievable_area(result.net))


def deployment_from_area(time: Floats, area: Floats, centre: Floats, achievable: float) -> Deployment | None:
    """`deployment` from the mouth area (t,) [m2] and the centre of mass (t, 3) [m] at times (t,) [s].

    achievable : the largest area that the mouth can have [m2]
    """
    if not 0.0 < achievable < np.inf:
        return None
    constant = stays_the_same(area)
    at = 0 if constant else int(np.argmax(area))
    return Deployment(
        largest_area=float(area[at]),
        time_of_largest=float(time[at]),
        distance=float(np.linalg.norm(centre[at] - centre[0])),
        time_open=time_above(time, area, NEARLY_OPEN * achievable),
        achievable_area=achievable,
        relative_area=float(area[at]) / achievable,
        at_end=at == len(area) - 1,
        constant=constant,
    )


def stays_the_same(values: Floats) -> bool:
    """True of two and more values (t,) that differ by round-off alone: none of them is the largest."""
    return len(values) > 1 and float(np.ptp(values)) <= _ROUND_OFF * float(np.max(np.abs(values)))


@takes(result=Result)
def peak_tensions(result: Result) -> Floats:
    """Largest tension of each element: (n_elements,) [N].

    Of all steps of a run; of a result without them (`RunRecord.peak_tensions_N`) of the stored times,
    between which a snap may be higher.
    """
    if result.run.peak_tensions_N is not None:
        return np.array(result.run.peak_tensions_N)
    peaks = np.zeros(result.net.n_elements)
    for block in blocks(result.tension):
        np.maximum(peaks, block.max(axis=0), out=peaks)
    return peaks


@takes(result=Result)
def largest_tensions(result: Result) -> Floats:
    """Largest tension of all elements at each stored time: (n_times,) [N]."""
    return over_blocks(lambda tension: tension.max(axis=1, initial=0.0), result.tension)


def time_above(time: Floats, values: Floats, level: float) -> float:
    """Total time [s] during which `values`, linear between the times (both (n,)), exceed `level`."""
    low = np.minimum(values[:-1], values[1:]) - level
    high = np.maximum(values[:-1], values[1:]) - level
    rise = np.where(high > low, high - low, 1.0)
    part = np.where(low > 0, 1.0, np.maximum(high, 0.0) / rise)
    return float(part @ np.diff(time))


def energy_errors(result: Result) -> Floats:
    """(n_times,) error of the energy balance at the stored times [J].

    It is K + U + V + W less the same at the first of them, with the kinetic, elastic and potential energies
    K, U, V and the dissipated work W.
    """
    kinetic, elastic, potential = result.kinetic, result.elastic, result.potential
    total = kinetic + elastic + (potential - potential[0]) + result.dissipated
    return np.asarray(total - total[0])


@takes(result=Result)
def energy_balance(result: Result) -> float:
    """Largest error of the energy balance at the stored times, over `energy_divisor`.

    For the error see `energy_errors`. It is 0 where nothing ever moved, and where it is no more than the
    round-off of V.
    """
    return balance_error(result)


def balance_error(states: Any) -> float:
    """The same, also of states of another code that have the names of a result."""
    error = float(np.max(np.abs(energy_errors(states))))
    return error / energy_divisor(states) if error > 1e-14 * float(np.max(np.abs(states.potential))) else 0.0


def energy_divisor(result: Result) -> float:
    """Return the energy that the error of the energy balance is divided by [J].

    It is `energy_scale`. If that is zero (nothing deforms the net, or hardly anything, see `Guards.scale`),
    it is the largest of K, U and |W| at the stored times, with the bodies that no force acts on.
    """
    if scale := energy_scale(result):
        return scale
    return float(np.max([result.kinetic, result.elastic, np.abs(result.dissipated)]))


def dissipation(result: Result) -> Floats:
    """Energy that damping, drag, breaks and nodes that drums take have taken out: (n_times,) [J].

    `result.dissipated` counts the work that is put in against it: that of drums on their tethers, of bodies
    whose motion is given, of a winch, of the thrusters of corner units, and of the ejection of a net. Here it
    does not. What a force without a potential
    puts in, such as a thrust, is counted against it here too.
    """
    taken = np.asarray(result.dissipated[:], dtype=float)
    for work in works_put_in(result).values():
        taken = taken + work
    return taken


def works_put_in(result: Result) -> dict[str, Floats]:
    """(n_times,) work [J] of each reel, body whose motion is given, closing line, units; of an ejection.

    By what did it, in the words of a figure; zeros until it does any.
    """
    sources = {name: f"reel {name}" for name in result.net.tether_elements}
    sources |= {name: name for name in result.bodies}
    sources |= {CLOSING: "closing", UNITS: "corner units"}
    sources |= {OUTSIDE + name: name for name in effects_of(result.states)}
    found = {}
    for name, words in sources.items():
        if (work := result.states.get(f"{name}/work")) is not None:
            found[words] = np.asarray(work.values[:], dtype=float)[:, 0]
    if result.run.ejections:
        found["ejection"] = ejected(result.time, result.run)
    return found


def ejected(time: Floats, run: RunRecord) -> Floats:
    """(t,) work [J] of the ejection of the net until these times."""
    work = np.zeros(len(time))
    for event in run.ejections:
        work[time >= event.time_s] -= event.energy_lost_J or 0.0
    return work


def work_of_ejection(run: RunRecord) -> float | None:
    """All of it [J]; None of a run that has none, or had none so far."""
    return float(ejected(np.array([np.inf]), run)[0]) if run.ejections else None


class MomentumBook(NamedTuple):
    """Balance of the linear momentum [kg m/s], or of the angular one about the scene's origin [kg m2/s].

    gained   : largest change since the start, less what bodies of given motion have given: the impulse of
               forces from outside, or error
    residual : largest of this less the impulses that the run has kept of effects, of forces of a script and
               of what holds nodes of net.fixed: error, or what has no line, as forces by `set_force`
    size     : of which errors are parts: the largest sum over nodes and bodies of |m v|, or of |m x x v| and
               |J w|, which is not zero where the parts cancel
    """

    gained: float
    residual: float
    size: float


def all_have_lines(result: Result) -> bool:
    """Whether each external force has a line in the balance of momentum: the rest is then error.

    So it is in scenes with rigid bodies, by methods that have first-order states.
    """
    plan = result.run.plan
    if plan is None or METHODS[plan.method].kind == Kind.IMPLICIT:
        return False
    lines = effects_of(result.states)
    effects = result.run.effects
    within = all(effect in lines or (effect in EFFECTS and EFFECTS[effect].INTERNAL) for effect in effects)
    return within and bool(result.bodies)


def momentum_books(result: Result) -> dict[str, MomentumBook]:
    """Compute the balances of "linear" and "angular" momentum at the stored times."""
    found = {}
    sizes = momentum_sizes(result)
    for name, given, values in (
        ("linear", "impulse", result.momentum),
        ("angular", "angular_impulse", result.angular_momentum),
    ):
        values = np.asarray(values[:], dtype=float)
        left = values - _given(result, result.bodies, given)
        rest = left - _given(result, [OUTSIDE + effect for effect in effects_of(result.states)], given)
        gained, residual = (float(np.linalg.norm(item - item[0], axis=1).max()) for item in (left, rest))
        found[name] = MomentumBook(gained, residual, sizes[name])
    return found


def _given(result: Result, names: Iterable[str], quantity: str) -> Floats:
    """(t, 3) of all that have given some."""
    states = (result.states.get(f"{name}/{quantity}") for name in names)
    return sum((np.asarray(state.values[:]) for state in states if state is not None), np.zeros(3))


def momentum_sizes(result: Result) -> dict[str, float]:
    """Return the sizes of the linear and angular momentum, see `MomentumBook`, without prescribed bodies."""
    mass = result.net.mass.copy()
    linear, angular = np.zeros(len(result.time)), np.zeros(len(result.time))
    for name, body in result.bodies.items():
        if body.nodes is not None:
            mass[body.nodes] = 0.0  # which the body has
        if f"{name}/impulse" in result.states:
            continue
        places = (np.asarray(part[:])[:, None] for part in (body.position, body.velocity))
        for total, shares in zip((linear, angular), shares_of(np.array([body.mass]), *places), strict=True):
            total += shares
        angular += np.linalg.norm(np.asarray(body.angular_velocity[:]) @ body.inertia, axis=1)
    first = 0
    for position, velocity in zip(blocks(result.position), blocks(result.velocity), strict=True):
        rows = slice(first, first + len(position))
        for total, shares in zip((linear, angular), shares_of(mass, position, velocity), strict=True):
            total[rows] += shares
        first += len(position)
    return {"linear": float(linear.max()), "angular": float(angular.max())}


def shares_of(mass: Floats, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    """(t,) sums of |m v| and of |m x x v| over points of masses (n,), (t, n, 3) [m], [m/s]."""
    moments = np.cross(position, velocity)
    return np.linalg.norm(velocity, axis=-1) @ mass, np.linalg.norm(moments, axis=-1) @ mass


def moving_mass(result: Result) -> float:
    """Mass of the net and of all bodies [kg]; a node that is fixed to a body counts with the body alone."""
    on_bodies = [body.nodes for body in result.bodies.values() if body.nodes is not None]
    fixed = math.fsum(float(result.net.mass[nodes].sum()) for nodes in on_bodies)
    return float(result.net.mass.sum()) - fixed + math.fsum(body.mass for body in result.bodies.values())


def energy_scale(result: Result) -> float:
    """Energy [J] that could deform the net, over the stored times: what errors of the energy are measured by.

    A run keeps it (see `exunet.simulation.guards`): kinetic and elastic energy at the start without the
    translation of free parts, and without rigid bodies that no force acts on, plus what potentials and
    forces have brought beside the work on their centres of mass. Of a result without it, it is the
    initial K + U plus the largest change of V (V itself depends on the choice of the origin) and the largest
    work -W that forces have put in.
    """
    if result.run.energy_scale_J is not None:
        return result.run.energy_scale_J
    change = float(np.max(np.abs(result.potential - result.potential[0])))
    put_in = float(np.max(-result.dissipated, initial=0.0))
    return float(result.kinetic[0] + result.elastic[0]) + change + put_in


NET = "net"  # name of the net among the parts: all mass that is not a body's
IMPULSE_OF = "impulse of "  # before the name of what has given it


class Totals(NamedTuple):
    """Momentum [kg m/s], angular momentum about the scene's origin [kg m2/s] and energy [J] of a part.

    start : (7,) at the start, before an ejection at time 0, which is part of the run
    end   : (7,) of a free body or of the net, with its kinetic energy; of a prescribed body the impulse,
            angular impulse and work that it has given to all else; of an effect the same, the
            work of thrust on a body only
    """

    start: Floats
    end: Floats


def prescribed(result: Result) -> tuple[str, ...]:
    """Return the names of the bodies whose motion is given."""
    return tuple(name for name in result.bodies if first_given(name) in result.states)


def momenta(result: Result) -> dict[str, Totals]:
    """Compute the parts of the balances of a scene with bodies, in the scene's axes; empty without bodies.

    Free bodies by their names, the net (with strings, bullets and tethers) as "net", and what prescribed
    bodies and external effects have given as "impulse of NAME".
    """
    if not result.bodies:
        return {}
    fixed, mass, rows = prescribed(result), result.net.mass.copy(), [0, len(result.time) - 1]
    values = {}
    for name, body in result.bodies.items():
        if body.nodes is not None:
            mass[body.nodes] = 0.0  # which the body has
        if name not in fixed:
            values[name] = _of_body(body, rows)
    values[NET] = _of_points(mass, result.position[rows], result.velocity[rows])
    given = {name: name for name in fixed} | {name: OUTSIDE + name for name in effects_of(result.states)}
    for name, term in given.items():
        states = (result.states.get(f"{term}/{quantity}") for quantity, *_ in GIVEN)
        parts = [state[rows] for state in states if state is not None]
        work = [] if f"{term}/work" in result.states else [np.zeros((2, 1))]
        values[IMPULSE_OF + name] = np.concatenate([*parts, *work], axis=1)
    starts = {name: part[0] for name, part in values.items()}
    for event in result.run.ejections:
        if event.time_s == 0.0:
            _before_ejection(starts, event)
    return {name: Totals(starts[name], part[1]) for name, part in values.items()}


def _before_ejection(starts: dict[str, Floats], event: NetEjected) -> None:
    """Set the momenta and energies of the start to those before an ejection at time 0."""
    momentum = np.array([*event.net_momentum_gained_kg_m_s, *event.net_angular_momentum_gained_kg_m2_s])
    kinetic = event.net_kinetic_energy_gained_J
    starts[NET] = starts[NET] - np.append(momentum, kinetic)
    if event.body in starts:
        lost = event.energy_lost_J or 0.0
        starts[event.body] = starts[event.body] + np.append(momentum, lost + kinetic)
    else:
        starts[IMPULSE_OF + event.body] = np.zeros(7)


def _of_points(mass: Floats, position: Floats, velocity: Floats) -> Floats:
    """(t, 7) of points of masses (n,), (t, n, 3) [m], [m/s]."""
    linear = np.einsum("n,tna->ta", mass, velocity)
    angular = np.einsum("n,tna->ta", mass, np.cross(position, velocity))
    energy = 0.5 * np.einsum("n,tna,tna->t", mass, velocity, velocity)
    return np.concatenate([linear, angular, energy[:, None]], axis=1)


def _of_body(body: BodyStates, rows: list[int]) -> Floats:
    """(t, 7) of a body, at some stored times."""
    position, velocity = body.position[rows], body.velocity[rows]
    linear, spin = body.mass * velocity, body.angular_velocity[rows]
    turns = spin @ body.inertia
    angular = np.cross(position, linear) + np.einsum(
        "tab,tb->ta", rotation_matrix(body.attitude[rows]), turns
    )
    energy = 0.5 * body.mass * np.einsum("ta,ta->t", velocity, velocity) + 0.5 * np.einsum(
        "ta,ta->t", spin, turns
    )
    return np.concatenate([linear, angular, energy[:, None]], axis=1)
