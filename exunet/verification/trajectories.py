"""Trajectories of both codes up to the horizon, and their energy and momentum balances."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from exunet.forces.effects.contact import Contact
from exunet.model.energy import kinetic
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.studies.ensemble import tracked_speeds
from exunet.verification.check import Check, Finding, difference, skipped
from exunet.verification.figures import curves, picture
from exunet.verification.horizon import Growth, best_plan, distances, growth, sensitivity
from exunet.verification.tolerances import (
    ANGULAR,
    BOOKED,
    CLOSED_ENERGY,
    CLOSED_RUN,
    CLOSED_WORK,
    CONNECTIVITY,
    CONTACT_RUN,
    CONVERGED,
    DISSIPATED,
    ENERGY,
    LEFT_OUT,
    MOMENTUM,
    TRAJECTORY,
    Tolerance,
)
from reference_impl import energy


@dataclass(frozen=True, eq=False)
class ConservedQuantity:
    """Conserved quantity: values (t, 1) or (t, 3), scale and tolerance of its changes."""

    name: str
    unit: str
    values: Floats
    scale: float
    tolerance: Tolerance


def momenta(
    case: BothCodes, motion: Trajectory, linear: Tolerance, angular: Tolerance
) -> list[ConservedQuantity]:
    """Return momentum and angular momentum about the origin, less what prescribed bodies gave.

    By the formulas of the reference, which are compared with those of exunet at random states. Scales are the
    largest sums over nodes and bodies of |m v|, and of |m x x v| and |J w|.
    """
    system, seen = case.theirs.system, motion.seen
    (x, v), bodies = seen.particles, seen.bodies
    mass = np.append(system.net.own_mass, system.bodies.free * system.bodies.mass)
    shares = mass[:, None] * v
    free = system.bodies.free[:, None, None] * system.bodies.inertia
    spin = np.einsum("bij,tbj->tbi", free, bodies.angular_velocity)
    turning = np.concatenate([np.cross(x, shares), spin], axis=1)
    scales = (float(np.linalg.norm(parts, axis=2).sum(axis=1).max()) for parts in (shares, turning))
    total = energy.momentum(system, seen.v, bodies)
    turned = energy.angular_momentum(system, seen.x, seen.v, bodies)
    if motion.given is not None:
        total, turned = total - motion.given[:, :3], turned - motion.given[:, 3:]
    return [
        ConservedQuantity("momentum", "N s", total, next(scales), linear),
        ConservedQuantity("angular momentum", "N m s", turned, next(scales), angular),
    ]


def energies(case: BothCodes, motion: Trajectory, tolerance: Tolerance) -> ConservedQuantity:
    """Return kinetic, elastic, potential and dissipated energy of a run that recorded the latter.

    Changes are parts of the largest kinetic energy.
    """
    system, seen = case.theirs.system, motion.seen
    intact = np.ones((len(motion.time), case.start.net.n_elements), dtype=bool)
    for item in motion.breaks:
        intact[motion.time >= item.time, case.reference_elements[item.element]] = False
    inside, outlets = energy.at_outlets(system, seen.x, motion.reels)
    others, closing = energy.of_closing(system, seen.x, motion.drawn)
    for some in (inside, others):
        if some is not None:
            intact &= some
    moving = energy.kinetic(system, seen.v, seen.bodies)
    total = moving + energy.elastic(system, seen.x, intact) + outlets + closing
    total = total + energy.potential(system, seen.x, seen.bodies)
    if motion.dissipated is not None:
        total = total + motion.dissipated
    return ConservedQuantity("energy", "J", total[:, None], float(moving.max()), tolerance)


def conserved(case: BothCodes, motion: Trajectory, linear: Tolerance = MOMENTUM) -> list[ConservedQuantity]:
    """Return momenta and energy of a run without external forces."""
    return [*momenta(case, motion, linear, ANGULAR), energies(case, motion, ENERGY)]


def changes(balances: list[ConservedQuantity], times: Floats, code: str) -> Iterator[Check]:
    """Check the largest change of each balance at the given times."""
    for balance in balances:
        change = np.linalg.norm(balance.values[: len(times)] - balance.values[0], axis=1)
        at = int(np.argmax(np.where(np.isnan(change), np.inf, change)))
        axis = int(np.argmax(np.abs(balance.values[at] - balance.values[0])))
        numbers = float(balance.values[at][axis]), float(balance.values[0][axis])
        name, where = f"{balance.name}, {code}: relative change", f"t = {times[at]:.4g} s [{balance.unit}]"
        yield Check(name, float(change[at]) / balance.scale, balance.tolerance, where, *numbers)


INSTANTS = 48  # compared times, evenly spaced up to the horizon
SHOWN_PAST = 1.2  # of the horizon
OWN = (4e-11, 4e-12)  # tolerances of exunet's DOPRI5, see `best_plan`; below, round-off takes over
# rtol, atol of the reference's DOP853, two at a time: smaller ones where the larger ones do not converge.
THEIRS = ((1e-8, 1e-10), (1e-10, 1e-12), (1e-12, 1e-13))
INTERNAL = {"material_damping", "breaking", "bending", "thermal_strain"}  # effects without external forces
BOOST = (1.0, 0.3, 0.7)  # [m/s], added to all nodes; along no axis of symmetry


def whole_run(case: BothCodes, end: float | None = None) -> Iterator[Finding]:
    """Follow a case up to its horizon in both codes, and measure the horizon."""
    grown = growth(case, end)
    yield from converged(case, grown)
    yield from sensitivity(case, grown)


def boosted_run(case: BothCodes) -> Iterator[Finding]:
    """Follow a case in a moving frame, where a symmetric start does not keep the codes together."""
    if moving := boosted(case):
        yield from converged(moving, growth(case))


def boosted(case: BothCodes) -> BothCodes | None:
    """Return the case in a frame that moves at -`BOOST`: the same motion with other round-off, not symmetric.

    None with fixed nodes, which cannot move along.
    """
    if len(case.start.net.fixed_nodes):
        return None
    start, boost = case.start, np.array(BOOST)
    bodies = replace(start.state.bodies, velocity=start.state.bodies.velocity + boost)
    flying = case.from_state(start.position, start.velocity + boost, bodies)
    return replace(flying, name=f"{case.name}, boosted")


def converged(case: BothCodes, grown: Growth) -> Iterator[Finding]:
    """Compare positions and bullet speeds up to the horizon, while each code agrees with itself.

    Each code runs at two tolerances, a factor of ten or more apart, the reference at the largest two that
    converge up to the horizon: exunet on the fastest backend, and at the
    smaller tolerance in Exudyn too. Instants at which a code has not converged are left out, in a row.
    """
    end = min(grown.horizon, float(grown.time[-1]))
    spacing = end / INSTANTS
    later = np.arange(spacing, min(SHOWN_PAST * end, float(grown.time[-1])) - end + 1e-9 * end, spacing)
    times = np.concatenate([np.linspace(0.0, end, INSTANTS + 1), end + later])
    theirs: list[Trajectory] = []
    for rtol, atol in THEIRS:
        theirs = [*theirs[-1:], case.run_reference(times, rtol=rtol, atol=atol)]
        if len(theirs) == 2 and _kept(own_errors(case, *theirs)[:, : INSTANTS + 1]) > INSTANTS:
            break
    fast = case.fastest()
    ours = [fast.run_exunet(times, best_plan(case, tolerance), booked=True) for tolerance in OWN]
    own = np.array([own_errors(case, *ours), own_errors(case, *theirs)])[..., : INSTANTS + 1]
    runs = {fast.name: ours[-1]}
    if fast is not case:
        runs[case.name] = case.run_exunet(times, best_plan(case, OWN[-1]), booked=True)
    for name, run in runs.items():
        for check in (
            *compared(case, own, run, theirs[-1], grown.horizon),
            *_dissipated_and_broken(case, own, run, theirs[-1]),
            *_balances(case, own, "exunet", run),
        ):
            yield replace(check, subject=name)
    yield from _balances(case, own, "reference", theirs[-1])
    apart = {"exunet and reference": distances(ours[-1], theirs[-1]).max(axis=1)}
    apart["reference at two tolerances"] = distances(*theirs).max(axis=1)
    title = f"{case.name}: distance between the codes, each with its best method"
    figure = curves(title, times, apart, grown.horizon)
    caption = f"{case.name}: largest distance of a node between the codes. Compared up to the horizon."
    yield picture(f"trajectories_{case.name}", figure, caption)


def own_errors(case: BothCodes, a: Trajectory, b: Trajectory) -> Floats:
    """Return the largest differences (2, t) of a position and a bullet speed, of size and launch speed."""
    net = case.start.net
    speeds = np.abs(tracked_speeds(net, a.velocity) - tracked_speeds(net, b.velocity)).max(axis=1)
    return np.array([distances(a, b).max(axis=1) / case.size, speeds / case.speed])


def _kept(own: Floats) -> int:
    """Return the number of instants at which own errors (..., t) of all codes are within `CONVERGED`."""
    unconverged = np.flatnonzero(~(own.reshape(-1, own.shape[-1]).max(axis=0) <= CONVERGED.value))
    return int(unconverged[0]) if len(unconverged) else own.shape[-1]


def compared(
    case: BothCodes, own: Floats, ours: Trajectory, theirs: Trajectory, horizon: float
) -> Iterator[Check]:
    """Compare two motions while both codes have converged.

    own : (2, 2, t) differences between the tolerances of each code, as `own_errors`

    An own error that is not finite, or that exists at the start, where nothing has been calculated, fails.
    """
    times, end = ours.time, float(ours.time[own.shape[-1] - 1])
    for name, errors in zip(("positions", "bullet speeds"), own.max(axis=0), strict=True):
        kept = _kept(errors)
        if kept == 0 or not np.isfinite(errors).all():
            at = int(np.argmax(~np.isfinite(errors)))  # 0 if all are finite
            yield Check(
                f"{name}: own error of a code", float(errors[at]), CONVERGED, f"t = {times[at]:.4g} s"
            )
            if kept == 0:
                continue
        if kept < len(errors):
            what = f"of the time to {'the horizon' if math.isfinite(horizon) else 'the end'}, t = {end:.4g} s"
            where = f"own error of a code at t = {times[kept]:.4g} s: {errors[kept]:.2g}"
            share = 1.0 - float(times[kept - 1]) / end
            required = name == "positions" and share > LEFT_OUT.value
            if required and not math.isfinite(horizon):
                excused, more = _within_own(case, own[:, 0], ours, theirs, kept)
                required, where = not excused, where + more
            if required:
                yield Check(f"{name}: part not compared {what}", share, LEFT_OUT, where)
            else:
                yield skipped(f"{name}: {share:.0%} {what}", where)
        until = f"{name}, {kept - 1} instants to t = {times[kept - 1]:.4g} s"
        if name == "positions":
            gap = distances(ours, theirs)[:kept]
            at, node = (int(k) for k in np.unravel_index(int(np.argmax(gap)), gap.shape))
            axis = int(np.argmax(np.abs(ours.position[at, node] - theirs.position[at, node])))
            numbers = float(ours.position[at, node, axis]), float(theirs.position[at, node, axis])
            where = f"t = {times[at]:.4g} s, node {node}, {'xyz'[axis]} [m]"
            yield Check(until, float(gap[at, node]) / case.size, TRAJECTORY, where, *numbers)
        else:
            a, b = (tracked_speeds(case.start.net, run.velocity)[:kept] for run in (ours, theirs))
            yield difference(until, a, b, TRAJECTORY, ("instant", "bullet"), "m/s", scale=case.speed)


def _dissipated_and_broken(
    case: BothCodes, own: Floats, ours: Trajectory, theirs: Trajectory
) -> Iterator[Check]:
    """Compare dissipated energy and broken elements, while both codes have converged.

    Energies are parts of the largest kinetic energy until then, or of the dissipated energy if that is more.
    """
    kept = _kept(own[:, 0])
    if kept == 0 or ours.dissipated is None or theirs.dissipated is None:
        return
    end, a, b = ours.time[kept - 1], ours.dissipated[:kept], theirs.dissipated[:kept]
    if a.any() or b.any():
        mass = case.start.system.mass
        moving = float(kinetic(mass, theirs.velocity[:kept, : len(mass)]).max())
        largest = max(moving, float(np.abs(a).max()), float(np.abs(b).max()))
        name = f"dissipated energy to t = {end:.4g} s"
        yield difference(name, a, b, DISSIPATED, ("instant",), "J", scale=largest)
    first, second = (
        {item.element: item.time for item in run.breaks if item.time <= end} for run in (ours, theirs)
    )
    if first or second:
        where = f"{len(first)} elements: {sorted(first)[:8]} and {len(second)}: {sorted(second)[:8]}"
        apart = len(first.keys() ^ second.keys())
        yield Check("elements that broke in one code only", apart, CONNECTIVITY, where)
        both = sorted(first.keys() & second.keys())
        when, other = (np.array([times[element] for element in both]) for times in (first, second))
        crossing = case.size / case.speed
        yield difference("time of breaking", when, other, TRAJECTORY, ("break",), "s", scale=crossing)


def _balances(case: BothCodes, own: Floats, code: str, motion: Trajectory) -> Iterator[Check]:
    """Check the balances of a scene with rigid bodies while both codes have converged.

    Those of a net alone are a known answer.
    """
    kept = _kept(own[:, 0])
    if kept and case.start.system.bodies:
        summed = code == "exunet" and case.start.system.forces.cable.viscous
        found = [energies(case, motion, BOOKED if summed else ENERGY)]
        outside = case.start.system.kinematics.motions or case.theirs.system.propelled
        if case.effects <= INTERNAL and not outside:
            found += momenta(case, motion, MOMENTUM, ANGULAR)
        yield from changes(found, motion.time[:kept], code)


def _within_own(
    case: BothCodes, own: Floats, ours: Trajectory, theirs: Trajectory, kept: int
) -> tuple[bool, str]:
    """Return whether the codes differ by no more than their own errors together from instant `kept` on.

    own : (2, t) of positions; an error remains once it is there, even if two tolerances happen to meet

    Where nothing grows, kinks of the force may still keep a code from converging. Both errors bound the
    difference of two right codes (triangle inequality), not that of a wrong code from a right one.
    """
    allowed = np.maximum.accumulate(own, axis=1).sum(axis=0)[kept:]
    gap = distances(ours, theirs).max(axis=1)[kept : own.shape[1]] / case.size
    outside = np.flatnonzero(~(gap <= allowed))
    at = int(outside[0]) if len(outside) else int(np.argmax(gap))
    more = "more" if len(outside) else "no more"
    return not len(outside), (
        f"; from there on the codes differ by {more} than their own errors together, at "
        f"t = {ours.time[kept + at]:.4g} s {gap[at]:.2g} and {allowed[at]:.2g}"
    )


def closing_run(case: BothCodes, end: float | None = None) -> Iterator[Check]:
    """Compare positions, length wound up, its work and energies over a run with a closing, to its horizon."""
    grown = growth(case, end)
    end = min(grown.horizon, float(grown.time[-1]))
    times = np.linspace(0.0, end, INSTANTS // 4 + 1)
    ours = case.fastest().run_exunet(times, best_plan(case, OWN[1]), booked=True)
    rtol, atol = THEIRS[1]
    theirs = case.run_reference(times, rtol=rtol, atol=atol)
    until = f"to t = {end:.3g} s"
    a, b, axes = ours.position, theirs.position, ("instant", "point", "xyz")
    yield difference(f"positions {until}", a, b, CLOSED_RUN, axes, "m", scale=case.size)
    what, unit = ("part left", "") if case.start.system.line is None else ("length wound up", "m")
    lines = ("instant", "line")
    yield difference(f"{what} {until}", ours.drawn.amount, theirs.drawn.amount, CLOSED_RUN, lines, unit)
    yield difference(
        f"work of the closing {until}", ours.drawn.work, theirs.drawn.work, CLOSED_WORK, lines, "J"
    )
    moving = energies(case, theirs, CLOSED_ENERGY).scale
    if ours.dissipated is not None and theirs.dissipated is not None:
        left = ours.dissipated, theirs.dissipated
        yield difference(f"dissipated energy {until}", *left, DISSIPATED, ("instant",), "J", scale=moving)
    # Exunet sums viscous work by Simpson's rule (see `BOOKED`): the dissipated energy is compared above.
    codes = [("reference", theirs)]
    if not case.start.system.forces.cable.viscous:
        codes.append(("exunet", ours))
    for code, motion in codes:
        yield from changes([energies(case, motion, CLOSED_ENERGY)], times, code)


def contact_run(case: BothCodes, end: float | None = None) -> Iterator[Check]:
    """Compare positions of nodes and body at four times of a run with contact, on the fastest backend."""
    contact = case.start.scene.effects.get(Contact)
    if contact is not None and contact.threads and case.start.net.n_elements > 1:
        yield skipped("a run", "the reference takes many minutes where several threads touch a body")
        return
    times = np.linspace(0.0, end or case.start.scene.time.end, 4)
    a, b = case.fastest().run_exunet(times), case.run_reference(times)
    axes = ("time", "point", "xyz")
    yield difference("positions over a run", a.position, b.position, CONTACT_RUN, axes, "m", scale=case.size)
