"""Known motions of a net: small ones of taut nets, snaps, a hanging cable, a pendulum, a spinning pair."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq, root
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import eigsh

from exunet.forces import cable
from exunet.forces.blocks import Blocks
from exunet.forces.law import green_lagrange_strain
from exunet.forces.total import Forces
from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend, Method, Plan
from exunet.model import energy
from exunet.model.limits import largest_frequency, stable_step
from exunet.model.system import System
from exunet.net.arrays import Net
from exunet.studies.both_codes import BothCodes, Floats, Ints, Trajectory, coordinates, read_both
from exunet.verification import tolerances as tol
from exunet.verification.check import Check, against
from exunet.verification.horizon import fixed_plan, with_tolerance
from exunet.verification.trajectories import changes, conserved
from reference_impl import Effects
from reference_impl import forces as formulas

CODES = ("Exudyn", "reference", "compiled loop")


def best(
    case: BothCodes, times: Floats, tolerance: float = 1e-11, *, booked: bool = False
) -> Iterator[tuple[str, Trajectory]]:
    """Yield code and motion at `times` with the best adaptive method of each code; tolerance in m and m/s.

    Rigid bodies have different equations of rotation in Exudyn and in the compiled loop: scenes with bodies
    run in the latter too. booked: with the dissipated energy
    """
    plan = with_tolerance(case, "DOPRI5", tolerance)
    yield CODES[0], case.run_exunet(times, plan, booked=booked)
    yield CODES[1], case.run_reference(times, rtol=1e-11, atol=1e-13)
    if case.start.system.bodies and numba_installed():
        yield CODES[2], case.on_backend(Backend.COMPILED).run_exunet(times, plan, booked=booked)


def of_small_motion(case: BothCodes, times: Floats, part: float) -> Iterator[tuple[str, Trajectory]]:
    """Yield code and motion at `times`, with errors in proportion to the motion, however small that is.

    Exunet takes RK44 at a part of its stable step, the reference DOP853
    at a tolerance above the round-off of the stiffest mode.
    """
    plan = fixed_plan(case, float(np.diff(times).min()), part)
    yield CODES[0], case.run_exunet(times, plan)
    yield CODES[1], case.run_reference(times, rtol=1e-10, atol=1e-11)


# Stable step in units of mesh / sqrt(E / rho), by meshes on a side.
KNOWN = {5: 1.251, 10: 1.234, 25: 1.227}
DISTURBED = 1e-10  # [m]
STEPS = 60
SEED = 20210618
SHARE = 0.1  # of the largest amplitude: modes below it are not looked at


def frequency(amplitude: float, rate: float, start: float, time: float, expected: float) -> float:
    """Angular frequency [rad/s] of a free vibration from its state at `time`; it began at rest at `start`.

    The phase is atan2(-rate / w, amplitude); the number of turns follows from the expected frequency.
    """
    phase = math.atan2(-rate / expected * math.copysign(1.0, start), amplitude * math.copysign(1.0, start))
    turns = round((expected * time - phase) / (2 * math.pi))
    return (2 * math.pi * turns + phase) / time


def waves(case: BothCodes) -> Iterator[Check]:
    """Wave speeds in the reference frame: sqrt(E/rho (3 lambda^2 - 1)/2) and, transverse, sqrt(E E11/rho).

    The chain of N elements of length l is displaced in its first mode; a standing wave of wave number k has
    the frequency 2 c / l sin(k l / 2), from which c follows.
    """
    net = case.start.net
    count, element = net.n_elements, float(net.reference_length[0])
    total = float(np.ptp(net.reference_position[:, 0]))
    stretch = float(np.ptp(case.start.position[net.fixed_nodes, 0])) / total
    modulus = float(net.youngs_modulus[0] / net.density[0])
    shape = np.sin(np.pi * net.reference_position[:, 0] / total)
    rest = stretch * net.reference_position
    factor = 2.0 / element * math.sin(math.pi / (2 * count))
    known = {
        "longitudinal": (0, math.sqrt(modulus * (3 * stretch**2 - 1) / 2)),
        "transverse": (1, math.sqrt(modulus * 0.5 * (stretch**2 - 1))),
    }
    end = case.start.scene.time.end
    for code, motion in of_small_motion(case, np.array([0.0, end]), 1 / 8):
        for name, (axis, speed) in known.items():
            start, now = ((motion.position[k] - rest)[:, axis] @ shape for k in (0, 1))
            rate = motion.velocity[1][:, axis] @ shape
            found = frequency(now, rate, start, end, factor * speed) / factor
            text = f"{name} wave speed, stretch {stretch:g}, {code}"
            yield against(text, found, speed, tol.FREQUENCY, "m/s")


@dataclass(frozen=True)
class Modes:
    """Small motions of a taut net about its rest.

    rest    : (n, 3) position at rest [m]
    free    : nodes that move
    root    : (3 n_free,) square roots of their masses
    squares : (3 n_free,) squares of the angular frequencies, increasing [1/s2]
    shapes  : (3 n_free, 3 n_free) their shapes as columns, orthonormal in sqrt(m) x
    """

    rest: Floats
    free: Ints
    root: Floats
    squares: Floats
    shapes: Floats

    def amplitudes(self, values: Floats) -> Floats:
        """Return the amplitude of each mode in displacements from the rest or velocities (n, 3)."""
        return self.shapes.T @ (self.root * values[self.free].ravel())


def modes_of(case: BothCodes) -> Modes:
    """Eigenvalues of M^-1 T, eq. (14) of the reference, of a net that its supports stretch evenly."""
    net = case.start.net
    corner = net.fixed_nodes[0]
    before, after = (np.linalg.norm(x[corner]) for x in (net.reference_position, case.start.position))
    rest = float(after / before) * net.reference_position
    free = np.setdiff1d(np.arange(net.n_nodes), net.fixed_nodes)
    place = coordinates(case.reference_nodes[free])
    stiffness = formulas.tangent(case.theirs.system, case.to_reference(rest)).toarray()[np.ix_(place, place)]
    root = np.sqrt(np.repeat(net.mass[free], 3))
    squares, shapes = np.linalg.eigh(stiffness / np.outer(root, root))
    return Modes(rest, free, root, squares, shapes)


def vibration(case: BothCodes) -> Iterator[Check]:
    """Frequencies of the modes that the start contains, against the eigenvalues."""
    modes = modes_of(case)
    end = case.start.scene.time.end
    begin = modes.amplitudes(case.start.position - modes.rest)
    shown = np.flatnonzero(np.abs(begin) > SHARE * np.abs(begin).max())
    for code, motion in of_small_motion(case, np.array([0.0, end]), 1 / 32):
        now, rate = map(modes.amplitudes, (motion.position[1] - modes.rest, motion.velocity[1]))
        for k in shown:
            known = math.sqrt(modes.squares[k])
            found = frequency(now[k], rate[k], begin[k], end, known)
            yield against(f"frequency of mode {k + 1}, {code}", found, known, tol.FREQUENCY, "rad/s")


def stable_steps(case: BothCodes) -> Iterator[Check]:
    """2 / w_max of just taut bare square nets: both codes' eigenvalues, and the known ones."""
    for meshes, known in KNOWN.items():
        larger = read_both(case.path, [f"net.size={float(meshes)}"])
        net = larger.start.net
        highest = largest_frequency(System(Blocks.of_net(net), Forces.of(net)))
        step = stable_step(Method.VELOCITY_VERLET, highest)
        theirs = 2.0 / math.sqrt(_largest_eigenvalue(larger))
        name = f"Verlet step, {meshes} x {meshes} meshes"
        yield against(f"{name}, both codes", step, theirs, tol.EIGENVALUE, "s")
        unit = net.reference_length[0] / math.sqrt(net.youngs_modulus[0] / net.density[0])
        part = float(step / unit)
        where = "[mesh / sqrt(E / rho)]"
        yield Check(f"{name}, published", abs(part - known), tol.FIELD_DIGITS, where, part, known)


def _largest_eigenvalue(case: BothCodes) -> float:
    """Return the largest eigenvalue of M^-1 T in the reference configuration [1/s2].

    T is the reference's D with alpha = 0, beta = 1, which counts each element as taut, despite round-off.
    """
    matrix = formulas.damping(replace(case.theirs.system, effects=Effects(beta=1.0)))
    scale = diags_array(1.0 / np.sqrt(np.repeat(case.theirs.net.mass, 3)))
    start = np.sin(np.arange(1.0, matrix.shape[0] + 1.0))
    return float(eigsh(csr_array(scale @ matrix @ scale), k=1, which="LA", v0=start, tol=1e-9)[0][0])


def near_the_limit(case: BothCodes) -> Iterator[Check]:
    """A small disturbance of a taut net between supports after some steps on either side of the limit."""
    modes = modes_of(case)
    limit = 2.0 / math.sqrt(modes.squares[-1])
    shift = np.random.default_rng(SEED).uniform(-DISTURBED, DISTURBED, modes.rest.shape)
    moved = case.from_state(modes.rest + shift, np.zeros_like(shift))
    for part, allowed, what in ((0.99, tol.STABLE, "growth"), (1.01, tol.UNSTABLE, "1 / growth")):
        step = part * limit
        times = np.array([0.0, STEPS * step])
        for code, form in (("Exudyn", moved), ("compiled loop", moved.fastest())):
            motion = form.run_exunet(times, Plan(Method.VELOCITY_VERLET, step=step))
            grown = float(np.abs(motion.position[1] - modes.rest)[modes.free].max()) / DISTURBED
            measured = grown if what == "growth" else 1.0 / grown
            where = f"in {STEPS} steps a disturbance of {DISTURBED:.0e} m grew {grown:.3g} times"
            yield Check(f"Verlet at {part} of its step, {code}: {what}", measured, allowed, where)


class Known(NamedTuple):
    """Largest strain, peak force [N] and contact time [s] of a snap."""

    strain: float
    force: float
    contact_time: float


def known_snap(axial_stiffness: float, length: float, reduced_mass: float, speed: float) -> Known:
    """EA [N], L0 [m], mu [kg], closing speed v [m/s].

    Energy: mu v^2 / 2 = EA L0 E11^2 / 2. With E11 = E11max sin(s), the time is the integral of
    L0 E11max / (v lambda) over s from 0 to pi, lambda = sqrt(1 + 2 E11).
    """
    strain = speed * math.sqrt(reduced_mass / (axial_stiffness * length))
    half, _ = quad(
        lambda s: 1.0 / math.sqrt(1.0 + 2.0 * strain * math.sin(s)), 0.0, math.pi / 2, epsrel=1e-13
    )
    force = axial_stiffness * strain * math.sqrt(1.0 + 2.0 * strain)
    return Known(strain, force, 2.0 * length * strain / speed * half)


def snap(case: BothCodes) -> Iterator[Check]:
    """The peak at half the contact time; contact time and rebound from the slack flight afterwards.

    A slack cable is taut after a flight at the closing speed. Its ends may be centres of bodies.
    """
    net = case.start.net
    i, j = net.element_nodes[0]
    speed = float(np.linalg.norm(case.start.velocity[j] - case.start.velocity[i]))
    mass = float(1.0 / (1.0 / case.start.system.inert_mass[[i, j]]).sum())
    length = float(net.reference_length[0])
    known = known_snap(float(net.axial_stiffness[0]), length, mass, speed)
    end = case.start.scene.time.end
    flight = (length - float(np.linalg.norm(case.start.position[j] - case.start.position[i]))) / speed
    for code, motion in best(case, np.array([0.0, flight + known.contact_time / 2, end])):
        span, strain, force = _by_code(case, code, motion.position)
        rebound = float(np.linalg.norm(motion.velocity[2, j] - motion.velocity[2, i]))
        contact = end - flight - (length - span[2]) / rebound
        yield against(f"largest strain, {code}", strain[1], known.strain, tol.SNAP, "")
        yield against(f"peak force, {code}", force[1], known.force, tol.SNAP, "N")
        yield against(f"contact time, {code}", contact, known.contact_time, tol.SNAP, "s")
        yield against(f"rebound speed, {code}", rebound, speed, tol.SNAP, "m/s")


def _by_code(case: BothCodes, code: str, position: Floats) -> tuple[Floats, Floats, Floats]:
    """Length [m], strain and tension [N] of the cable (t,), each code's motion by its own formulas."""
    if code == CODES[1]:
        system, x = case.theirs.system, case.to_reference(position[:, : case.start.net.n_nodes])
        length, strain = formulas.length(system, x), formulas.strain(system, x)
        return length[:, 0], strain[:, 0], formulas.tension(system, x)[:, 0]
    net = case.start.net
    position = position[:, : net.n_nodes]
    length = cable.lengths(net, position)
    strain = green_lagrange_strain(length, net.reference_length)
    law, at_rest = case.start.system.forces.cable.law, np.zeros_like(position)
    return length[:, 0], strain[:, 0], cable.element_tension(net, law, position, at_rest)[:, 0]


def hanging_chain(net: Net, weight: Floats, span: float) -> Floats:
    """(n, 2) places [m] (along, upwards) of a chain of elements between supports `span` apart at one height.

    weight : (n,) of each node [N]. Statics alone: the horizontal force H and the vertical one V at the first
    support determine the force in each element, eqs. (3), (8) its length; H and V are those that end the
    chain at the second support.
    """
    stiffness, lengths = net.axial_stiffness, net.reference_length

    def shape(forces: Floats) -> Floats:
        horizontal, vertical = forces
        places = [np.zeros(2)]
        for k, length in enumerate(lengths):
            pull = float(np.hypot(horizontal, vertical))
            direction = np.array([horizontal, -vertical]) / pull
            places.append(places[-1] + direction * length * _stretch(pull / float(stiffness[k])))
            vertical -= weight[k + 1]
        return np.array(places)

    half = float(weight[1:-1].sum()) / 2
    target = np.array([span, 0.0])
    found = root(lambda forces: shape(forces)[-1] - target, [half, half], tol=1e-14)
    return shape(found.x)


def _stretch(force: float) -> float:
    """Stretch at which an element of unit EA pulls with `force`: (s^2 - 1) s / 2 = force."""
    return float(brentq(lambda s: 0.5 * (s * s - 1.0) * s - force, 1.0, 2.0 + 2.0 * force, xtol=1e-15))


def hanging(case: BothCodes) -> Iterator[Check]:
    """Places of the nodes after the cable has come to rest."""
    net = case.start.net
    ends = case.start.position[net.fixed_nodes]
    span = float(np.linalg.norm(ends[1] - ends[0]))
    gravity = float(np.linalg.norm(case.start.scene.effects.model_dump()["gravity"]["acceleration"]))
    known = hanging_chain(net, gravity * net.mass, span) + ends[0][[0, 2]]
    size = float(net.reference_length.sum())
    times = np.array([0.0, case.start.scene.time.end])
    runs = {
        CODES[0]: case.run_exunet(times, fixed_plan(case, times[1], 1 / 2)),
        CODES[1]: case.run_reference(times, rtol=1e-9, atol=1e-10),
    }
    for code, motion in runs.items():
        gap = np.linalg.norm(motion.position[1][:, [0, 2]] - known, axis=1)
        node = int(np.argmax(gap))
        height = float(motion.position[1, node, 2]), float(known[node, 1])
        yield Check(
            f"shape at rest, {code}", float(gap[node]) / size, tol.HANGING, f"node {node}, z [m]", *height
        )


def pendulum(case: BothCodes) -> Iterator[Check]:
    """Frequency sqrt(g / l) (1 - a^2 / 16) of a pendulum of (stretched) length l and amplitude a."""
    place = case.start.position[1]
    length, amplitude = float(np.linalg.norm(place)), math.atan2(place[0], -place[2])
    gravity = float(np.linalg.norm(case.start.scene.effects.model_dump()["gravity"]["acceleration"]))
    known = math.sqrt(gravity / length) * (1.0 - amplitude**2 / 16.0)
    end = case.start.scene.time.end
    for code, motion in best(case, np.array([0.0, end])):
        (x, _, z), (vx, _, vz) = motion.position[1, 1], motion.velocity[1, 1]
        rate = (z * vx - x * vz) / -(x * x + z * z)
        found = frequency(math.atan2(x, -z), rate, amplitude, end, known)
        yield against(f"frequency, {code}", found, known, tol.PENDULUM, "rad/s")


def braking(case: BothCodes) -> Iterator[Check]:
    """Angular momentum that beta T(reference) takes from a rigid rotation by the angle a.

    The cable lies along x at first, so eq. (13) damps the relative velocity along x throughout, with beta k,
    k = EA / L0. At the distance l the relative velocity along x is -w l sin(a), the torque
    -beta k w l^2 sin(a)^2, and over the angle the loss is beta k l^2 (a / 2 - sin(2 a) / 4). An
    objective damping would take nothing.
    """
    net = case.start.net
    stiffness = float(net.axial_stiffness[0] / net.reference_length[0])
    beta = case.start.scene.effects.model_dump()["rayleigh_damping"]["beta"]
    length = float(np.linalg.norm(case.start.position[1] - case.start.position[0]))
    times = np.linspace(0.0, case.start.scene.time.end, 61)
    for code, motion in best(case, times):
        span = motion.position[:, 1] - motion.position[:, 0]
        angle = float(np.unwrap(np.arctan2(span[:, 1], span[:, 0]))[-1])
        spin = energy.angular_momentum(net.mass, motion.position, motion.velocity)[:, 2]
        known = beta * stiffness * length**2 * (angle / 2 - math.sin(2 * angle) / 4)
        found = float(spin[0] - spin[-1])
        yield against(f"momentum taken by damping, {code}", found, known, tol.BRAKING, "kg m2/s")


def free_net(case: BothCodes) -> Iterator[Check]:
    """Largest change of momenta and energy over the stored times."""
    times = case.start.scene.time.stored_times
    for code, motion in best(case, times):
        yield from changes(conserved(case, motion), times, code)
