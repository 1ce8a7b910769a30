"""Trajectories of both codes until the horizon, and their energy and momentum balances."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from exunet.kernels.compile import numba_installed
from exunet.model.energy import kinetic
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.studies.perturbation import tracked_speeds
from exunet.verification.check import Check, Evidence, Plate, difference, left_out
from exunet.verification.figures import curves
from exunet.verification.horizon import BOOST, Growth, at_node, best_plan, boosted, distances
from exunet.verification.tolerances import (
    ANGULAR,
    BOOKED,
    CONNECTIVITY,
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
class Balance:
    """A quantity that stays what it is.

    values  : (t, 1) or (t, 3)
    scale   : what its changes are parts of: the largest sum of the parts' shares
    allowed : of the change
    """

    name: str
    unit: str
    values: Floats
    scale: float
    allowed: Tolerance


def momenta(case: BothCodes, motion: Trajectory, linear: Tolerance, angular: Tolerance) -> list[Balance]:
    """Linear and angular momentum about the origin, of net and bodies, less what guided bodies have given.

    By the reference's formulas, which rung 8 compares with exunet's at random states. Their scales are the
    largest sums over nodes and bodies of |m v|, and of |m x x v| and |J w|, as in the books of a run
    (`exunet.results.measures.MomentumBook`).
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
        Balance("momentum", "N s", total, next(scales), linear),
        Balance("angular momentum", "N m s", turned, next(scales), angular),
    ]


def energies(case: BothCodes, motion: Trajectory, allowed: Tolerance) -> Balance:
    """Kinetic, elastic and potential energy and what was dissipated, of a run that booked it.

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
    kinetic = energy.kinetic(system, seen.v, seen.bodies)
    total = kinetic + energy.elastic(system, seen.x, intact) + outlets + closing
    total = total + energy.potential(system, seen.x, seen.bodies)
    if motion.dissipated is not None:
        total = total + motion.dissipated
    return Balance("energy", "J", total[:, None], float(kinetic.max()), allowed)


def changes(balances: list[Balance], times: Floats, of: str) -> Iterator[Check]:
    """The largest change of each at the first times; of : what runs, such as a code."""
    for balance in balances:
        change = np.linalg.norm(balance.values[: len(times)] - balance.values[0], axis=1)
        at = int(np.argmax(np.where(np.isnan(change), np.inf, change)))
        words = f"t = {times[at]:.4g} s: {balance.values[at]} {balance.unit}, at first {balance.values[0]}"
        yield Check(
            f"{balance.name}, {of}: relative change",
            float(change[at]) / balance.scale,
            balance.allowed,
            words,
        )


INSTANTS = 48  # compared times, evenly spaced up to the horizon
SHOWN_PAST = 1.2  # of the horizon
OWN = (4e-11, 4e-12)  # tolerances of Exudyn's DOPRI5, see `best_plan`; below, round-off takes over
THEIRS = ((1e-10, 1e-12), (1e-12, 1e-13))  # rtol, atol of the reference's DOP853
CLOSED = {
    "material_damping",
    "breaking",
    "bending",
    "thermal_strain",
}  # effects that push nothing from outside


def converged(case: BothCodes, grown: Growth) -> Iterator[Evidence]:
    """Positions and bullet speeds up to the horizon of rung 7, while each code agrees with itself.

    Each code runs at two tolerances, a factor of ten or more apart. Instants at which one of them has not
    converged are left out, and a row says so. exunet's compiled loop is compared too, where Numba is
    installed. As the case starts, its symmetry may keep the codes together after the horizon; the same
    motion seen from a moving frame (`boosted`) is not symmetric, so that is compared too.
    """
    end = min(grown.horizon, float(grown.time[-1]))
    spacing = end / INSTANTS
    later = np.arange(spacing, min(SHOWN_PAST * end, float(grown.time[-1])) - end + 1e-9 * end, spacing)
    times = np.concatenate([np.linspace(0.0, end, INSTANTS + 1), end + later])
    apart: dict[str, Floats] = {}
    for label, start in (("as the case starts", case), (f"moving along at {BOOST} m/s", boosted(case))):
        if start is None:
            continue
        theirs = [start.run_reference(times, rtol=rtol, atol=atol) for rtol, atol in THEIRS]
        forms = (start, start.fastest()) if numba_installed() and start is case else (start.fastest(),)
        for form in forms:
            ours = [form.run_exunet(times, best_plan(start, tolerance), booked=True) for tolerance in OWN]
            own = np.array([_own(start, *ours), _own(start, *theirs)])[..., : INSTANTS + 1]
            for check in (
                *_compared(form, own, ours[-1], theirs[-1], grown.horizon),
                *_books(form, own, ours[-1], theirs[-1]),
                *_balances(form, own, "exunet", ours[-1]),
                *(_balances(form, own, "reference", theirs[-1]) if form is forms[0] else ()),
            ):
                yield replace(check, subject=form.name)
            apart.setdefault(label, distances(ours[-1], theirs[-1]).max(axis=1))
    title = f"{case.name}: the two codes, each with its best method"
    figure = curves(title, times, apart, grown.named_horizon)
    caption = (
        f"{case.name}: distance between the codes. A symmetric start may keep them together for longer than "
        "the horizon allows, since the errors of integrators are symmetric too; in a moving frame the motion "
        "is the same (but for forces that depend on the speed), its round-off and the steps are not."
    )
    yield Plate(f"trajectories_{case.name}", figure, caption)


def _own(case: BothCodes, a: Trajectory, b: Trajectory) -> Floats:
    """(2, t) largest differences of a position and of a bullet's speed, of size and launch speed."""
    net = case.start.net
    speeds = np.abs(tracked_speeds(net, a.velocity) - tracked_speeds(net, b.velocity)).max(axis=1)
    return np.array([distances(a, b).max(axis=1) / case.size, speeds / case.speed])


def _compared(
    form: BothCodes, own: Floats, ours: Trajectory, theirs: Trajectory, horizon: float
) -> Iterator[Check]:
    """own : (2, 2, t) for each code the differences between its own tolerances, as `_own`.

    An error of its own that is NaN or infinite, or that is there at the start, where nothing has been
    calculated, fails.
    """
    times, end = ours.time, float(ours.time[own.shape[-1] - 1])
    for name, errors in zip(("positions", "bullet speeds"), own.max(axis=0), strict=True):
        unconverged = np.flatnonzero(~(errors <= CONVERGED.value))
        kept = int(unconverged[0]) if len(unconverged) else len(errors)
        if kept == 0 or not np.isfinite(errors).all():
            at = int(np.argmax(~np.isfinite(errors)))  # 0 if all are finite
            words = f"t = {times[at]:.4g} s"
            yield Check(f"{name}: a code's own error", float(errors[at]), CONVERGED, words)
            if kept == 0:
                continue
        if kept < len(errors):
            what = f"of the time to {'the horizon' if math.isfinite(horizon) else 'the end'}, t = {end:.4g} s"
            words = f"a code's own error at t = {times[kept]:.4g} s: {errors[kept]:.2g}"
            share = 1.0 - float(times[kept - 1]) / end
            demanded = name == "positions" and share > LEFT_OUT.value
            if demanded and not math.isfinite(horizon):
                excused, more = _within_own(form, own[:, 0], ours, theirs, kept)
                demanded, words = not excused, words + more
            if demanded:
                yield Check(f"{name}: part left out {what}", share, LEFT_OUT, words)
            else:
                yield left_out(f"{name}: {share:.0%} {what}", words)
        until = f"{name}, {kept - 1} instants to t = {times[kept - 1]:.4g} s"
        if name == "positions":
            gap = distances(ours, theirs)[:kept]
            at, node = (int(k) for k in np.unravel_index(int(np.argmax(gap)), gap.shape))
            words = at_node(ours, theirs, at, node)
            yield Check(until, float(gap[at, node]) / form.size, TRAJECTORY, words)
        else:
            a, b = (tracked_speeds(form.start.net, run.velocity)[:kept] for run in (ours, theirs))
            axes = ("instant", "bullet")
            yield difference(until, a, b, TRAJECTORY, axes, "m/s", scale=form.speed)


def _books(form: BothCodes, own: Floats, ours: Trajectory, theirs: Trajectory) -> Iterator[Check]:
    """What has left the system, and what broke, while both codes have converged (own as in `_compared`).

    Energies are parts of the largest kinetic energy until then, or of what was dissipated if that is more.
    """
    apart = np.flatnonzero(~(own[:, 0].max(axis=0) <= CONVERGED.value))
    kept = int(apart[0]) if len(apart) else own.shape[-1]
    if kept == 0 or ours.dissipated is None or theirs.dissipated is None:
        return
    end, a, b = ours.time[kept - 1], ours.dissipated[:kept], theirs.dissipated[:kept]
    if a.any() or b.any():
        mass = form.start.system.mass
        moving = float(kinetic(mass, theirs.velocity[:kept, : len(mass)]).max())
        largest = max(moving, float(np.abs(a).max()), float(np.abs(b).max()))
        name = f"dissipated energy to t = {end:.4g} s"
        yield difference(name, a, b, DISSIPATED, ("instant",), "J", scale=largest)
    # Those that break together are told in any order.
    first, second = (
        {item.element: item.time for item in run.breaks if item.time <= end} for run in (ours, theirs)
    )
    if first or second:
        words = f"{len(first)} elements: {sorted(first)[:8]} and {len(second)}: {sorted(second)[:8]}"
        yield Check(
            "elements that broke in one code only", len(first.keys() ^ second.keys()), CONNECTIVITY, words
        )
        both = sorted(first.keys() & second.keys())
        when, other = (np.array([times[element] for element in both]) for times in (first, second))
        crossing = form.size / form.speed
        yield difference("when it broke", when, other, TRAJECTORY, ("break",), "s", scale=crossing)


def _balances(form: BothCodes, own: Floats, code: str, motion: Trajectory) -> Iterator[Check]:
    """Of a scene with rigid bodies, what a code keeps while both have converged (own as in `_compared`).

    That of a net alone is a known answer of rung 6.
    """
    apart = np.flatnonzero(~(own[:, 0].max(axis=0) <= CONVERGED.value))
    kept = int(apart[0]) if len(apart) else own.shape[-1]
    if kept and form.start.system.bodies:
        summed = code == "exunet" and form.start.system.forces.cable.viscous
        found = [energies(form, motion, BOOKED if summed else ENERGY)]
        if form.effects <= CLOSED and not form.start.system.kinematics.guides:
            found += momenta(form, motion, MOMENTUM, ANGULAR)
        yield from changes(found, motion.time[:kept], code)


def _within_own(
    form: BothCodes, own: Floats, ours: Trajectory, theirs: Trajectory, kept: int
) -> tuple[bool, str]:
    """Whether the codes differ by no more than their own errors together, from instant `kept` on; in words.

    own : (2, t) of positions; an error that was there remains, even where two tolerances happen to meet

    Where nothing grows, kinks of the force may still keep a code from converging. The two errors bound the
    difference of two right codes (triangle inequality), not that of a wrong one from a right one.
    """
    allowed = np.maximum.accumulate(own, axis=1).sum(axis=0)[kept:]
    gap = distances(ours, theirs).max(axis=1)[kept : own.shape[1]] / form.size
    outside = np.flatnonzero(~(gap <= allowed))
    at = int(outside[0]) if len(outside) else int(np.argmax(gap))
    more = "more" if len(outside) else "no more"
    return not len(outside), (
        f"; from there on the codes differ by {more} than their own errors together, at "
        f"t = {ours.time[kept + at]:.4g} s {gap[at]:.2g} and {allowed[at]:.2g}"
    )
