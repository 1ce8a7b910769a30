"""Cords: fibres and metals that cables are made of, and how much of them a construction keeps.

A cord of the area A of a circle of its nominal diameter, voids included, of a fibre of density rho, modulus E
and strength S has

    density = fill rho,  youngs_modulus = fill k E,  strength = fill s S A,

with the fill factor, the part of A that is fibre, the modulus factor k and the strength factor s of its
construction. The area stays that of the circle, which contact, drag and sunlight meet.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple


class Fibre(NamedTuple):
    """A fibre or wire: density [kg/m3], Young's modulus [Pa], tensile strength [Pa], and where they stand."""

    density: float
    youngs_modulus: float
    strength: float
    source: str


class Construction(NamedTuple):
    """Factors of a construction: fibre per area, and per area of fibre modulus and strength."""

    fill: float
    modulus: float
    strength: float
    source: str


_TTI = "Tension Technology International, synthetic fibre yarn properties"
_TOYOBO = "Toyobo, Zylon technical information, 2005"

# Of specific values [N/tex], modulus and strength are these times the density, 1 N/tex = 1e6 N m/kg.
FIBRES: dict[str, Fibre] = {
    "nylon": Fibre(1140.0, 4.56e9, 0.9576e9, _TTI),
    "polyester": Fibre(1380.0, 13.8e9, 1.1592e9, _TTI),
    "kevlar_29": Fibre(1440.0, 70.56e9, 2.9232e9, _TTI),
    "kevlar_49": Fibre(1440.0, 112.32e9, 2.9952e9, _TTI),
    "technora": Fibre(1390.0, 73.67e9, 3.4055e9, "Teijin, tensile properties of Technora"),
    "vectran": Fibre(1410.0, 64.86e9, 2.8341e9, _TTI),
    "dyneema_sk75": Fibre(
        975.0,
        121.3875e9,
        3.315e9,
        "DSM, fact sheet CIS YA100, 2010",  # middle of 112 to 137 N/tex; least strength, 3.4 N/tex
    ),
    "zylon_as": Fibre(1540.0, 180e9, 5.8e9, _TOYOBO),
    "zylon_hm": Fibre(1560.0, 270e9, 5.8e9, _TOYOBO),
    "steel_wire": Fibre(7850.0, 204.1e9, 1.413e9, _TTI),
}
CONSTRUCTIONS: dict[str, Construction] = {
    "monofilament": Construction(1.0, 1.0, 1.0, "solid section"),
    # Seven equal circles in a circle fill 7/9; cos2 of the surface angle is 0.883 (Gegauff, 1907).
    "twisted": Construction(0.78, 0.88, 0.88, "six strands round one; surface angle of 20 degrees"),
    # Nylon, polyester and HMPE there against their fibres here: 0.63 to 0.65, 0.44 to 0.64, 0.34 to 0.54.
    "braided": Construction(0.64, 0.54, 0.44, "mean of mooring ropes of three fibres in MoorPy"),
}
FibreName = Literal[
    "nylon", "polyester", "kevlar_29", "kevlar_49", "technora", "vectran", "dyneema_sk75", "zylon_as",
    "zylon_hm", "steel_wire",
]  # fmt: skip
ConstructionName = Literal["monofilament", "twisted", "braided"]


class Cord(NamedTuple):
    """Properties of a cord of area A by fibre and construction: density [kg/m3], modulus, strength [Pa]."""

    density: float
    youngs_modulus: float
    strength: float


def cord(fibre: str | None, construction: str) -> Cord | None:
    """Return the properties of a cord per cross section; None without a fibre."""
    if fibre is None:
        return None
    of, kept = FIBRES[fibre], CONSTRUCTIONS[construction]
    fill = kept.fill
    return Cord(
        fill * of.density, fill * kept.modulus * of.youngs_modulus, fill * kept.strength * of.strength
    )


def circle(diameter: float) -> float:
    """Return the area of a circle [m2]."""
    return math.pi / 4 * diameter * diameter
