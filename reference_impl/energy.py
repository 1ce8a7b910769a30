"""Energies and momenta of states x (..., n, 3) [m], v (..., n, 3) [m/s]; eqs. (18), (19)."""

from __future__ import annotations

import numpy as np

from reference_impl.forces import System, strain, stress
from reference_impl.hill import orbital_potential
from reference_impl.weave import Floats


def kinetic(system: System, v: Floats) -> Floats:
    """K = 1/2 v^T M v (...) [J], eq. (18)."""
    return np.asarray(0.5 * np.einsum("n,...nc,...nc->...", system.net.mass, v, v))


def elastic(system: System, x: Floats) -> Floats:
    """U_el = 1/2 sum S11 E11 A L (...) [J], eq. (19)."""
    e11 = strain(system, x)
    return np.asarray(0.5 * (stress(system, e11) * e11) @ (system.net.area * system.net.reference_length))


def potential(system: System, x: Floats) -> Floats:
    """Potential of gravity, -sum m g.x, and of the orbit (...) [J], zero at x = 0, fixed nodes included."""
    mass, effects = system.net.mass, system.effects
    total = -np.einsum("n,...nc,c->...", mass, x, np.array(effects.gravity))
    if effects.orbit is not None:
        total = total + orbital_potential(effects.orbit, x) @ mass
    return np.asarray(total)


def momentum(system: System, v: Floats) -> Floats:
    """Linear momentum (..., 3) [kg m/s]."""
    return np.asarray(np.einsum("n,...nc->...c", system.net.mass, v))


def angular_momentum(system: System, x: Floats, v: Floats) -> Floats:
    """Angular momentum about the origin (..., 3) [kg m2/s]."""
    return np.asarray(np.einsum("n,...nc->...c", system.net.mass, np.cross(x, v)))
