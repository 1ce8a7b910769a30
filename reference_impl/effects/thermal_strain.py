"""`thermal_strain`: elements free of stress at the length (1 + alpha dT) L.

Their Green-Lagrange strain there, eq. (6), is e = ((1 + alpha dT)^2 - 1)/2 = alpha dT + (alpha dT)^2/2;
E11 - e takes the place of E11 in eqs. (8), (19).
"""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.table import Table, number


@dataclass(frozen=True)
class ThermalStrain:
    """`temperature_change` [K] against the reference configuration, `expansion_coefficient` [1/K]."""

    temperature_change: float
    expansion_coefficient: float

    @property
    def free_strain(self) -> float:
        """e [-], the Green-Lagrange strain of the stress-free length."""
        stretch = self.expansion_coefficient * self.temperature_change
        return stretch + 0.5 * stretch * stretch


def read_thermal_strain(table: Table) -> ThermalStrain:
    """The change of temperature."""
    return ThermalStrain(
        table.need("temperature_change", number), table.need("expansion_coefficient", number)
    )
