"""The Earth of the case format (docs/theory.md, section Effects)."""

EARTH_MU = 3.986004418e14  # gravitational parameter [m3/s2]
EARTH_RADIUS = 6378137.0  # equatorial [m]
EARTH_J2 = 1.08262668e-3  # second zonal harmonic [-]
