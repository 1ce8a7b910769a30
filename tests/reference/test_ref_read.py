"""The reader of reference_impl: what it takes, what it refuses, and how it says so."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from reference_impl import Refused, parse_override, read, read_document

CASES = Path(__file__).resolve().parents[2] / "cases"


@pytest.mark.parametrize("path", sorted(CASES.rglob("*.toml")), ids=lambda p: p.name)
def test_every_case_is_read_or_refused_by_name(path):
    faults = ()
    try:
        read(path)
    except Refused as refused:
        faults = refused.faults
    assert not faults or any("does not know" in fault for fault in faults)


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"effects.drag.rho": 1.0}, "reference_impl does not know effects.drag"),
        ({"net.colour": "red"}, "reference_impl does not know net.colour"),
        ({"net.cable.damping": 1.0}, "reference_impl does not know net.cable.damping"),
        ({"net.strings.slack": 1.0}, "reference_impl does not know net.strings.slack"),
        ({"wind.speed": 1.0}, "reference_impl does not know wind"),
        ({"net.topology": "spiral"}, 'reference_impl does not know net.topology = "spiral"'),
        ({"format": 2}, "reference_impl does not know format"),
        ({"format": None}, "format: missing"),
        ({"effects.rayleigh_damping.alpha": 1e-3}, "effects.rayleigh_damping.beta: missing"),
        ({"effects.gravity.acceleration": [0.0, 1.0]}, "effects.gravity.acceleration: must be a list of 3"),
        ({"net.size": -5.0}, "net.size: must be greater than 0"),
        ({"net.size": 5.5}, "net.mesh: net.size / net.mesh must be a whole number"),
        ({"net.divisions": 0}, "net.divisions: must be from 1"),
        ({"net.divisions": True}, "net.divisions: must be a whole number"),
        ({"net.cable.area": 1e-6}, "net.cable: give exactly one"),
        ({"net.cable.density": float("nan")}, "net.cable.density: must be finite"),
        ({"net.cable.density": 10**400}, "net.cable.density: must be finite"),
        ({"net.cable": None}, "[net.cable]: missing"),
        ({"net.bullets": None}, "launch: needs net.bullets"),
        ({"net.bullets": 3}, "net.bullets: must be a table"),
        ({"time.output_times": [0.5]}, "time: give exactly one"),
        ({"time.end": 0.0}, "time.end: must be greater than 0"),
        ({"time.output_step": 1e-12}, "time.output_step: more than"),
        ({"initial.packing": -0.1}, "initial.packing: must be at least 0"),
        ({"initial.node_positions": [[0.0, 0.0, 0.0]]}, "initial.node_positions: only for an explicit net"),
        ({"title": "a\nb"}, "title: must be one line"),
        ({"title.x": 1}, "title.x: cannot be set"),
    ],
)
def test_refuses_by_name(document, overrides, named):
    with pytest.raises(Refused) as refused:
        read_document(document(), overrides)
    assert any(fault.startswith(named) for fault in refused.value.faults), refused.value.faults


def test_a_throw_by_spread_angle(document):
    """docs/theory.md: radial v sin(angle), axial v cos(angle); 30 degrees by hand."""
    case = read_document(document() | {"launch": {"speed": 4.0, "spread_angle": math.pi / 6.0}})
    assert case.launch == pytest.approx((2.0, 2.0 * 3.0**0.5))


@pytest.mark.parametrize(
    ("launch", "fault"),
    [
        (
            {"speed": 4.0, "spread_angle": 0.2, "radial_speed": 2.5},
            "launch: give either launch.radial_speed or launch.speed and launch.spread_angle, not both",
        ),
        ({"speed": 4.0}, "launch.spread_angle: missing"),
        ({"speed": -4.0, "spread_angle": 0.1}, "launch.speed: must be at least 0, not -4"),
        ({"speed": 4.0, "spread_angle": 1.6}, "launch.spread_angle: must be at most 1.570796327, not 1.6"),
        ({"axial_speed": 4.0}, "launch.radial_speed: missing"),
    ],
)
def test_throws_that_contradict_themselves(document, launch, fault):
    with pytest.raises(Refused) as refused:
        read_document(document() | {"launch": launch})
    assert refused.value.faults == (fault,)


@pytest.mark.parametrize(
    ("net", "initial", "named"),
    [
        ({"elements": [[0, 2]]}, {}, "net.elements: there is no node 2"),
        ({"elements": [[0, 0]]}, {}, "net.elements: [0, 0] has no length"),
        ({"elements": [[0, -1]]}, {}, "net.elements: must be from 0"),
        ({"fixed": [7]}, {}, "net.fixed: there is no node 7"),
        ({"node_masses": [1.0]}, {}, "net.node_masses: 1 masses for 2 nodes"),
        ({"bullets": {"mass": 1.0}}, {}, "net.bullets: an explicit net has none"),
        ({}, {"node_positions": [[0.0, 0.0, 0.0]]}, "initial.node_positions: 1 entries for 2 nodes"),
        ({}, {"node_positions": [[0.0, 0.0, 0.0]] * 2, "packing": 0.5}, "initial.packing: must be 1"),
    ],
)
def test_refuses_explicit_nets_by_name(explicit, net, initial, named):
    case = explicit([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], **{"elements": [[0, 1]], "initial": initial, **net})
    with pytest.raises(Refused) as refused:
        read_document(case)
    assert refused.value.faults[0].startswith(named)


def test_reports_all_faults_at_once(document):
    with pytest.raises(Refused) as refused:
        read_document(document(), {"net.colour": 1, "time.end": "soon", "effects.drag.rho": 1.0})
    assert len(refused.value.faults) == 3


def test_hexagonal_bullets_need_strings_that_reach(document):
    for overrides, named in (
        ({"net.strings": None}, "net.bullets"),
        ({"net.strings.length": 0.25}, "net.str"),
    ):
        with pytest.raises(Refused, match=named):
            read_document(document("hexagonal"), overrides)


def test_ignores_how_the_other_program_integrates(document):
    read_document(document(), {"solver.method": "anything", "engine.backend": 3})


def test_stored_times(document):
    assert read_document(document(), {"time.output_step": 0.3}).times == pytest.approx((0, 0.3, 0.6, 0.9, 1))
    assert read_document(document()).times == (*(k * 0.1 for k in range(10)), 1.0)
    assert read_document(document(), {"time.output_step": 7.0}).times == (0.0, 1.0)
    listed = {"time.output_step": None, "time.output_times": [0.25, 0.5]}
    assert read_document(document(), listed).times == (0.0, 0.25, 0.5, 1.0)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("net.size=4", 4),
        ("net.size=4.0", 4.0),
        ("net.size=[1, 2]", [1, 2]),
        ("net.size=true", True),
        ("net.size=square", "square"),
        ('net.size="square"', "square"),
    ],
)
def test_override_values_are_toml_or_else_text(text, value):
    assert parse_override(text) == ("net.size", value)


def test_override_without_a_value_is_refused():
    with pytest.raises(Refused, match="expected key"):
        parse_override("net.size")


def test_unreadable_files_are_refused(tmp_path):
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    (tmp_path / "broken.toml").write_text("format = \n")
    for name in ("none.toml", "bytes.toml", "broken.toml", ""):
        with pytest.raises(Refused) as refused:
            read(tmp_path / name)
        assert len(refused.value.faults) == 1
