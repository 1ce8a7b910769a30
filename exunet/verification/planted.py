"""Errors that the quick ladder must catch; tests/mutations plants each of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Planted:
    """An error to plant.

    name : for the tests
    what : is wrong
    code : in which code
    rung : the first that fails for it
    case : the one of the quick ladder's that shows it
    """

    name: str
    what: str
    code: str
    rung: int
    case: str = "planar_deployment"


_EXUDYN, _REFERENCE = "Exudyn's net", "reference"

PLANTED = (
    Planted("strain_without_half", "factor 1/2 missing in the Green-Lagrange strain", _EXUDYN, 2),
    Planted("no_length_ratio", "length ratio L/L0 missing in the tension", _EXUDYN, 2),
    Planted("engineering_strain", "engineering strain in place of Green-Lagrange", _EXUDYN, 2),
    Planted("compression", "slack cables push", _EXUDYN, 2),
    Planted("string_area", "strings with the area of the net's cable", _EXUDYN, 1),
    Planted("bullet_mass_lost", "bullet masses left out", _EXUDYN, 1),
    Planted("swapped_node", "one element joined to the wrong node", _EXUDYN, 1),
    Planted("damping_wrong_sign", "alpha with the wrong sign", _EXUDYN, 2),
    Planted("beta_lost", "beta T left out of the damping", _EXUDYN, 2),
    Planted("launch_inwards", "bullets launched inwards", _EXUDYN, 1),
    Planted("lumping_whole", "whole element mass at each of its ends", _EXUDYN, 1),
    Planted("stale_length", "elements slightly too long in the engine alone", _EXUDYN, 2),
    Planted("kinetic_doubled", "factor 1/2 missing in the kinetic energy", _EXUDYN, 2),
    Planted("elastic_doubled", "factor 1/2 missing in the elastic energy", _EXUDYN, 2),
    Planted("tension_doubled", "stored tensions twice as large", _EXUDYN, 2),
    Planted("mouth_doubled", "factor 1/2 missing in the area of the mouth", _EXUDYN, 6),
    Planted("coriolis_sign", "Coriolis force with the wrong sign", _EXUDYN, 2, "orbit"),
    Planted("mass_damping_sign", "mass damping that pushes on", _EXUDYN, 2, "mass_damping"),
    Planted("viscous_compression", "viscous stress that pushes", _EXUDYN, 2, "material_damping"),
    Planted("reference_potential_sign", "potential with the wrong sign", _REFERENCE, 2, "orbit"),
    Planted("reference_kinetic_doubled", "factor 1/2 missing in the kinetic energy", _REFERENCE, 2),
    Planted("reference_elastic_doubled", "factor 1/2 missing in the elastic energy", _REFERENCE, 2),
    Planted("reference_tension_doubled", "stored tensions twice as large", _REFERENCE, 2),
    Planted("reference_strain_sign", "stored strains of slack cables positive", _REFERENCE, 2),
    Planted("reference_current_tangent", "T at the current state in the damping", _REFERENCE, 2),
    Planted("reference_no_half", "factor 1/2 missing in the Green-Lagrange strain", _REFERENCE, 2),
    Planted("reference_compression", "slack cables push", _REFERENCE, 2),
    Planted("reference_tangent_formula", "geometric part missing in the tangent stiffness", _REFERENCE, 3),
    Planted("reference_asymmetric_secant", "sign error in one block of Delta, eq. (4)", _REFERENCE, 3),
    Planted("reference_rk4_weights", "weights of RK4 of the midpoint method", _REFERENCE, 4),
)
