"""What `[effects.contact]` refuses, each with the line of the file and what to do."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from meshes import OUTLINE, extruded, keys_of

import exunet
from exunet.simulation.preparation import prepare_case

# The keys of contact begin at line 20; the head of the table is line 19.
CASE = """format = 1
title = "contact"
time = {{ end = 1.0, output_step = 0.1 }}
initial = {{ packing = 1.0 }}
net.topology = "square"
net.size = 0.4
net.mesh = 0.4
net.cable = {{ diameter = 0.001, density = 1000.0, youngs_modulus = 1e6 }}
{bullets}
[bodies.target]
{shape}
position = [0.0, 0.0, -1.0]
mass = 1.0
[bodies.point]
mass = 1.0
inertia = [1.0, 1.0, 1.0]
[effects.contact]
{contact}
"""
GOOD = {
    "threads": '["target"]',
    "law": '"linear"',
    "stiffness": "2e3",
    "restitution": "0.5",
    "impact_speed": "1.0",
}
BOX = 'shape = "box"\nsize = [0.2, 0.2, 0.2]\n'
BULLETS = {"bullets": '["target"]', "bullet_radius": "0.01", "bullet_stiffness": "1e3"}


def refused(
    folder: Path, keys: dict[str, str | None], bullets: bool, shape: str = BOX + "edge_radius = 0.02"
) -> str:
    """The message about a case with these keys in place of the good ones, without the folder."""
    lines = [f"{key} = {value}" for key, value in {**GOOD, **keys}.items() if value is not None]
    more = "net.bullets.mass = 0.01" if bullets else ""
    path = folder / "case.toml"
    path.write_text(CASE.format(contact="\n".join(lines), bullets=more, shape=shape))
    try:
        case = exunet.load(path)
        if "mesh" in shape:
            prepare_case(case)  # which makes its core
    except exunet.CaseError as error:
        return str(error).replace(f"{folder}/", "")
    return ""


@pytest.mark.parametrize("bullets", [False, True])
def test_what_is_right_is_read(bullets: bool, tmp_path: Path) -> None:
    assert refused(tmp_path, BULLETS if bullets else {}, bullets) == ""
    assert refused(tmp_path, {"law": '"hertz"', "stiffness": None, "modulus": "1e6"}, bullets) == ""
    assert (
        refused(
            tmp_path, {"friction": '{ law = "sticking", coefficient = 0.3, tangential_ratio = 1.0 }'}, bullets
        )
        == ""
    )
    assert refused(tmp_path, {"restitution": None, "impact_speed": None, "damping": "0.0"}, bullets) == ""


WRONG: dict[str, tuple[dict[str, str | None], str]] = {
    "no pair": ({"threads": None, "stiffness": None}, r":19: effects\.contact: "),
    "empty pairs": ({"threads": "[]"}, r":19: effects\.contact: "),
    "unknown": (
        {"threads": '["tagret"]'},
        r":20: effects\.contact\.threads\[0\]: ",
    ),
    "twice": (
        {"threads": '["target", "target"]'},
        r":20: effects\.contact\.threads\[1\]: ",
    ),
    "no shape": (
        {"threads": '["point"]'},
        r":20: effects\.contact\.threads\[0\]: ",
    ),
    "no bullets": (BULLETS, r"effects\.contact\.bullets: "),
    "radius alone": (
        {"bullet_radius": "0.01"},
        r"effects\.contact\.bullet_radius: ",
    ),
    "no stiffness": ({"stiffness": None}, r":19: effects\.contact: "),
    "no modulus": (
        {"law": '"hertz"', "stiffness": None},
        r":19: effects\.contact\.modulus: ",
    ),
    "stiffness of hertz": (
        {"law": '"hertz"', "modulus": "1e6"},
        r":22: effects\.contact\.stiffness: ",
    ),
    "stiffness of bullets": (
        {"bullet_stiffness": "1.0"},
        r"effects\.contact\.bullet_stiffness: ",
    ),
    "neither": (
        {"restitution": None, "impact_speed": None},
        r":19: effects\.contact: ",
    ),
    "both": (
        {"damping": "0.1"},
        r":19: effects\.contact: ",
    ),
    "half": ({"impact_speed": None}, r":19: effects\.contact: "),
    "bouncing up": ({"restitution": "1.1"}, r":23: effects\.contact\.restitution: "),
    "no restitution": ({"restitution": "0.0"}, r":23: effects\.contact\.restitution: "),
    "no table": ({"friction": "0.1"}, r":25: effects\.contact\.friction: "),
    "negative friction": (
        {"friction": '{ law = "sticking", coefficient = -0.1 }'},
        r":25: effects\.contact\.friction\.coefficient: ",
    ),
    "law of friction": ({"friction": "{ coefficient = 0.3 }"}, r":25: effects\.contact\.friction\.law: "),
    "no slip speed": (
        {"friction": '{ law = "regularised", coefficient = 0.3 }'},
        r":25: effects\.contact\.friction\.slip_speed: ",
    ),
    "memory": (
        {"friction": '{ law = "regularised", coefficient = 0.3, slip_speed = 1, tangential_damping = 1 }'},
        r":25: effects\.contact\.friction\.tangential_damping: ",
    ),
    "ratio": (
        {"friction": '{ law = "sticking", coefficient = 0.3, tangential_ratio = 1.5 }'},
        r":25: effects\.contact\.friction\.tangential_ratio: ",
    ),
    "law": ({"law": '"springs"'}, r":21: effects\.contact\.law: "),
    "stiffness": ({"stiffness": "0.0"}, r":22: effects\.contact\.stiffness: "),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_with_its_line(name: str, tmp_path: Path) -> None:
    keys, words = WRONG[name]
    found = refused(tmp_path, keys, bullets=False)
    assert re.search(words, found), found


def test_bullets_need_their_radius_and_stiffness(tmp_path: Path) -> None:
    found = refused(tmp_path, BULLETS | {"bullet_radius": None}, bullets=True)
    assert re.search(r":19: effects\.contact: ", found), found
    found = refused(tmp_path, BULLETS | {"bullet_stiffness": None}, bullets=True)
    assert re.search(r":19: effects\.contact: ", found), found


def test_edges_must_be_rounded(tmp_path: Path) -> None:
    found = refused(tmp_path, {}, bullets=False, shape=BOX)
    assert re.search(
        r":20: effects\.contact\.threads\[0\]: target has sharp edges.*bodies\.target\.edge_radius", found
    ), found


THIN_LEG = [(-0.05, -0.22), *OUTLINE[1:5], (0.25, -0.22)]
# Outline and half the thickness of a mesh, keys below its own, which are lines 11 to 13, and the message.
MESHES: dict[str, tuple[Any, float, str, str]] = {
    "sharp": (OUTLINE, 0.15, "", ":21: effects.contact.threads[0]: target has sharp edges"),
    "coarse": (
        OUTLINE,
        0.15,
        "edge_radius = 0.02\ngrid_spacing = 0.011",
        ":15: bodies.target.grid_spacing: ",
    ),
    "thin everywhere": (
        OUTLINE,
        0.015,
        "edge_radius = 0.02",
        ":14: bodies.target.edge_radius: leaves nothing of the mesh",
    ),
    "a thin leg": (THIN_LEG, 0.15, "edge_radius = 0.02", ":14: bodies.target.edge_radius: rounds away"),
    "too fine": (
        OUTLINE,
        0.15,
        "edge_radius = 0.02\ngrid_spacing = 1e-4",
        ":14: bodies.target.edge_radius: cells of 0.0001 m of the distance from the mesh take",
    ),
}


@pytest.mark.slow_for("a thin leg")
@pytest.mark.parametrize("name", MESHES)
def test_what_is_wrong_of_a_mesh_is_refused_with_its_line(name: str, tmp_path: Path) -> None:
    outline, half, more, words = MESHES[name]
    keys = keys_of(extruded(outline, half), tmp_path, "target")
    shape = "\n".join([*(f'{key} = "{value}"' for key, value in keys.items()), more])
    found = refused(tmp_path, {}, bullets=False, shape=shape)
    assert found.startswith(f"case.toml{words}"), found


def test_a_grid_is_for_meshes(tmp_path: Path) -> None:
    shape = 'shape = "sphere"\nradius = 0.1\ngrid_spacing = 0.01'
    found = refused(tmp_path, {}, bullets=False, shape=shape)
    assert ':13: bodies.target.grid_spacing: is for shape = "mesh"' in found, found


@pytest.mark.parametrize("given", [False, True])
def test_contact_that_no_step_can_follow_is_named(given: bool, tmp_path: Path) -> None:
    """Not the net's fastest element, which is 10 orders softer."""
    path, contact = tmp_path / "case.toml", {**GOOD, "stiffness": "1e25"}
    step = "solver.step = 1e-4\n" if given else ""
    text = CASE.replace("net.topology", f'solver.method = "RK44"\n{step}net.topology', 1)
    lines = "\n".join(f"{key} = {value}" for key, value in contact.items())
    path.write_text(text.format(contact=lines, bullets="", shape=BOX + "edge_radius = 0.02"))
    with pytest.raises(exunet.CaseError) as refusal:
        prepare_case(exunet.load(path))
    told = str(refusal.value)
    pressed = "the contact between threads and target"
    if given:
        assert ":6: solver.step: 0.0001 s is above the stable step" in told
        assert f"of RK44, limited by {pressed} (effects.contact)" in told
    else:
        assert ":20: effects.contact: " in told
        assert f"the limit is {pressed}: " in told


def test_damping_that_a_step_cannot_follow_is_named(tmp_path: Path) -> None:
    """A ball that is met at 2 m/s, with the restitution of an impact at 1 mm/s: such runs were accepted, and
    gained a thirtieth of all energy.
    """
    path = Path(__file__).parents[2] / "cases" / "capture" / "fixed_sphere.toml"
    prepare_case(exunet.load(path))
    slow = ["effects.contact.impact_speed=1e-3", "effects.contact.restitution=0.2"]
    with pytest.raises(exunet.CaseError) as refusal:
        prepare_case(exunet.load(path, slow))
    told = str(refusal.value)
    assert ":13: solver.step: 0.00015 s is above the stable step" in told
    assert "limited by damping between threads and ball at the speed of the start" in told
    elsewhere = [*slow, "initial.velocity=[0.0, 0.0, 0.0]", "bodies.ball.position=[0.0, 0.0, 0.5]"]
    prepare_case(exunet.load(path, elsewhere))  # nothing comes to it


@pytest.mark.parametrize("radius", [1.0, 10.0])
def test_a_start_with_the_body_in_a_bullet_is_refused(radius: float) -> None:
    """A ball of 0.25 m near a corner of a net with sides of 1.5 m: whole within a bullet of 10 m, for more
    than its middle within one of 1 m.
    """
    path = Path(__file__).parents[2] / "cases" / "capture" / "fixed_sphere.toml"
    keys = [f"effects.contact.bullet_radius={radius}", "bodies.ball.position=[0.6, 0.6, 0.3]"]
    with pytest.raises(exunet.CaseError) as refusal:
        prepare_case(exunet.load(path, keys))
    where = r"fixed_sphere.toml:46: effects.contact: invalid start: "
    deep = r"bullet \d is deeper than 0.5 m in ball, the body's least thickness, at t = 0 s"
    assert re.search(where + deep, str(refusal.value))


@pytest.mark.parametrize("slip_speed", [1e-300, 1e-3, 0.03, 0.1])
def test_steps_too_long_for_smooth_friction_are_noted(slip_speed: float) -> None:
    """Measured with these steps: the energy is off by 2.8e-3, 2.7e-3, 3.4e-4, and by 2.0e-4 as without it."""
    path = Path(__file__).parents[2] / "cases" / "capture" / "fixed_sphere.toml"
    keys = ['effects.contact.friction.law="regularised"', f"effects.contact.friction.slip_speed={slip_speed}"]
    notes = [
        item
        for item in prepare_case(exunet.load(path, keys)).plan.notes
        if "does not resolve friction" in item
    ]
    assert len(notes) == (slip_speed < 0.1)
    for note in notes:
        assert "friction between threads and ball at sliding speeds below 0.086 m/s" in note
    within = [*keys, "solver.step=1e-6"]
    notes = [
        entry
        for entry in prepare_case(exunet.load(path, within)).plan.notes
        if "does not resolve friction" in entry
    ]
    assert len(notes) == (slip_speed < 1e-4)
