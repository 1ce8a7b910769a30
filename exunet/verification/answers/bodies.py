"""Motions of bodies that are known: librations, braking, snaps, winches, rotation without torque.

The line is straight, light and stiff: what the strain (1e-4) and the length wound up (1e-3 of it) change
of its stiffness k is not in the formulas.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.special import ellipj, ellipk, ellipkinc

from exunet.net.drive import Drive
from exunet.net.tether import ReeledTether
from exunet.studies.both_codes import BothCodes, Floats, Theirs, Trajectory
from exunet.verification import tolerances as tol
from exunet.verification.answers.motions import best
from exunet.verification.check import Check, against, difference
from exunet.verification.trajectories import changes, conserved

SETTLED = 200.0  # [s]: the stretch of the start has died out


def librations(case: BothCodes) -> Iterator[Check]:
    """Small swings in a circular orbit of rate n: Wie, Space Vehicle Dynamics and Control, sec. 6.10.

    A body in the plane of the orbit: n sqrt(3 (I_along - I_radial) / I_normal). A dumbbell, whose moments are
    (0, I, I): sqrt(3) n, in the plane, and 2 n across it. The frequency is that of the phase between two
    states; what the stretch of the tether does to the rate of the swing is over by the first of them.
    """
    rate = float(case.start.scene.effects.model_dump()["orbit"]["mean_motion"])
    radial, along, normal = case.start.system.bodies[0].inertia
    known = {
        "satellite": rate * math.sqrt(3.0 * (along - radial) / normal),
        "dumbbell in the plane": rate * math.sqrt(3.0),
        "dumbbell across it": rate * 2.0,
    }
    times = np.array([0.0, SETTLED, case.start.scene.time.end])
    span = np.diff(times[1:])[0]
    for code, motion in best(case, times, 1e-10):
        for (name, frequency), (angle, change) in zip(known.items(), _swings(case, motion.seen), strict=True):
            first, last = np.arctan2(-change[1:] / frequency, angle[1:])
            turns = round((frequency * span - (last - first)) / (2.0 * math.pi))
            found = (last - first + 2.0 * math.pi * turns) / span
            yield against(f"{name}, {code}", found, frequency, tol.LIBRATION, "rad/s")


def _swings(case: BothCodes, seen: Theirs) -> Iterator[tuple[Floats, Floats]]:
    """Angles (t,) [rad] from the radial x, and their rates, of the satellite and of the two pairs."""
    place, speed, turn, spin = case.rigid_of(seen)
    yield np.arctan2(turn[:, 0, 1, 0], turn[:, 0, 0, 0]), spin[:, 0, 2]
    for pair, axis in ((1, 1), (3, 2)):
        (x, y), (u, v) = (
            (values[:, pair] - values[:, pair + 1])[:, [0, axis]].T for values in (place, speed)
        )
        yield np.arctan2(y, x), (x * v - y * u) / (x * x + y * y)


def braked(case: BothCodes) -> Iterator[Check]:
    """Momentum, and angular momentum about the centre of mass, of a body that falls and is braked.

    The force is m (g - alpha v) and the torque, the sum of x cross -alpha v over the mass, -alpha H: both are
    linear, so p = (p0 - m g / alpha) exp(-alpha t) + m g / alpha and H = H0 exp(-alpha t), whatever the
    moments are, and whatever nodes the body carries.
    """
    (body,), effects = case.start.system.bodies, case.start.scene.effects.model_dump()
    alpha, gravity = effects["mass_damping"]["alpha"], np.array(effects["gravity"]["acceleration"])
    times = case.start.scene.time.stored_times
    decay = np.exp(-alpha * times)[:, None]
    for code, motion in best(case, times):
        _, speed, turn, spin = (part[:, 0] for part in case.rigid_of(motion.seen))
        falling = speed[:1] * decay + gravity / alpha * (1.0 - decay)
        turning = np.einsum("tij,jk,tk->ti", turn, body.inertia_in_frame, spin)
        for name, found, known, unit in (
            ("velocity", speed, falling, "m/s"),
            ("angular momentum", turning, turning[0] * decay, "kg m2/s"),
        ):
            yield difference(f"{name}, {code}", found, known, tol.BRAKED, ("instant", "xyz"), unit)


def whirled(case: BothCodes) -> Iterator[Check]:
    """Steady rotation about z of a mass on a cable from the rim of a hub whose motion is given.

    The case starts where the tension is m w^2 r, so that the mass goes round at r and w as it starts.
    """
    (hub,), (_, mass) = case.start.system.kinematics.point, case.start.net.element_nodes[0]
    turning = float(case.start.state.bodies.angular_velocity[0, 2])
    times = case.start.scene.time.stored_times
    turn = np.stack([np.cos(turning * times), np.sin(turning * times), 0.0 * times], axis=-1)
    for code, motion in best(case, times):
        for name, node in (("mass", mass), ("rim", hub)):
            known = case.start.position[node, 0] * turn
            axes = ("instant", "xyz")
            yield difference(
                f"place of the {name}, {code}", motion.position[:, node], known, tol.WHIRLED, axes, "m"
            )


def snap_off_centre(case: BothCodes) -> Iterator[Check]:
    """Momentum, angular momentum and energy before, in and after the snap, which must have happened."""
    times = case.start.scene.time.stored_times
    for code, motion in best(case, times, booked=True):
        yield from changes(conserved(case, motion), times, code)
        _, speed, _, _ = case.rigid_of(motion.seen)
        closing = np.diff(speed, axis=1)[:, 0] @ np.array([1.0, 0.0, 0.0])
        yield Check(f"speed at which the bodies part at the end, {code}", float(closing[-1]), tol.THROWN_BACK)


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
    linear = tol.MOMENTUM if case.start.system.moves_freely.all() else tol.PRESCRIBED
    times = case.start.scene.time.stored_times
    for code, motion in best(case, times, booked=True):
        held = motion.reels.held[:, 0]
        words = f"{held.max():.0f} at most, {held[-1]:.0f} at the end"
        yield Check(f"nodes that stayed where they were, {code}", 2.0 - np.ptp(held), tol.CONNECTIVITY, words)
        yield from changes(conserved(case, motion, linear), times, code)


def _first_command(case: BothCodes) -> tuple[ReeledTether, Drive]:
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
    yield from changes(conserved(case, motion), motion.time, code)


PANEL = 0.05  # [s], of the quadrature of the precession: eight points a panel, for rates of a few rad/s
AROUND, SPACING = 4, 2e-3  # instants on either side of a zero of a rate, and their spacing [s]


@dataclass(frozen=True)
class FreeRotation:
    """Three different moments and no torque: Landau and Lifshitz, Mechanics, 3rd ed., sec. 37.

    inertia : (3, 3) in the body's frame [kg m2]
    spin    : (3,) angular velocity at time 0, in the frame [rad/s]
    turn    : (3, 3) attitude of the frame at time 0

    The angular momentum must go round the axis of the largest moment, |H|^2 > 2 T I2; ValueError else.
    """

    inertia: Floats
    spin: Floats
    turn: Floats

    def __post_init__(self) -> None:
        if not self._squared > self._twice_energy * self.moments[1]:
            raise ValueError("the angular momentum does not go round the axis of the largest moment")

    @cached_property
    def moments(self) -> Floats:
        """I1 < I2 < I3 [kg m2]."""
        return np.asarray(np.linalg.eigvalsh(self.inertia))

    @cached_property
    def axes(self) -> Floats:
        """(3, 3), whose columns are the principal axes, right-handed, with the third along the spin."""
        axes = np.linalg.eigh(self.inertia)[1]
        axes[:, 2] *= math.copysign(1.0, axes[:, 2] @ self.spin)
        axes[:, 0] *= np.linalg.det(axes)
        return axes

    @cached_property
    def _start(self) -> Floats:
        return np.asarray(self.axes.T @ self.spin)

    @cached_property
    def _twice_energy(self) -> float:
        return float(self.moments @ self._start**2)

    @cached_property
    def _squared(self) -> float:
        return float(np.sum((self.moments * self._start) ** 2))

    @cached_property
    def _amplitudes(self) -> Floats:
        """Return the amplitudes of the angular velocities along the axes, (37.10)."""
        (a, b, c), e, h = self.moments, self._twice_energy, self._squared
        return np.sqrt(
            [(e * c - h) / (a * (c - a)), (e * c - h) / (b * (c - b)), (h - e * a) / (c * (c - a))]
        )

    @cached_property
    def _pace(self) -> float:
        """d tau / dt [1/s], (37.8)."""
        (a, b, c), e, h = self.moments, self._twice_energy, self._squared
        return math.sqrt((c - b) * (h - e * a) / (a * b * c))

    @cached_property
    def _parameter(self) -> float:
        """k^2, (37.9)."""
        (a, b, c), e, h = self.moments, self._twice_energy, self._squared
        return (b - a) * (e * c - h) / ((c - b) * (h - e * a))

    @cached_property
    def _phase(self) -> float:
        """tau at time 0."""
        first, second = self._start[:2] / self._amplitudes[:2]
        return float(ellipkinc(math.atan2(second, first), self._parameter))

    def rates(self, time: Floats) -> Floats:
        """(..., 3) angular velocities along the principal axes [rad/s] at times (...)."""
        sine, cosine, delta, _ = ellipj(self._phase + self._pace * time, self._parameter)
        return np.asarray(self._amplitudes * np.stack([cosine, sine, delta], axis=-1))

    @property
    def flip_period(self) -> float:
        """Time [s] from one turn-over to the next: half a period of the middle rate, 2 K / pace."""
        return float(2.0 * ellipk(self._parameter) / self._pace)

    def flips(self, end: float) -> Floats:
        """Times [s] at which the middle rate is zero, up to `end`."""
        half = float(ellipk(self._parameter))
        first = math.ceil(self._phase / (2.0 * half))
        times = (2.0 * half * np.arange(first, first + 100) - self._phase) / self._pace
        return np.asarray(times[times <= end])

    def attitudes(self, time: Floats) -> Floats:
        """(t, 3, 3) attitudes of the frame at times (t,) from 0 on, ascending.

        Euler angles about the constant angular momentum, (37.15) and (37.16): nutation and spin from the
        rates, precession by Gauss's quadrature.
        """
        return np.asarray(self._about_momentum(np.zeros(1))[0] @ self._to_momentum(time))

    def _to_momentum(self, time: Floats) -> Floats:
        return self._from_momentum(time) @ self.axes.T

    def _about_momentum(self, time: Floats) -> Floats:
        """From axes of which the third is along the angular momentum, to the scene's."""
        return np.asarray(self.turn @ self.axes @ np.swapaxes(self._from_momentum(time), -1, -2))

    def _from_momentum(self, time: Floats) -> Floats:
        """(t, 3, 3), principal axes to those about the angular momentum: three turns by Euler angles."""
        along = self.moments * self.rates(time)
        total = math.sqrt(self._squared)
        nutation, spin = np.arccos(along[:, 2] / total), np.arctan2(along[:, 0], along[:, 1])
        return np.asarray(_about(2, self._precession(time)) @ _about(0, nutation) @ _about(2, spin))

    def _precession(self, time: Floats) -> Floats:
        """(t,) the integral from 0 of H (I1 w1^2 + I2 w2^2) / (H^2 - I3^2 w3^2)."""
        node, weight = np.polynomial.legendre.leggauss(8)
        ends = np.concatenate([[0.0], time])
        found = np.zeros(len(time))
        for k, (begin, end) in enumerate(pairwise(ends)):
            cuts = np.linspace(begin, end, max(1, math.ceil((end - begin) / PANEL)) + 1)
            half = 0.5 * np.diff(cuts)[:, None]
            rates = self.rates(cuts[:-1, None] + half * (1.0 + node))
            a, b = (self.moments[j] * rates[..., j] ** 2 for j in (0, 1))
            across = (self.moments[0] * a + self.moments[1] * b) / math.sqrt(self._squared)
            found[k] = float(np.sum(half * weight * (a + b) / across))
        return np.cumsum(found)


def _about(axis: int, angle: Floats) -> Floats:
    """(t, 3, 3) rotations by angles (t,) about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1.0
    turn[:, i, i] = turn[:, j, j] = np.cos(angle)
    turn[:, j, i] = np.sin(angle)
    turn[:, i, j] = -turn[:, j, i]
    return turn


def free_rotation(case: BothCodes) -> Iterator[Check]:
    """Attitude and angular velocity, turn-over, precession, energy and angular momentum over ten turns.

    Attitudes are those of the frames in the scene; a column of their matrices is an axis of length one.
    """
    names, end = case.start.system.blocks.rigid, case.start.scene.time.end
    wobbling, top = names.index("wobbling"), names.index("top")
    inertia = np.array([body.inertia_in_frame for body in case.start.system.bodies])
    _, _, turns, spins = case.rigid_of(case.theirs_at(case.start.state.moving))
    known = FreeRotation(inertia[wobbling], spins[wobbling], turns[wobbling])
    near = [flip + SPACING * np.arange(-AROUND, AROUND + 1) for flip in known.flips(end - 1.0)]
    times = np.unique(np.concatenate([np.linspace(0.0, end, 101), *near]))
    attitudes, rates = known.attitudes(times), known.rates(times)
    for code, motion in best(case, times, 1e-12):
        _, _, turn, spin = case.rigid_of(motion.seen)
        own = spin[:, wobbling] @ known.axes
        fastest = float(np.abs(rates).max())
        yield _largest(f"attitude, {code}", turn[:, wobbling] - attitudes, times, tol.TURNED)
        yield _largest(f"angular velocity, {code}: part", (own - rates) / fastest, times, tol.TURNED)
        found = np.array([_zero(times, own[:, 1], flip) for flip in known.flips(end - 1.0)])
        yield against(f"turn-over, {code}", float(np.diff(found)[-1]), known.flip_period, tol.FLIP, "s")
        yield _precession(code, end, inertia[top], turn[[0, -1], top], spin[0, top])
        for number, name in ((wobbling, "wobbling"), (top, "top")):
            momentum = spin[:, number] @ inertia[number]
            twice = np.einsum("ta,ta->t", spin[:, number], momentum)[:, None]
            in_scene = np.einsum("tij,tj->ti", turn[:, number], momentum)
            total = float(np.linalg.norm(momentum[0]))
            kept = {
                "energy": (twice - twice[0]) / twice[0],
                "H": (in_scene - in_scene[0]) / total,
            }
            for quantity, change in kept.items():
                name_of = f"{quantity} of {name}, {code}: relative change"
                yield _largest(name_of, change, times, tol.FREELY_KEPT)


def _precession(code: str, end: float, inertia: Floats, turn: Floats, spin: Floats) -> Check:
    """The axis of a symmetric top goes round H at |H| / I: Goldstein, Classical Mechanics, 3rd ed., sec. 5.6.

    turn : (2, 3, 3) attitudes at time 0 and at `end`; spin : (3,) at time 0
    """
    momentum = turn[0] @ (inertia @ spin)
    total = float(np.linalg.norm(momentum))
    known = total / float(inertia[0, 0])
    along = momentum / total
    across = [axis - (axis @ along) * along for axis in turn[:, :, 2]]
    angle = math.atan2(np.cross(*across) @ along, across[0] @ across[1])
    rounds = round((known * end - angle) / (2.0 * math.pi))
    return against(f"precession, {code}", (angle + 2.0 * math.pi * rounds) / end, known, tol.TURNED, "rad/s")


def _zero(times: Floats, rate: Floats, about: float) -> float:
    """When a rate is zero, from the instants near one: the polynomial of the time over the rate, at 0."""
    at = np.argsort(np.abs(times - about))[: 2 * AROUND + 1]
    return float(BarycentricInterpolator(rate[at], times[at] - about)(0.0)) + about


def _largest(name: str, error: Floats, times: Floats, allowed: tol.Tolerance) -> Check:
    """error : (t, ...)"""
    each = np.abs(error).reshape(len(times), -1).max(axis=1)
    at = int(np.argmax(each))
    return Check(name, float(each[at]), allowed, f"t = {times[at]:.6g} s")
