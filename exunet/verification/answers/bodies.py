"""Bodies that forces act on: librations in orbit, braking by the mass, a snap off the centres of mass."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from exunet.studies.both_codes import BothCodes, Floats, Theirs
from exunet.verification import tolerances as tol
from exunet.verification.answers.both import best
from exunet.verification.check import Check, against, difference
from exunet.verification.trajectories import changes, energies, momenta

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
        balances = [*momenta(case, motion, tol.MOMENTUM, tol.ANGULAR), energies(case, motion, tol.ENERGY)]
        yield from changes(balances, times, code)
        _, speed, _, _ = case.rigid_of(motion.seen)
        closing = np.diff(speed, axis=1)[:, 0] @ np.array([1.0, 0.0, 0.0])
        yield Check(f"speed at which the bodies part at the end, {code}", float(closing[-1]), tol.THROWN_BACK)
