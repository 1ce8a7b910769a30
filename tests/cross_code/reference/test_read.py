"""The reader of reference_impl and the command that `--check` calls: what is read, refused and written."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from reference_impl import Refused, load, parse_override, read, read_document
from reference_impl.__main__ import main
from reference_impl.arrays import rotation

CASES = Path(__file__).resolve().parents[3] / "cases"
SHIPPED = sorted(path for path in CASES.rglob("*.toml") if path.parent.name != "studies")
PLANAR, SHORT = CASES / "planar_undamped.toml", ["--set", "time.end=0.02", "--set", "time.output_step=0.005"]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.name)
def test_every_case_is_read_or_refused_by_name(path):
    faults = ()
    try:
        read(path)
    except Refused as refused:
        faults = refused.faults
    assert all("does not know" in fault for fault in faults)


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"effects.drag.rho": 1.0}, "effects.drag"),
        ({"effects.orbit": {"model": "j2", "altitude": 7e5}}, "effects.orbit"),
        ({"effects.contact": {"bodies": ["a"]}}, "effects.contact.bodies"),
        ({"net.strings.slack": 1.0}, "net.strings.slack"),
        ({"net.topology": "spiral"}, 'net.topology = "spiral"'),
        ({"initial.restart": "result.h5"}, "initial.restart"),
        ({"bodies.a": {"mass": 1.0, "inertia": [1.0] * 3, "spin": 1.0}}, "bodies.a.spin"),
        ({"bodies.a": {"mass": 1.0, "shape": "cone"}}, 'bodies.a.shape = "cone"'),
        ({"net.size": "wide"}, "net.size"),
        ({"time.output_step": None}, "time"),
    ],
)
def test_what_is_not_known_is_refused_by_name(document, overrides, named):
    with pytest.raises(Refused) as refused:
        read_document(document(), overrides)
    assert named in refused.value.faults[0]


def test_a_throw_by_spread_angle(document):
    """docs/explanation/theory.md: radial v sin(angle), axial v cos(angle); 30 degrees by hand."""
    case = read_document(document() | {"launch": {"speed": 4.0, "spread_angle": math.pi / 6.0}})
    assert case.launch is not None
    assert case.launch[:2] == pytest.approx((2.0, 2.0 * 3.0**0.5))


def test_stored_times(document):
    assert read_document(document(), {"time.output_step": 0.3}).times == pytest.approx((0, 0.3, 0.6, 0.9, 1))
    assert read_document(document()).times == (*(k * 0.1 for k in range(10)), 1.0)
    assert read_document(document(), {"time.output_step": 7.0}).times == (0.0, 1.0)
    listed = {"time.output_step": None, "time.output_times": [0.25, 0.5]}
    assert read_document(document(), listed).times == (0.0, 0.25, 0.5, 1.0)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("4", 4),
        ("4.0", 4.0),
        ("[1, 2]", [1, 2]),
        ("true", True),
        ("square", "square"),
        ('"a"', "a"),
        ("", None),
    ],
)
def test_override_values_are_toml_or_else_text(text, value):
    assert parse_override(f"net.size={text}") == ("net.size", value)


def test_overrides_reach_items_of_lists(document):
    """An index is of an item of a list, or of a table with a chosen name; what is read says so itself."""
    bodies = {name: {"shape": "box", "size": [0.5, 0.4, 0.3], "mass": 2.0} for name in ("other", "box")}
    scene = {**document(), "bodies": bodies}
    other, body = read_document(scene, {"bodies.box.size[1]": 0.6, "bodies[1].mass": 3.0}).bodies
    assert (other.mass, body.mass) == (2.0, 3.0)
    assert np.diag(body.inertia) == pytest.approx([0.1125, 0.085, 0.1525], rel=1e-14)  # m (b2 + c2) / 12
    for path in ("bodies.box.size[3]", "bodies.box.mass[0]", "bodies[2].mass", "bodies.box.mass.x"):
        with pytest.raises(Refused, match="cannot be set"):
            read_document(scene, {path: 1.0})


# bodies

CONE = {"shape": "frustum", "radii": [1.0, 0.0], "length": 2.0}
OWN = {"mass": 2.0, "inertia": [1.0, 2.0, 2.5]}
TURNED = [1.0, 2.0, -1.0, 0.5]


@pytest.fixture(scope="module")
def read_body(document):
    """read_body(**keys): the body of a case with these keys."""

    def make(**keys):
        (body,) = read_document({**document(), "bodies": {"box": keys}}).bodies
        return body

    return make


def test_given_inertia_stands_beside_a_shape(read_body):
    """The shape then gives volume and centre of mass, unless that is given too."""
    assert read_body(**CONE, mass=3.0).centre_of_mass == pytest.approx([0.0, 0.0, -0.5], rel=1e-14)
    inertia = {"inertia": [1.0, 2.0, 2.5]}
    for given, mass in (({"mass": 3.0}, 3.0), ({"density": 3.0}, 2.0 * math.pi)):
        body = read_body(**CONE, **inertia, **given)
        assert body.mass == pytest.approx(mass, rel=1e-14)
        assert np.array_equal(body.inertia, np.diag([1.0, 2.0, 2.5]))
        assert body.centre_of_mass == pytest.approx([0.0, 0.0, -0.5], rel=1e-14)
    moved = read_body(**CONE, **inertia, mass=3.0, centre_of_mass=[0.1, 0.2, 0.3])
    assert np.array_equal(moved.centre_of_mass, [0.1, 0.2, 0.3])


def test_products_of_inertia_are_elements_of_the_matrix(read_body):
    """A boom along x = y has Ixy = -integral of x y dm < 0."""
    body = read_body(**OWN, products_of_inertia=[0.1, -0.2, 0.3], centre_of_mass=[1.0, 0.0, 0.0])
    assert np.array_equal(body.inertia, [[1.0, 0.1, -0.2], [0.1, 2.0, 0.3], [-0.2, 0.3, 2.5]])
    assert np.array_equal(body.centre_of_mass, [1.0, 0.0, 0.0])
    boom = {"shape": "box", "size": [2.0, 0.1, 0.1], "axis": [0.0, 0.0, 3.0], "angle": math.pi / 4.0}
    body = read_body(density=1.0, parts={"boom": boom})
    assert body.inertia[0, 1] == pytest.approx(-body.mass * (4.0 - 0.01) / 24.0, rel=1e-13)


def test_a_compound_by_hand(read_body):
    """A hub pi/4 m3 in the origin and a boom of 0.16 m3 at (2.5, 0, 0.25): two points and two matrices."""
    parts = {
        "hub": {"shape": "cylinder", "radius": 0.5, "length": 1.0},
        "boom": {"shape": "box", "size": [4.0, 0.2, 0.2], "position": [2.5, 0.0, 0.25]},
    }
    volumes = math.pi / 4.0, 0.16
    total = sum(volumes)
    arm, lift = volumes[1] / total * 2.5, volumes[1] / total * 0.25
    both = volumes[0] * volumes[1] / total  # of the pair, as one point at their distance
    hub = volumes[0] * np.array([(0.75 + 1.0) / 12.0, (0.75 + 1.0) / 12.0, 0.125])
    boom = volumes[1] * np.array([0.08, 16.04, 16.04]) / 12.0
    expected = np.diag(hub + boom + both * np.array([0.0625, 6.3125, 6.25]))
    expected[0, 2] = expected[2, 0] = -both * 2.5 * 0.25
    for given, scale in (({"density": 3.0}, 3.0), ({"mass": 5.0}, 5.0 / total)):
        body = read_body(parts=parts, **given)
        assert body.mass == pytest.approx(scale * total, rel=1e-14)
        assert body.centre_of_mass == pytest.approx([arm, 0.0, lift], rel=1e-14)
        assert body.inertia == pytest.approx(scale * expected, rel=1e-13, abs=1e-14)


def test_an_axis_and_an_angle_are_an_attitude(read_body):
    w, s = math.cos(0.35), math.sin(0.35) / math.sqrt(14.0)
    expected = read_body(**OWN, attitude=[w, s, 2.0 * s, 3.0 * s]).attitude
    for axis in ([1.0, 2.0, 3.0], [1e-200, 2e-200, 3e-200], [1e300, 2e300, 3e300]):
        assert read_body(**OWN, axis=axis, angle=0.7).attitude == pytest.approx(expected, abs=1e-15)


def test_position_is_of_the_frame_and_velocity_of_the_centre_of_mass(scene, document):
    body = {
        **OWN,
        "centre_of_mass": [0.5, -1.0, 2.0],
        "position": [10.0, 20.0, 30.0],
        "velocity": [1.0, 2.0, 3.0],
        "attitude": TURNED,
        "angular_velocity": [0.1, 0.2, 0.3],
    }
    made = scene({**document(), "bodies": {"box": body}})
    start, turn = made.bodies0, rotation(tuple(TURNED))
    assert start.position[0] == pytest.approx([10.0, 20.0, 30.0] + turn @ [0.5, -1.0, 2.0], rel=1e-15)
    assert np.array_equal(start.velocity[0], [1.0, 2.0, 3.0])
    assert np.array_equal(start.angular_velocity[0], [0.1, 0.2, 0.3])
    assert np.array_equal(start.attitude[0], turn)
    assert np.array_equal(made.system.bodies.centre_of_mass, [[0.5, -1.0, 2.0]])


def test_frames_of_the_angular_velocity(read_body):
    """The same vector in the axes of the body or of the scene; a quarter turn about z by hand."""
    spin, body = [0.1, 0.2, 0.3], {**OWN, "attitude": TURNED, "angular_velocity": [0.1, 0.2, 0.3]}
    for keys in ({}, {"angular_velocity_frame": "body"}):
        assert np.array_equal(read_body(**body, **keys).angular_velocity, spin)
    of_scene = read_body(**body, angular_velocity_frame="scene").angular_velocity
    assert rotation(tuple(TURNED)) @ of_scene == pytest.approx(spin, rel=1e-14)
    quarter = {"axis": [0.0, 0.0, 1.0], "angle": math.pi / 2.0, "angular_velocity_frame": "scene"}
    about_x = read_body(**OWN, **quarter, angular_velocity=[2.0, 0.0, 0.0])
    assert about_x.angular_velocity == pytest.approx([0.0, -2.0, 0.0], abs=1e-15)


# the command

FULL = "mass=2.0,inertia=[1.5,2.0,2.5],products_of_inertia=[0.1,-0.2,0.3],centre_of_mass=[0.5,0.0,0.0]"


def test_the_command_writes_the_states_of_net_and_bodies(tmp_path, capsys):
    out, body = tmp_path / "out.npz", f"bodies.box={{{FULL},position=[1.0,2.0,3.0]}}"
    assert main([str(PLANAR), str(out), *SHORT, "--set", body]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (lines[0], lines[-1]) == ("known", "0.02")
    made = load(PLANAR, {"time.end": 0.02, "time.output_step": 0.005})
    with np.load(out) as file:
        assert file["complete"]
        assert file["time"].tolist() == [0.0, 0.005, 0.01, 0.015, 0.02]
        assert file["position"].shape == file["velocity"].shape == (5, 40, 3)
        assert np.array_equal(file["position"][0], made.x0)
        assert np.array_equal(file["mass"], made.net.mass)
        assert file["axial_stiffness"] == pytest.approx(made.net.youngs_modulus * made.net.area)
        assert file["body_inertia"].tolist() == [[[1.5, 0.1, -0.2], [0.1, 2.0, 0.3], [-0.2, 0.3, 2.5]]]
        assert file["body_position"][0, 0].tolist() == [1.5, 2.0, 3.0]


def test_the_command_writes_what_broke(tmp_path):
    assert main([str(CASES / "effects" / "breaking.toml"), str(tmp_path / "out.npz")]) == 0
    with np.load(tmp_path / "out.npz") as file:
        assert file["break_element"].tolist() == [0]
        assert 0.0 < file["break_time"][0] < file["time"][-1]


def test_the_command_refuses_and_diverges_with_exit_codes(tmp_path, capsys):
    out = tmp_path / "out.npz"
    for wrong in (["--set", "effects.drag.rho=1"], ["--set", "net.size"], ["--places", "none.npz"]):
        assert main([str(PLANAR), str(out), *wrong]) == 2
        assert capsys.readouterr().err.startswith("reference_impl: ")
        assert not out.exists()
    assert main([str(PLANAR), str(out), "--set", "initial.packing=1e120"]) == 3
    with np.load(out) as file:
        assert not file["complete"]
        assert len(file["time"]) == 1
