"""Cords: properties of named fibres in both codes, and margins with knots and a safety factor."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError
from scenes import CASES, refused

import exunet
from exunet.net.base import Cable
from exunet.net.cords import CONSTRUCTIONS, FIBRES
from reference_impl.read import read_cable
from reference_impl.table import Table

CORDS = CASES / "nets" / "cords.toml"
PLAIN = "diameter=1e-3, density=1e3, youngs_modulus=1e9"
AREA = math.pi / 4 * 1e-6  # of 1 mm


def cable(**keys: Any) -> Cable:
    return Cable.model_validate({"diameter": 1e-3, **keys})


@pytest.mark.parametrize("construction", CONSTRUCTIONS)
@pytest.mark.parametrize("fibre", FIBRES)
def test_both_codes_have_the_same_cords(fibre: str, construction: str) -> None:
    """The tables were written apart: here in SI units, there as specific values in N/tex."""
    keys: dict[str, Any] = {"material": fibre, "construction": construction, "diameter": 1e-3}
    here, there = Cable.model_validate(keys), read_cable(Table(keys))
    for name in ("density", "youngs_modulus"):
        assert getattr(here, name) == pytest.approx(getattr(there, name), rel=1e-12)


@pytest.mark.parametrize(
    ("fibre", "specific"),  # N/tex of the data sheets
    [
        ("nylon", 0.84),
        ("polyester", 0.84),
        ("kevlar_29", 2.03),
        ("kevlar_49", 2.08),
        ("vectran", 2.01),
        ("technora", 2.45),
        ("dyneema_sk75", 3.4),
        ("steel_wire", 0.18),
    ],
)
def test_the_strength_is_that_of_the_data_sheet(fibre: str, specific: float) -> None:
    made = cable(material=fibre)
    assert made.strength == pytest.approx(specific * 1e6 * made.density * AREA, rel=1e-12)


def test_a_braid_of_polyester_is_near_the_mooring_rope_it_comes_from() -> None:
    """MoorPy: 678.75 d2 kg/m, EA = 14 x 308.2e6 d2 N; the factors are means over three fibres."""
    made, square = cable(material="polyester", construction="braided"), 1e-6
    assert made.density * AREA == pytest.approx(678.75 * square, rel=0.03)
    assert made.youngs_modulus * AREA == pytest.approx(14 * 308.2e6 * square, rel=0.2)


def test_a_key_that_is_given_overrides_the_material() -> None:
    made = cable(material="nylon", construction="braided", density=800.0, strength=500.0)
    assert (made.density, made.strength) == (800.0, 500.0)
    assert made.youngs_modulus == cable(material="nylon", construction="braided").youngs_modulus
    assert "density" not in made.assumed
    assert "youngs_modulus" in made.assumed
    with pytest.raises(ValidationError):
        cable(material="nylon", density=-1.0)


def test_margins_count_knots_and_the_safety_factor() -> None:
    """margin = strength x knot efficiency / (safety factor x largest tension) - 1, of the same motion."""
    margins = []
    for more in ([], ["net.cable.knot_efficiency=", "net.cable.safety_factor="]):
        result = exunet.run(exunet.load(CORDS, ["time.end=0.3", *more]))
        margins.append(exunet.margins(result)["threads"])
    counted, plain = margins
    assert counted.tension == plain.tension
    assert plain.strength == pytest.approx(0.64 * 0.44 * 3.315e9 * AREA, rel=1e-12)
    assert counted.margin == pytest.approx(plain.strength * 0.5 / (1.5 * plain.tension) - 1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("net.cable.material=dynema_sk75", "net.cable.material"),
        ("net.cable.construction=braid", "net.cable.construction"),
        ("net.cable.knot_efficiency=1.1", "net.cable.knot_efficiency"),
        ("net.cable.material=", "net.cable.density"),
        (f"net.cable={{{PLAIN}, knot_efficiency=0.5}}", "net.cable.knot_efficiency"),
        (f"net.cable={{{PLAIN}, construction='twisted'}}", "net.cable.construction"),
    ],
)
def test_errors_name_the_key(change: str, key: str) -> None:
    assert key in refused(CORDS, change)
