"""The effects of the case format (docs/theory.md): one module each, with its record, reader and equation.

They know arrays and the record of a net, nothing of how a system is put together or integrated.
Rayleigh, mass and material damping are parts of the elements' law: see `reference_impl.internal`.
"""

from reference_impl.effects.choice import Effects, Surroundings, read_effects
from reference_impl.effects.earth import EARTH_MU, EARTH_RADIUS
from reference_impl.effects.orbit import Orbit

__all__ = ["EARTH_MU", "EARTH_RADIUS", "Effects", "Orbit", "Surroundings", "read_effects"]
