"""The stable step of velocity Verlet, 2 / w_max: from eigenvalues, and from what both codes do near it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import eigsh

from exunet.forces.points import Points
from exunet.forces.total import Forces
from exunet.methods.method import Method
from exunet.methods.plan import Plan
from exunet.studies.both_codes import BothCodes, read_both
from exunet.system.stability import largest_frequency, stable_step
from exunet.system.system import System
from exunet.verification.answers.modes import modes_of
from exunet.verification.check import Check
from exunet.verification.tolerances import EIGENVALUE, FIELD_DIGITS, STABLE, UNSTABLE
from reference_impl import Effects
from reference_impl import forces as formulas

# Stable step in units of mesh / sqrt(E / rho), by meshes on a side.
KNOWN = {5: 1.251, 10: 1.234, 25: 1.227}
DISTURBED = 1e-10  # [m]
STEPS = 60
SEED = 20210618


def stable_steps(case: BothCodes) -> Iterator[Check]:
    """2 / w_max of just taut bare square nets: both codes' eigenvalues, and the known ones."""
    for meshes, known in KNOWN.items():
        larger = read_both(case.path, {"net.size": str(float(meshes))})
        net = larger.start.net
        step = stable_step(
            Method.VELOCITY_VERLET, largest_frequency(System(Points.of_net(net), Forces.of(net)))
        )
        theirs = 2.0 / math.sqrt(_largest_eigenvalue(larger))
        name, values = f"{meshes} x {meshes} meshes", f"{step:.9g} s and {theirs:.9g} s"
        yield Check(f"Verlet step, {name}: codes differ by", abs(step / theirs - 1), EIGENVALUE, values)
        unit = net.reference_length[0] / math.sqrt(net.youngs_modulus[0] / net.density[0])
        words = f"{step / unit:.5f}, known: {known}"
        yield Check(f"Verlet step, {name}: off the known by", abs(step / unit - known), FIELD_DIGITS, words)


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
    random = np.random.default_rng(SEED)
    shift = random.uniform(-DISTURBED, DISTURBED, modes.rest.shape)
    moved = case.from_state(modes.rest + shift, np.zeros_like(shift))
    for part, allowed in ((0.99, STABLE), (1.01, UNSTABLE)):
        step = part * limit
        times = np.array([0.0, STEPS * step])
        for code, motion in (
            ("Exudyn", moved.run_exunet(times, Plan(Method.VELOCITY_VERLET, step=step))),
            ("reference", moved.run_reference(times, method="Verlet", step=step)),
        ):
            grown = float(np.abs(motion.position[1] - modes.rest)[modes.free].max()) / DISTURBED
            measured = grown if allowed is STABLE else 1.0 / grown
            words = f"in {STEPS} steps a disturbance of {DISTURBED:.0e} m grew {grown:.3g} times"
            what = "growth" if allowed is STABLE else "1 / growth"
            yield Check(f"Verlet at {part} of its step, {code}: {what}", measured, allowed, words)
