"""Small motions of taut nets: wave speeds, frequencies, and the stable step of velocity Verlet, 2 / w_max."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import eigsh

from exunet.forces.blocks import Blocks
from exunet.forces.total import Forces
from exunet.methods.method import Method, Plan
from exunet.model.limits import largest_frequency, stable_step
from exunet.model.system import System
from exunet.studies.both_codes import BothCodes, Floats, Ints, coordinates, read_both
from exunet.verification import tolerances as tol
from exunet.verification.answers.both import of_small_motion
from exunet.verification.check import Check, against
from reference_impl import Effects
from reference_impl import forces as formulas

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
        """Of each mode in displacements from the rest or velocities (n, 3)."""
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
    """Of M^-1 T in the reference configuration [1/s2], T as the reference's D with alpha = 0, beta = 1.

    That D counts every element as taut, whatever the round-off of its length.
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
