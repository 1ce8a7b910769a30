"""`thermal_strain`: elements free of stress at the length (1 + alpha dT) L.

Their Green-Lagrange strain there, eq. (6), is e = ((1 + alpha dT)^2 - 1)/2 = alpha dT + (alpha dT)^2/2;
E11 - e takes the place of E11 in eqs. (8), (19).
"""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.table import Table, number

LARGEST = 0.1  # |alpha dT|


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


def read_thermal_strain(table: Table) -> ThermalStrain | None:
    """The change; None with faults noted where it cannot be read."""
    change = table.need("temperature_change", number())
    coefficient = table.need("expansion_coefficient", number())
    if change is None or coefficient is None:
        return None
    if not abs(change * coefficient) <= LARGEST:
        table.faults.append(
            f"{table.path}: |temperature_change * expansion_coefficient| must be at most {LARGEST:g},"
            f" not {abs(change * coefficient):.6g}"
        )
    return ThermalStrain(change, coefficient)
