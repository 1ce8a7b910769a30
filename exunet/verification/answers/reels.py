"""A winch that pulls two bodies together: at a constant rate, and with a force that falls with its rate.

The line is straight, light and stiff: what the strain (1e-4) and the length wound up (1e-3 of it) change
of its stiffness k is not in the formulas.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.net.drive import Drive
from exunet.net.reel import Reel
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.verification import tolerances as tol
from exunet.verification.answers.both import best
from exunet.verification.check import Check, difference
from exunet.verification.trajectories import changes, energies, momenta


def at_a_rate(case: BothCodes) -> Iterator[Check]:
    """An elastic wall that moves at r: a collision with it sends a mass off at 2 r (energy in its frame)."""
    times, rate = case.start.scene.time.stored_times, _first_command(case)[1].rate
    mass, stiffness = _pair(case)
    phase = np.minimum(np.sqrt(stiffness / mass) * times, np.pi)
    approach = rate * (1.0 - np.cos(phase))
    # N = k (r t - way), and what it does on the line that comes in
    work = mass * rate * approach
    for code, motion in best(case, times, booked=True):
        yield from _as_known(case, code, motion, approach, work)


def with_a_force(case: BothCodes) -> Iterator[Check]:
    """Two exponentials: N'' + (k / c) N' + (k / mu) N = 0 with N = 0 and N' = k F / c at first."""
    times = case.start.scene.time.stored_times
    reel, drive = _first_command(case)
    mass, stiffness = _pair(case)
    fast, slow = np.roots([1.0, stiffness * drive.gives, stiffness / mass])
    scale = stiffness * drive.force * drive.gives / (fast - slow)
    pulling = times < reel.times[1]
    pulled = times[pulling]
    tension = scale * (np.exp(fast * pulled) - np.exp(slow * pulled))
    approach = scale * (np.expm1(fast * pulled) / fast - np.expm1(slow * pulled) / slow) / mass
    work = 0.5 * mass * approach**2 + 0.5 * tension**2 / stiffness
    for code, motion in best(case, times, booked=True):
        yield from _as_known(case, code, motion, approach, work)
        locked = motion.reels.work[~pulling, 0]
        words = f"{locked[0]:.6g} J when it locks, {locked[-1]:.6g} J at the end"
        yield Check(f"work of the locked winch, {code}", float(np.ptp(locked)), tol.LOCKED, words)


def exchanges(case: BothCodes) -> Iterator[Check]:
    """Balances while nodes of a heavy line go onto a drum off the centre of a turning body, and come off.

    Of a body that is led through poses, with what it gives; its impulse is integrated, as the motion is, but
    the momentum of the nodes on the drum is that of the poses.
    """
    linear = tol.MOMENTUM if case.start.system.moves_freely.all() else tol.GUIDED
    times = case.start.scene.time.stored_times
    for code, motion in best(case, times, booked=True):
        held = motion.reels.held[:, 0]
        words = f"{held.max():.0f} at most, {held[-1]:.0f} at the end"
        yield Check(f"nodes that stayed where they were, {code}", 2.0 - np.ptp(held), tol.CONNECTIVITY, words)
        yield from _balances(case, code, motion, linear)


def _first_command(case: BothCodes) -> tuple[Reel, Drive]:
    (winding,) = case.start.system.forces.cable.reels
    return winding.reel, winding.reel.drives[1]


def _pair(case: BothCodes) -> tuple[float, float]:
    """The reduced mass of the bodies [kg], and the stiffness EA / L of the line between them [N/m]."""
    net, masses = case.start.net, case.start.system.body_mass
    (line,) = net.tether_elements["line"]
    stiffness = net.youngs_modulus[line] * net.area[line] / net.reference_length[line]
    return float(1.0 / (1.0 / masses).sum()), float(stiffness)


def _as_known(
    case: BothCodes, code: str, motion: Trajectory, approach: Floats, work: Floats
) -> Iterator[Check]:
    """Speed of approach and work of the winch (k,) at the first times; the balances at all of them."""
    _, speed, _, _ = case.rigid_of(motion.seen)
    closing = (speed[:, 0, 0] - speed[:, 1, 0])[: len(approach)]
    yield difference(f"speed of approach, {code}", closing, approach, tol.REELED, ("instant",), "m/s")
    done = motion.reels.work[: len(work), 0]
    yield difference(f"work of the winch, {code}", done, work, tol.REELED, ("instant",), "J")
    yield from _balances(case, code, motion)


def _balances(
    case: BothCodes, code: str, motion: Trajectory, linear: tol.Tolerance = tol.MOMENTUM
) -> Iterator[Check]:
    found = [*momenta(case, motion, linear, tol.ANGULAR), energies(case, motion, tol.ENERGY)]
    yield from changes(found, motion.time, code)
