"""The stable step of the fixed-step explicit methods: the net's fastest mode and each method's limit.

A slack element has no stiffness, so the net with every element just taut (eq. (14) in the reference
configuration) has the highest frequencies it can reach, up to the factor (3 lambda^2 - 1)/2 by which a
stretch lambda stiffens an element. Tethers have no reference configuration: they pull in any direction, and
turn the threads that they are tied to. Such an element stands for its worst direction with EA / L0 in all of
them, since n n^T <= I: the bound holds however the scene is turned, and is reached where all align.

But a step that is stable for a taut net is not accurate for one that snaps: at each snap the force has a
kink, and what a step loses or makes there is not made good. `SAFETY` covers both.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import ArpackError, eigsh

from exunet.forces.cable import assemble_pairs, reference_blocks, reference_spans
from exunet.methods.method import METHODS, Kind, Method
from exunet.system.system import System

# Measured on the three planar cases to t = 2 s, 5 starts each, as the largest error of the energy balance:
# VelocityVerlet 1.1 at 0.8 of the stable step, 0.16 at 0.5, 0.05 at 0.3, 0.024 at 0.2; RK44 0.69, 0.25,
# 0.054, 0.016. The guards allow 0.05.
SAFETY = 0.2

# Growth of a mode in one step up to which weakly unstable methods run without being forced: at it a taut
# mode grows e-fold in 100 steps. On the undamped planar case to 2 s RK67 passes the guards at it (energy
# within 0.025) and not at twice that step; ExplicitMidpoint needs a third of it, ExplicitEuler far less.
WEAK_GROWTH = 0.01
_ROUND_OFF = 1e-9
LARGE = 30_000  # coordinates, from which on the largest frequency is found to a hundredth only


def _symmetric(matrix: csr_array, mass: NDArray[np.float64]) -> csr_array:
    """M^-1/2 A M^-1/2: the same eigenvalues as M^-1 A, but symmetric."""
    scale = diags_array(1.0 / np.sqrt(mass))
    return csr_array(scale @ matrix @ scale)


def _largest_eigenvalue(matrix: csr_array) -> float:
    """Largest eigenvalue of a symmetric positive semi-definite matrix; Gershgorin bound if Lanczos fails."""
    bound = float(np.max(np.abs(matrix).sum(axis=1), initial=0.0))
    size = matrix.shape[0]
    if size <= 60:
        return float(np.linalg.eigvalsh(matrix.toarray())[-1]) if size else 0.0
    start = np.sin(np.arange(1.0, size + 1.0))  # fixed: the same case gives the same step
    # The largest eigenvalues of a large net lie close together: their digits cost time that no step needs.
    tolerance = 1e-6 if size <= LARGE else 1e-2
    try:
        found = eigsh(matrix, k=1, which="LA", v0=start, tol=tolerance)[0][0]
        return float(min(bound, found * (1.0 + tolerance)))
    except ArpackError:
        return bound


@lru_cache(maxsize=8)
def largest_frequency(system: System) -> float:
    """Highest angular frequency [rad/s] of the just taut net: sqrt of the largest eigenvalue of M^-1 (T + K).

    K is the constant stiffness of the effects, such as that of bending; kernel terms add their bounds.
    """
    free = _free_coordinates(system)
    stiffness = taut_stiffness(system)[free][:, free]
    square = max(0.0, _largest_eigenvalue(_symmetric(stiffness, np.repeat(system.inert_mass, 3)[free])))
    return math.sqrt(square + sum(term.stiffness_rate for term in system.forces.kernels))


def taut_stiffness(system: System) -> csr_array:
    """T + K, (3 n_points, 3 n_points) [N/m]."""
    stiffness, linear = _just_taut(system), system.forces.linear
    if linear is not None and linear.stiffness is not None:
        stiffness = csr_array(stiffness + linear.stiffness)
    return stiffness


def _just_taut(system: System) -> csr_array:
    """Bound of T, (3 n_points, 3 n_points) [N/m]; tethers, and threads tied to them, in any direction."""
    net = system.net
    blocks = reference_blocks(net, reference_spans(net, system.blocks.position))
    tied = [node for tether in net.tethers for node in tether.nodes]
    turning = np.isin(net.element_nodes, tied).any(axis=1)
    stiffness = (net.axial_stiffness / net.reference_length)[turning]
    blocks[turning] = stiffness[:, None, None] * np.eye(3)
    return assemble_pairs(net, blocks, system.blocks.n_points)


@lru_cache(maxsize=8)
def largest_damping_rate(system: System) -> float:
    """Bound [1/s] of the eigenvalues of M^-1 D, viscous stress and kernel terms included; or zero."""
    rate = sum(term.damping_rate for term in system.forces)
    linear = system.forces.linear
    if linear is not None and linear.damping is not None:
        free = _free_coordinates(system)
        damping = linear.damping[free][:, free]
        rate += max(0.0, _largest_eigenvalue(_symmetric(damping, np.repeat(system.inert_mass, 3)[free])))
    relaxation = system.forces.cable.changes.relaxation_time
    if relaxation is not None:  # of a taut net, tau T at most
        rate += float(relaxation.max(initial=0.0)) * largest_frequency(system) ** 2
    return rate


def _free_coordinates(system: System) -> NDArray[np.int64]:
    return np.flatnonzero(np.repeat(np.isfinite(system.inert_mass), 3))


def stable_step(method: Method, frequency: float, damping_rate: float = 0.0) -> float:
    """Largest step [s] at which `method` damps or keeps a mode of that frequency and damping rate.

    frequency    : angular frequency of the undamped mode [rad/s]
    damping_rate : c in x'' + c x' + w^2 x = 0 [1/s]
    Zero for a method that makes every such mode grow, infinity if nothing limits it (implicit methods too).
    """
    if METHODS[method].kind == Kind.IMPLICIT or (frequency == 0.0 and damping_rate == 0.0):
        return math.inf
    if method == Method.VELOCITY_VERLET:
        # Central differences with the damping force taken at the start of the step: 2/w (sqrt(1 + z^2) - z)
        # with z = c / 2w, written so that w may be zero.
        half = damping_rate / 2.0
        return 2.0 / (math.hypot(frequency, half) + half)
    return _explicit_limit(method, frequency, damping_rate, _ROUND_OFF)


def step_limit(method: Method, frequency: float, damping_rate: float = 0.0) -> float:
    """Largest step [s] that is run without being forced: the stable one.

    Where a method makes every undamped mode grow, or from far smaller steps on than
    matter (`MethodFacts.weak`), it is the step at which a mode grows by WEAK_GROWTH in each.
    """
    limit = stable_step(method, frequency, damping_rate)
    if not METHODS[method].weak or math.isinf(limit):
        return limit
    return _explicit_limit(method, frequency, damping_rate, WEAK_GROWTH)


def _explicit_limit(method: Method, frequency: float, damping_rate: float, growth: float) -> float:
    half = damping_rate / 2.0
    root = complex(half**2 - frequency**2) ** 0.5
    return min(_polynomial_limit(method, z, growth) for z in {-half + root, -half - root} if z != 0)


def _polynomial_limit(method: Method, eigenvalue: complex, growth: float) -> float:
    """Largest h with |R(h z)| <= 1 + growth on the ray of an eigenvalue: bisection of the first crossing."""
    polynomial = np.polynomial.Polynomial(METHODS[method].stability_polynomial)
    direction = eigenvalue / abs(eigenvalue)

    def grows(radius: NDArray[np.float64] | float) -> NDArray[np.bool_]:
        return np.abs(polynomial(radius * direction)) > 1.0 + growth

    radii = np.linspace(0.01, 8.0, 800)
    outside = np.flatnonzero(grows(radii))
    if outside[0] == 0:
        return 0.0
    low, high = radii[outside[0] - 1], radii[outside[0]]
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low / abs(eigenvalue))
