"""The JSON schema and the template: complete, and true to what `load` accepts."""

from __future__ import annotations

import copy
import itertools
import json
import random
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from pydantic import BaseModel

from exunet.base.errors import CaseError
from exunet.case.casefile import load
from exunet.case.checking import checked
from exunet.case.scene import Scene
from exunet.case.schema import example, json_schema, resolve, template
from exunet.forces.effects import EFFECTS, _pairs_schema
from exunet.forces.requirements import bullet_keys, needs_bullets
from exunet.methods.method import METHODS
from exunet.net import TOPOLOGIES

CONTRACT = (Path(__file__).parents[1] / "cases" / "README.md").read_text(encoding="utf-8")
# The keys of cases/README.md, the contract between the two codes, outside [effects.NAME] and of all nets.
COMMON = """format title seed time.end time.output_step time.output_times net.topology net.divisions
    net.cable.diameter net.cable.area net.cable.density net.cable.youngs_modulus net.cable.strength
    initial.packing initial.from initial.fold.pattern initial.fold.box initial.fold.cylinder
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
    verdict.target verdict.duration verdict.enclosed verdict.relative_speed verdict.relative_spin verdict.cqi
    verdict.mcqi verdict.mouth verdict.touching verdict.length verdict.cqi_weights verdict.mcqi_weights
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
        elif re.fullmatch(r"effects\.[a-z]\w*", table):
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


def leaves(topology: str, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every key of the schema that is not a table."""
    node = resolve(path, topology)
    names = node.get("properties") or (["NAME"] if "patternProperties" in node else [])
    if not names:
        yield path
    for name in names:
        yield from leaves(topology, (*path, name))


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_schema_has_the_keys_of_the_contract_and_no_other(topology: str) -> None:
    """But for [solver] and [engine], which the contract leaves to exunet."""
    found = {".".join(path) for path in leaves(topology) if path[0] not in ("solver", "engine")}
    assert found == contract(topology)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_key_has_a_description(topology: str) -> None:
    bare = [path for path in leaves(topology) if not resolve(path, topology).get("description")]
    assert bare == []


def test_the_schema_is_json_and_its_references_resolve() -> None:
    schema = json_schema()
    text = json.dumps(schema)
    assert set(re.findall(r'"#/\$defs/(\w+)"', text)) <= set(schema["$defs"])
    for name in (*TOPOLOGIES, *EFFECTS, *METHODS):
        assert f'"{name}"' in text
    assert schema["additionalProperties"] is False


def test_a_caller_cannot_change_the_schema() -> None:
    json_schema()["properties"].clear()
    assert json_schema()["properties"]


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_template_is_a_valid_case(topology: str, tmp_path: Path) -> None:
    path = tmp_path / "template.toml"
    path.write_text(template(topology))
    assert load(path).scene.net.topology == topology


def test_the_template_has_every_key() -> None:
    """Those of all topologies and of the solver too, commented out or not."""
    text = template()
    for topology in TOPOLOGIES:
        for *_, name in leaves(topology):
            assert re.search(rf"^(# *)*{name} = \S", text, re.MULTILINE), name
    for model in _models(Scene):
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name}"


def _models(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    yield model
    for field in model.model_fields.values():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _models(field.annotation)


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
            and name not in ("initial.fold", "verdict")
            and (topology != "explicit" or not name.startswith(("launch", "control")))
        ),
        tmp_path / "template.toml",
    )
    assert (scene.launch is not None) == (topology != "explicit")


def test_the_template_with_a_verdict_is_a_valid_case(tmp_path: Path) -> None:
    shaped = ('bodies.chaser.shape="sphere"', "bodies.chaser.radius=0.1")
    on = ("bodies.chaser", "verdict")
    scene = switched("square", lambda name: name in on, tmp_path / "template.toml", shaped)
    assert scene.verdict.enclosed == 0.9


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
CUT = ["net.mesh_shape='square'", "net.border={diameter=1e-3,density=1390.0,youngs_modulus=7e10}"]
# Overrides of cases/planar_deployment.toml that the reader refuses and that a schema can tell.
REFUSED = {
    "diameter and area": ["net.cable.area=1e-6"],
    "neither diameter nor area": ["net.strings.diameter="],
    "two ways to store": ["time.output_times=[1.0]"],
    "no way to store": ["time.output_step="],
    "half a launch": ["launch.axial_speed="],
    "half of another launch": ["launch={speed=2.5}"],
    "both launches": ["launch.speed=2.5", "launch.spread_angle=0.6"],
    "no launch at all": ["launch={}"],
    "nothing to launch": ["net.bullets="],
    "a title of two lines": ['title="a\\nb"'],
    "a title with a line break": ['title="a\\n"'],
    "another line break": ['title="a\\u2028b"'],
    "a title that colours the terminal": ['title="\\u001b[31mb"'],
    "an orbit without height": ["effects.orbit={radial=[0,0,1],along_track=[1,0,0],model='linear'}"],
    "breaking at nothing": ["effects.breaking={}"],
    "flow of no density": ["effects.molecular_drag={flow=[1,0,0],drag_coefficient=2,bullet_area=0.1}"],
    "gas without its keys": [
        "launch=",
        "effects.launch_force={kind='gas',force=1,stroke=1,spread_angle=0,chaser_mass=1,dead_length=1}",
    ],
    "springs with a key of gas": [
        "launch=",
        "effects.launch_force={kind='spring',force=1,stroke=1,spread_angle=0,chaser_mass=1,exponent=1.4}",
    ],
    "two chasers": [
        "launch=",
        "effects.launch_force={kind='spring',force=1,stroke=1,spread_angle=0,chaser_mass=1,body='chaser'}",
    ],
    "no chaser": ["launch=", "effects.launch_force={kind='spring',force=1,stroke=1,spread_angle=0}"],
    "a chaser at the origin of a carried net": [
        "launch=",
        "bodies={chaser={mass=1,inertia=[1,1,1]}}",
        "initial.frame={body='chaser'}",
        "effects.launch_force={kind='spring',force=1,stroke=1,spread_angle=0,chaser_mass=1}",
    ],
    "a choice without a threshold": ["effects.choose='auto'"],
    "J2 without its orbit": [
        "effects.j2={altitude=5e5,radial=[0,0,1],along_track=[1,0,0],inclination=1,argument_of_latitude=0}"
    ],
    "an accuracy of measures": ['solver={accuracy_of="measures",accuracy=1e-3}'],
    "a tolerance for measures": ['solver={accuracy_of="measures",tolerance=1e-3}'],
    "a method for measures": ['solver={accuracy_of="measures",method="RK44"}'],
    "packing and fold": ["initial.fold={pattern='accordion',box=[9,9,9]}"],
    "neither packing nor fold": ["initial.packing="],
    "two canisters": ["initial.packing=", "initial.fold={pattern='star',box=[9,9,9],cylinder=[9,9]}"],
    "no canister": ["initial.packing=", "initial.fold={pattern='star'}"],
    "a circle without corners": ["net.topology='cut'", *CUT, "net.outline='circle'"],
    "a square with corners": ["net.topology='cut'", *CUT, "net.outline='square'", "net.corners=4"],
    "bullets without bridles": ["net.topology=hexagonal", "net.size=", "net.rings=1", "net.strings="],
}


VALIDATOR = jsonschema.Draft202012Validator(json_schema())


def valid(document: Any) -> bool:
    return VALIDATOR.is_valid(document)


def readable(document: Any) -> bool:
    return not checked(copy.deepcopy(document))[1]


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(json_schema())


@pytest.mark.parametrize("what", REFUSED)
def test_the_schema_refuses_what_the_reader_refuses(what: str) -> None:
    document = tomllib.loads((ROOT / "planar_deployment.toml").read_text())
    assert valid(document)
    for override in REFUSED[what]:
        *tables, key = override.partition("=")[0].split(".")
        table = document
        for name in tables:
            table = table.setdefault(name, {})
        table.pop(key, None)
        if value := override.partition("=")[2]:
            table[key] = tomllib.loads(f"x = {value}")["x"] if value != "hexagonal" else value
    with pytest.raises(CaseError):
        load(ROOT / "planar_deployment.toml", REFUSED[what])
    assert not valid(document)


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.toml")), ids=lambda path: path.stem)
def test_the_schema_accepts_every_case_of_the_repository(path: Path) -> None:
    assert valid(tomllib.loads(path.read_text()))


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_schema_accepts_the_template(topology: str) -> None:
    assert valid(tomllib.loads(template(topology)))


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_value_of_the_template_is_within_its_own_bounds(topology: str) -> None:
    """Also of keys that it has commented out."""
    keys = {path: resolve(path, topology) for path in leaves(topology)}
    known = {"$defs": json_schema()["$defs"]}
    outside = [
        path
        for path, key in keys.items()
        if not jsonschema.Draft202012Validator(key | known).is_valid(example(key))
    ]
    assert outside == []


@pytest.mark.parametrize("method", [None, "auto", *METHODS])
def test_schema_and_reader_agree_on_every_method_and_its_keys(method: str | None) -> None:
    """Tolerance and step given or not, every loop, with and without breaking; both answers occur."""
    base = tomllib.loads(template("square"))
    answers = set()
    for tolerance, step, loop, breaking in itertools.product(
        (None, 1e-6), (None, 1e-5, 1e-13), (None, "exudyn", "compiled", "auto"), (False, True)
    ):
        solver = {"method": method, "tolerance": tolerance, "step": step}
        document = base | {"solver": {key: value for key, value in solver.items() if value is not None}}
        document |= {"engine": {"loop": loop}} if loop else {}
        document |= {"effects": {"breaking": {"strain": 0.03}}} if breaking else {}
        answers.add(readable(document))
        assert valid(document) == readable(document), (solver, loop, breaking)
    assert answers == {True, False}


def test_schema_and_reader_agree_on_every_pair_of_effects() -> None:
    """With and without bullets, the keys that they ask for, and a launch."""
    document = tomllib.loads(
        with_tables("square", lambda name: name not in ("effects", "initial.fold", "verdict"))
    )
    document.pop("solver")
    effects, launch, bullets = document.pop("effects"), document.pop("launch"), document["net"].pop("bullets")
    effects["molecular_drag"].pop("altitude")  # which would have to be that of the orbit
    effects["molecular_drag"]["density"] = 1e-12
    document["tethers"]["tow"].pop("reel")  # which some exclude
    document["initial"].pop("frame")  # with which a chaser at the origin does not go
    document["bodies"]["chaser"]["edge_radius"] = 0.01  # which contact asks for
    answers = []
    for pair in itertools.combinations_with_replacement(EFFECTS, 2):
        for thrown, keyed, launched in itertools.product((False, True), repeat=3):
            net = document["net"] | ({"bullets": bullets} if thrown else {})
            on = {name: dict(effects[name]) for name in pair}
            for name in pair if keyed else ():
                on[name] |= dict.fromkeys(bullet_keys(EFFECTS[name]), 0.1)
            case = document | {"net": net, "effects": on} | ({"launch": launch} if launched else {})
            answers.append(readable(case))
            assert valid(case) == answers[-1], (pair, thrown, keyed, launched)
    assert 0.2 < sum(answers) / len(answers) < 0.8  # neither says yes or no to all


def test_damping_of_broken_elements_is_refused_by_both() -> None:
    document = tomllib.loads(template("square"))
    for beta, fine in ((0.0, True), (1e-8, False)):
        damping = {"alpha": 1e-3, "beta": beta}
        document["effects"] = {"breaking": {"strain": 0.03}, "rayleigh_damping": damping}
        assert (valid(document), readable(document)) == (fine, fine)


def test_the_schema_knows_bodies_by_any_bare_name() -> None:
    document = tomllib.loads(template("square"))
    box = {"mass": 1.0, "inertia": [1.0, 2.0, 3.0]}
    for name, fine in (("box", True), ("target-2_a", True), ("a b", False), ("", False)):
        document["bodies"] = {name: box}
        assert (valid(document), readable(document)) == (fine, fine), name
    document["bodies"] = {"box": box | {"colour": "red"}}
    assert (valid(document), readable(document)) == (False, False)


DIMENSIONS: dict[str, dict[str, Any]] = {
    "box": {"size": [1.0, 1.0, 1.0]},
    "cylinder": {"radius": 1.0, "length": 1.0},
    "sphere": {"radius": 1.0},
    "capsule": {"radius": 1.0, "length": 1.0},
    "frustum": {"radii": [1.0, 0.5], "length": 1.0},
    "mesh": {"file": "x.stl", "unit": "mm"},
}
TABLE = {"pose_times": [0.0, 9.0], "pose_positions": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]}
OF_BODIES: dict[str, Any] = {
    "mass": 1.0,
    "density": 2.0,
    "inertia": [1.0, 1.0, 1.0],
    "products_of_inertia": [0.0, 0.0, 0.1],
    "centre_of_mass": [0.0, 0.0, 0.1],
    "edge_radius": 0.01,
    "grid_spacing": 0.004,
    "axis": [0.0, 0.0, 1.0],
    "angle": 1.0,
    "attitude": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 0.0],
    "velocity": [0.0, 0.0, 0.0],
    "angular_velocity": [0.0, 0.0, 1.0],
    "parts": {"a": {"shape": "sphere", "radius": 1.0}},
    "pose_attitudes": [[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.1]],
    "attachments": {"a": {"point": [0.0, 0.0, 0.0], "node": 1}},
    **TABLE,
    **{name: value for own in DIMENSIONS.values() for name, value in own.items()},
}


def random_body(draw: random.Random) -> dict[str, Any]:
    """Keys that mostly go together, some more, and perhaps one less."""
    body = {name: OF_BODIES[name] for name in ("mass", "inertia") if draw.random() < 0.7}
    if draw.random() < 0.5:
        shape = draw.choice(list(DIMENSIONS))
        body |= {"shape": shape, **DIMENSIONS[shape]}
    if draw.random() < 0.5:
        body["motion"] = draw.choice(["free", "fixed", "prescribed"])
        body |= TABLE if body["motion"] == "prescribed" and draw.random() < 0.7 else {}
    body |= {name: OF_BODIES[name] for name in draw.sample(list(OF_BODIES), draw.choice([0, 0, 1, 2]))}
    if body and draw.random() < 0.2:
        body.pop(draw.choice(list(body)))
    return body


def test_schema_and_reader_agree_on_bodies() -> None:
    """1000 random ones; both answers occur."""
    document, draw, answers = tomllib.loads(template("square")), random.Random(1), []
    for _ in range(1000):
        document["bodies"] = {"target": random_body(draw)}
        answers.append(readable(document))
        assert valid(document) == answers[-1], document["bodies"]
    assert 0.1 < sum(answers) / len(answers) < 0.9


def test_what_an_effect_declares_of_others_keys_is_for_reader_and_schema(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of breaking, which declares it; and of any other effect that would."""
    document = tomllib.loads((ROOT / "planar_deployment.toml").read_text())
    document["effects"]["breaking"] = {"strain": 0.03}
    assert not valid(document)
    words = "contradicts effects.rayleigh_damping.beta, which damps along broken elements too"
    assert any(words in reason for _, reason in checked(copy.deepcopy(document))[1])
    document["effects"]["rayleigh_damping"]["beta"] = 0.0
    assert valid(document)
    assert readable(document)
    monkeypatch.setattr(
        EFFECTS["gravity"], "NEEDS_ZERO", {"j2": {"inclination": "of a reason"}}, raising=False
    )
    zero = {"properties": {"inclination": {"const": 0}}}
    assert _pairs_schema()["dependentSchemas"]["gravity"]["properties"]["j2"] == zero
