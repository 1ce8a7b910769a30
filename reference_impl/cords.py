"""Cords of fibres, by specific values in N/tex (1e6 N m/kg): mass, stiffness and strength go with the fibre.

The numbers are those of the data sheets that the case format names (theory.md, Cords).  A cord of area A
has the fibre mass f rho A per length, of which a part k bears as the fibre does.
"""

from __future__ import annotations

from reference_impl.table import Table

# density [kg/m3] and specific modulus [N/tex]
_FIBRES = {
    "nylon": (1140.0, 4.0),
    "polyester": (1380.0, 10.0),
    "kevlar_29": (1440.0, 49.0),
    "kevlar_49": (1440.0, 78.0),
    "technora": (1390.0, 53.0),
    "vectran": (1410.0, 46.0),
    "dyneema_sk75": (975.0, 0.5 * (112.0 + 137.0)),
    "zylon_as": (1540.0, 180e3 / 1540.0),
    "zylon_hm": (1560.0, 270e3 / 1560.0),
    "steel_wire": (7850.0, 26.0),
}
# fibre per area f, and the part k of its stiffness that is left
_KEPT = {"monofilament": (1.0, 1.0), "twisted": (0.78, 0.88), "braided": (0.64, 0.54)}


def properties(table: Table) -> tuple[float, float] | None:
    """Density [kg/m3] and modulus [Pa] of the area of a cord; None where the table names no fibre."""
    table.ignore("strength", "knot_efficiency", "safety_factor")  # nothing depends on them here
    if "material" not in table:
        return None
    density, specific = _FIBRES[table.choice("material", *_FIBRES)]
    fill, part = _KEPT[table.choice("construction", *_KEPT) if "construction" in table else "monofilament"]
    mass = fill * density
    return mass, part * 1e6 * specific * mass
