"""The JSON schema and the template of the case format; every case of the repository."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from pydantic.fields import FieldInfo
from scenes import CASES

from exunet.base.record import Record, config_of
from exunet.forces.effects import EFFECTS
from exunet.methods.method import METHODS
from exunet.net import TOPOLOGIES
from exunet.scene.casefile import load
from exunet.scene.scene import Scene
from exunet.scene.template import example, is_named, json_schema, tables_of, template
from exunet.simulation.preparation import prepare_case


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
def test_the_template_is_a_valid_case_whose_net_moves(topology: str, tmp_path: Path) -> None:
    """Bullets are launched; a net of listed elements flies along z at the speed of the template."""
    path = tmp_path / "template.toml"
    path.write_text(template(topology))
    assert VALIDATOR.is_valid(tomllib.loads(template(topology)))
    start = prepare_case(load(path))
    assert start.scene.net.topology == topology
    speed = np.linalg.norm(start.state.velocity, axis=1)
    bullets = start.net.bullet_nodes
    expected = math.hypot(3.5, 2.0) if bullets.size else 1.0
    assert speed[bullets if bullets.size else slice(None)] == pytest.approx(expected, rel=1e-12)


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
    on = ("bodies.target", "capture")
    scene = switched("square", lambda name: name in on, tmp_path / "template.toml")
    assert scene.capture.enclosed == 0.9


@pytest.mark.parametrize("effect", EFFECTS)
def test_the_template_with_an_effect_on_is_a_valid_case(effect: str, tmp_path: Path) -> None:
    needed = ["effects.orbit"] if effect == "j2" else []
    needed += ["bodies.target"] if effect == "contact" else []
    changes = {"launch_force": ["launch"]}.get(effect, [])  # which it replaces
    changes += [] if getattr(EFFECTS[effect], "NEEDS_BULLETS", False) else ["launch", "net.bullets"]
    scene = switched(
        "square",
        lambda name: name in (f"effects.{effect}", *needed),
        tmp_path / "template.toml",
        [f"{table}=" for table in changes],
    )
    assert getattr(scene.effects, effect) is not None


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
    document = tomllib.loads((CASES / "planar_deployment.toml").read_text())
    *tables, name = key.split(".")
    table = document
    for item in tables:
        table = table[item]
    table[name] = tomllib.loads(f"x = {REFUSED[key]}")["x"]
    assert not VALIDATOR.is_valid(document)


SHIPPED = [*CASES.rglob("*.toml"), *(CASES.parent / "tests" / "data" / "faults").glob("*.toml")]


@pytest.mark.parametrize("path", sorted(SHIPPED), ids=lambda path: path.stem)
def test_every_case_of_the_repository_is_valid_and_fits_the_schema(path: Path) -> None:
    assert load(path).scene.format == 1
    assert VALIDATOR.is_valid(tomllib.loads(path.read_text(encoding="utf-8")))
