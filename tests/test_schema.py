"""The JSON schema and the template of the case format."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from pydantic.fields import FieldInfo

from exunet.base.record import Record, config_of
from exunet.case.casefile import load
from exunet.case.scene import Scene
from exunet.case.template import example, is_named, json_schema, tables_of, template
from exunet.forces.effects import EFFECTS
from exunet.forces.requirements import needs_bullets
from exunet.methods.method import METHODS
from exunet.net import TOPOLOGIES

CONTRACT = (Path(__file__).parents[1] / "cases" / "README.md").read_text(encoding="utf-8")
# The keys of cases/README.md, the contract between the two codes, outside [effects.NAME] and of all nets.
COMMON = """format title seed time.end time.output_step time.output_times net.topology net.divisions
    net.cable.diameter net.cable.area net.cable.density net.cable.youngs_modulus net.cable.strength
    initial.packing initial.restart initial.fold.pattern initial.fold.box initial.fold.cylinder
    initial.frame.body initial.frame.position initial.frame.attitude initial.frame.axis initial.frame.angle
    initial.frame.eject_at
    initial.velocity initial.spin initial.node_positions initial.node_velocities
    launch.radial_speed launch.axial_speed launch.speed launch.spread_angle
    bodies.NAME.mass bodies.NAME.density bodies.NAME.inertia bodies.NAME.products_of_inertia
    bodies.NAME.centre_of_mass bodies.NAME.shape bodies.NAME.size bodies.NAME.radius bodies.NAME.length
    bodies.NAME.radii bodies.NAME.file bodies.NAME.unit bodies.NAME.edge_radius
    bodies.NAME.grid_spacing bodies.NAME.position
    bodies.NAME.velocity bodies.NAME.attitude bodies.NAME.axis bodies.NAME.angle
    bodies.NAME.angular_velocity bodies.NAME.angular_velocity_frame
    bodies.NAME.motion bodies.NAME.pose_times bodies.NAME.pose_positions bodies.NAME.pose_attitudes
    bodies.NAME.attachments.NAME.point bodies.NAME.attachments.NAME.node bodies.NAME.attachments.NAME.bullet
    bodies.NAME.parts.NAME.shape bodies.NAME.parts.NAME.size bodies.NAME.parts.NAME.radius
    bodies.NAME.parts.NAME.length bodies.NAME.parts.NAME.radii bodies.NAME.parts.NAME.position
    bodies.NAME.parts.NAME.attitude bodies.NAME.parts.NAME.axis bodies.NAME.parts.NAME.angle
    tethers.NAME.diameter tethers.NAME.area tethers.NAME.density tethers.NAME.youngs_modulus
    tethers.NAME.strength
    tethers.NAME.length tethers.NAME.divisions tethers.NAME.start.node tethers.NAME.start.bullet
    tethers.NAME.start.body tethers.NAME.start.point tethers.NAME.end.node tethers.NAME.end.bullet
    tethers.NAME.end.body tethers.NAME.end.point
    tethers.NAME.reel.at tethers.NAME.reel.paid_out tethers.NAME.reel.shortest tethers.NAME.reel.largest_rate
    tethers.NAME.reel.damping tethers.NAME.reel.commands
    closing.kind closing.rings closing.nodes closing.start.node closing.start.bullet closing.start.tether
    closing.end.node closing.end.bullet closing.end.tether
    closing.length closing.stiffness closing.linear_density closing.ring_diameter
    closing.friction closing.strength closing.winch.at closing.winch.shortest closing.winch.largest_rate
    closing.winch.damping closing.winch.commands closing.at closing.rate closing.part
    control.bullets control.kind control.period control.largest_thrust control.minimum_impulse
    control.specific_impulse control.direction control.start control.noise.position control.noise.velocity
    control.noise.seed control.time control.force control.point control.body control.offset control.offsets
    control.stiffness control.damping
    capture.target capture.duration capture.enclosed capture.relative_speed capture.relative_spin capture.cqi
    capture.mcqi capture.mouth capture.touching capture.length capture.cqi_weights capture.mcqi_weights
    script
    effects.choose effects.threshold"""
THROWN = """net.strings.diameter net.strings.area net.strings.density net.strings.youngs_modulus
    net.strings.strength
    net.strings.length net.strings.divisions net.bullets.mass"""
BORDER = """net.border.diameter net.border.area net.border.density net.border.youngs_modulus
    net.border.strength"""


def of_effects() -> set[str]:
    """The keys in the rows below each row **`[effects.NAME]`**."""
    found, table = set(), ""
    for cell in re.findall(r"^\| ([^|]+) \|", CONTRACT, re.MULTILINE):
        if heading := re.match(r"\*\*`\[(.+)\]`\*\*", cell):
            table = heading[1]
        elif re.fullmatch(r"effects\.[a-z][\w.]*", table):
            found |= {f"{table}.{key}" for key in re.findall(r"`\.(\w+)`", cell)}
    return found


def of_topology(name: str) -> set[str]:
    """The keys in the second cell of its row."""
    row = re.search(rf"^\| `{name}` \| ([^|]+) \|", CONTRACT, re.MULTILINE)
    assert row is not None
    return {f"net.{key}" for key in re.findall(r"`(\w+)`", row[1])}


def contract(topology: str) -> set[str]:
    thrown = THROWN if topology != "explicit" else ""
    own = of_topology(topology)
    if "net.border" in own:
        own = own - {"net.border"} | {*BORDER.split()}
    return {*COMMON.split(), *thrown.split()} | of_effects() | own


def leaves(
    record: type[Record], topology: str, path: tuple[str, ...] = ()
) -> Iterator[tuple[str, FieldInfo]]:
    """Every key of a record that is not a table, by its dotted path."""
    for name, field in record.model_fields.items():
        inner = (*path, name, *(("NAME",) if is_named(field) else ()))
        tables = [config_of(TOPOLOGIES[topology], "NetConfig")] if name == "net" else tables_of(field)
        for table in tables if name not in ("script", "commands") else ():
            yield from leaves(table, topology, inner)
        if not tables or name in ("script", "commands"):
            yield ".".join(inner), field


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_format_has_the_keys_of_the_contract_and_no_other(topology: str) -> None:
    """But for [solver] and [engine], which the contract leaves to exunet."""
    found = {key for key, _ in leaves(Scene, topology) if not key.startswith(("solver.", "engine."))}
    assert found == contract(topology)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_key_has_a_description_and_an_example(topology: str) -> None:
    assert [key for key, field in leaves(Scene, topology) if not field.description] == []
    assert [key for key, field in leaves(Scene, topology) if example(field) is None] == []


def test_the_schema_is_json_and_its_references_resolve() -> None:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    text = json.dumps(schema)
    assert set(re.findall(r'"#/\$defs/(\w+)"', text)) <= set(schema["$defs"])
    for name in (*TOPOLOGIES, *EFFECTS, *METHODS):
        assert f'"{name}"' in text
    assert schema["additionalProperties"] is False


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_template_is_a_valid_case(topology: str, tmp_path: Path) -> None:
    path = tmp_path / "template.toml"
    path.write_text(template(topology))
    assert load(path).scene.net.topology == topology
    assert VALIDATOR.is_valid(tomllib.loads(template(topology)))


def test_the_template_has_every_key() -> None:
    """Keys of all topologies, commented out or not; of other alternatives those that are not tables."""
    text = template()
    for key, _ in leaves(Scene, "square"):
        name = key.rpartition(".")[2]
        assert re.search(rf"^(# *)*{name} = \S", text, re.MULTILINE), name


def with_tables(topology: str, on: Callable[[str], bool]) -> str:
    """The template with the optional tables that `on` names, by removing the first "# "."""
    lines, active = [], False
    for line in template(topology).splitlines():
        header = re.match(r"# \[([\w.]+)\]", line)
        if header or not line or line.startswith("["):
            active = bool(header and on(header[1]))
        lines.append(line.removeprefix("# ") if active else line)
    return "\n".join(lines)


def switched(topology: str, on: Callable[[str], bool], path: Path, changes: Sequence[str] = ()) -> Any:
    """The scene of the template with the optional tables that `on` names, and overrides."""
    path.write_text(with_tables(topology, on))
    return load(path, changes).scene


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_template_with_its_optional_tables_on_is_a_valid_case(topology: str, tmp_path: Path) -> None:
    """As its first lines say; effects, some of which exclude each other, come one at a time below.

    A fold takes the place of the packing; what is captured has a shape.
    """
    scene = switched(
        topology,
        lambda name: (
            not name.startswith("effects.")
            and name not in ("initial.fold", "capture")
            and (topology != "explicit" or not name.startswith(("launch", "control")))
        ),
        tmp_path / "template.toml",
    )
    assert (scene.launch is not None) == (topology != "explicit")


def test_the_template_with_a_capture_is_a_valid_case(tmp_path: Path) -> None:
    shaped = ('bodies.chaser.shape="sphere"', "bodies.chaser.radius=0.1")
    on = ("bodies.chaser", "capture")
    scene = switched("square", lambda name: name in on, tmp_path / "template.toml", shaped)
    assert scene.capture.enclosed == 0.9


@pytest.mark.parametrize("effect", EFFECTS)
def test_the_template_with_an_effect_on_is_a_valid_case(effect: str, tmp_path: Path) -> None:
    needed = ["effects.orbit"] if effect == "j2" else []
    needed += ["net.strings", "net.bullets"] if needs_bullets(EFFECTS[effect]) else []
    changes = ()
    if effect == "contact":  # of a body with a surface
        needed.append("bodies.chaser")
        changes = ('bodies.chaser.shape="sphere"', "bodies.chaser.radius=0.1")
        changes += ("bodies.chaser.position=[0.0,0.0,-5.0]",)
    scene = switched(
        "square", lambda name: name in (f"effects.{effect}", *needed), tmp_path / "template.toml", changes
    )
    assert getattr(scene.effects, effect) is not None


def test_a_template_of_an_unknown_topology_is_refused() -> None:
    with pytest.raises(KeyError):
        template("round")


ROOT = Path(__file__).parents[1] / "cases"
VALIDATOR = jsonschema.Draft202012Validator(json_schema())
# Changes of cases/planar_deployment.toml that a schema can report.
REFUSED = {
    "net.cable.area": "1e-6",
    "time.output_times": "[1.0]",
    "launch.speed": "2.5",
    "net.mesh": "-1.0",
    "net.colour": "3",
    "closing": "{ kind = 'perimeter', at = 1.0, rate = 1.0 }",
    "bodies": "{ 'a b' = { mass = 1.0, inertia = [1.0, 1.0, 1.0] } }",
    "effects.gravity": "{ acceleration = [0.0, 1.0] }",
}


@pytest.mark.parametrize("key", REFUSED)
def test_the_schema_refuses(key: str) -> None:
    document = tomllib.loads((ROOT / "planar_deployment.toml").read_text())
    *tables, name = key.split(".")
    table = document
    for one in tables:
        table = table[one]
    table[name] = tomllib.loads(f"x = {REFUSED[key]}")["x"]
    assert not VALIDATOR.is_valid(document)


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.toml")), ids=lambda path: path.stem)
def test_the_schema_accepts_every_case_of_the_repository(path: Path) -> None:
    assert VALIDATOR.is_valid(tomllib.loads(path.read_text()))
