"""Case files: what is read, every kind of error with its line, overrides; the JSON schema, the template."""

from __future__ import annotations

import json
import math
import os
import re
import string
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import CASES, SHIPPED_CASES

from exunet.base.errors import CaseError, CaseWarning, Fault, InputError
from exunet.forces.effects import EFFECTS
from exunet.methods.method import METHODS
from exunet.net import TOPOLOGIES
from exunet.scene.casefile import Case, load
from exunet.scene.document import MAX_BYTES, key_lines
from exunet.scene.template import json_schema, template
from exunet.simulation.preparation import prepare_case

PLANAR = CASES / "planar_deployment.toml"

# Line numbers in the tests below count in this text; its first line is line 1.
GOOD = """\
format = 1
title = "a test"
[time]
end = 1.0
output_step = 0.1
[net]
topology = "square"
size = 2.0
mesh = 1.0
[net.cable]
diameter = 0.002
density = 1390.0
youngs_modulus = 70e9
[net.strings]
length = 0.5
diameter = 0.002
density = 1390.0
youngs_modulus = 70e9
[net.bullets]
mass = 0.5
[initial]
packing = 0.1
[launch]
radial_speed = 2.5
axial_speed = 0.0
[effects.rayleigh_damping]
alpha = 1e-3
beta = 1e-8
"""
EXPLICIT = """\
format = 1
title = "explicit"
time = { end = 1.0, output_times = [0.5] }
[net]
topology = "explicit"
nodes = [
  [0, 0, 0],  # first
  [1, 0, 0],

  [2, 0, 0], [3, 0, 0],
]
elements = [[0, 1], [1, 2],
  [2, 3]]
cable = { area = 1e-6, density = 1000, youngs_modulus = 1e9 }
[initial]
packing = 1
"""


@pytest.fixture
def case(tmp_path: Path) -> Any:
    """A function that writes a case, loads it, and returns the faults as (line, key, reason)."""

    def faults(text: str, *overrides: str) -> list[tuple[int, str, str]]:
        path = tmp_path / "case.toml"
        path.write_text(text, newline="")
        with pytest.raises(CaseError) as caught:
            load(path, overrides)
        return [(_line(fault, path), fault.key, fault.reason) for fault in caught.value.faults]

    return faults


def _line(fault: Fault, path: Path) -> int:
    """The line of a fault; 0 if it is placed at an override."""
    if fault.place.startswith("--set "):
        return 0
    file, _, line = fault.place.rpartition(":")
    assert file == str(path)
    return int(line)


def changed(old: str, new: str, text: str = GOOD) -> str:
    assert text.count(old) == 1, f"{old!r} must occur once"
    return text.replace(old, new)


# Good cases


def test_the_papers_case_is_read() -> None:
    """Table 1 and sec. 3.3 of the paper."""
    case = load(PLANAR)
    assert case.scene.net.size == 5.0
    assert case.scene.net.bullets.mass == 0.5
    assert case.scene.launch is not None
    assert case.scene.launch.radial_speed == 2.5
    assert case.scene.effects.rayleigh_damping.beta == 1e-8
    assert case.scene.effects.gravity is None
    assert (case.name, case.path, case.overrides) == ("planar_deployment", PLANAR, ())
    assert case.text.encode() == PLANAR.read_bytes()


def test_whole_numbers_and_lists_stand_for_floats_and_tuples(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text(EXPLICIT)
    net = load(path).scene.net
    assert net.nodes[1] == (1.0, 0.0, 0.0)
    assert isinstance(net.nodes[1][0], float)
    assert net.elements == ((0, 1), (1, 2), (2, 3))


@pytest.mark.parametrize(("old", "new", "line"), [("", "", 4), ("a test", '""\\\r\n  a test""', 5)])
def test_faults_of_a_crlf_file_have_their_lines(case: Any, old: str, new: str, line: int) -> None:
    """Lines counted in `GOOD`; a line break within a string counts too."""
    text = changed("end = 1.0", "end = 0").replace(old, new, 1).replace("\r\n", "\n").replace("\n", "\r\n")
    found = case(text, "solver.method=foo")
    assert [(line, key) for line, key, _ in found] == [(line, "time.end"), (0, "solver.method")]


# Errors, each with its line


@pytest.mark.parametrize(
    ("old", "new", "line", "key"),
    [
        # A value of the wrong type or out of bounds: the line of the key.
        ("end = 1.0", "end = -3.0", 4, "time.end"),
        ("end = 1.0", 'end = "1.0"', 4, "time.end"),
        ("end = 1.0", "end = nan", 4, "time.end"),
        ("end = 1.0", "end = 1e999", 4, "time.end"),
        ("end = 1.0", "end = [1, 2, true]", 4, "time.end"),
        ("packing = 0.1", "packing = -1", 22, "initial.packing"),
        ("mesh = 1.0", "mesh = 1.0\ndivisions = 0", 10, "net.divisions"),
        ("mesh = 1.0", "mesh = 1.0\ndivisions = 2.0", 10, "net.divisions"),
        ('title = "a test"', "title = 3", 2, "title"),
        ('title = "a test"', 'title = "\\u001b[31mb"', 2, "title"),
        ("format = 1", "format = 2", 1, "format"),
        ("format = 1", "format = true", 1, "format"),
        ("packing = 0.1", "packing = 0\nspin = [1, 2]", 23, "initial.spin"),
        ("packing = 0.1", "packing = 0\nspin = 7", 23, "initial.spin"),
        ("packing = 0.1", 'packing = 0\nspin = [1, 2, "3"]', 23, "initial.spin[2]"),
        ("[launch]\nradial_speed = 2.5\naxial_speed = 0.0\n", "[[launch]]\n", 23, "launch"),
        # A key that is missing: the line of its table's header; a table that is missing: the first line.
        ("end = 1.0\n", "", 3, "time.end"),
        ("mass = 0.5\n", "", 19, "net.bullets.mass"),
        ("alpha = 1e-3\n", "", 26, "effects.rayleigh_damping.alpha"),
        ('title = "a test"\n', "", 1, "title"),
        ("[initial]\npacking = 0.1\n", "", 1, "initial"),
        ('topology = "square"\n', "", 6, "net.topology"),
        # An unknown key: a suggestion, or the known ones.
        ("mass = 0.5", "mass = 0.5\nmas = 1", 21, "net.bullets.mas"),
        ("[launch]", "[lunch]", 23, "lunch"),
        ("[effects.rayleigh_damping]", "[effects.raleigh]", 26, "effects.raleigh"),
        ("mesh = 1.0", "mesh = 1.0\nspokes = 3", 10, "net.spokes"),
        ("mesh = 1.0", 'mesh = 1.0\n"a b" = 3', 10, "net.'a b'"),
        # A word that is not among the allowed ones.
        ('"square"', '"hexagon"', 7, "net.topology"),
        ('"square"', "4", 7, "net.topology"),
        ("[net]", '[solver]\nmethod = "RK4"\n[net]', 7, "solver.method"),
        # Faults between keys.
        ("mesh = 1.0", "mesh = 0.7", 9, "net.mesh"),
        ("size = 2.0", "size = 1e9", 9, "net.mesh"),
        ("mesh = 1.0", "mesh = 0.002", 6, "net"),
        ("output_step = 0.1", "output_step = 1e-9", 5, "time.output_step"),
        ("output_step = 0.1\n", "", 3, "time"),
        ("output_step = 0.1", "output_step = 0.1\noutput_times = [1]", 6, "time.output_times"),
        ("output_step = 0.1", "output_times = [0, 0.5, 0.5]", 5, "time.output_times[2]"),
        ("output_step = 0.1", "output_times = [0.5, 1.5]", 5, "time.output_times[1]"),
        ("diameter = 0.002\ndensity = 1390.0\nyoungs_modulus = 70e9\n[net.strings]", "density = 1390.0\n"
         "youngs_modulus = 70e9\n[net.strings]", 10, "net.cable"),
        ("mass = 0.5", "mass = 0.5\n[net.cable.x]", 21, "net.cable.x"),
        ("[net.bullets]\nmass = 0.5\n", "", 21, "launch"),
        ("axial_speed = 0.0", "axial_speed = 0.0\nspeed_factors = [1, 1, 1]", 26, "launch.speed_factors"),
        ("axial_speed = 0.0", "axial_speed = 0.0\ntilts = [[0, 0]]", 26, "launch.tilts"),
        ("packing = 0.1", "packing = 1\nnode_positions = [[0, 0, 0]]", 23, "initial.node_positions"),
        ("packing = 0.1", "packing = 1\nnode_velocities = []", 23, "initial.node_velocities"),
        ("end = 1.0", f"end = 0x{'f' * 5000}", 4, "time.end"),
    ],
)  # fmt: skip
def test_one_fault(case: Any, old: str, new: str, line: int, key: str) -> None:
    ((found_line, found_key, _),) = case(changed(old, new))
    assert (found_line, found_key) == (line, key)


@pytest.mark.parametrize(
    ("old", "new", "line", "key"),
    [
        ("[1, 0, 0],\n", "[1, 0],\n", 8, "net.nodes[1]"),
        ("[3, 0, 0]", '[3, "a", 0]', 10, "net.nodes[3][1]"),
        ("[2, 3]]", "[2, 4]]", 13, "net.elements[2]"),
        ("[1, 2],", "[1, 1],", 12, "net.elements[1]"),
        ("[3, 0, 0]", "[2, 0, 0]", 13, "net.elements[2]"),
        ("[2, 3]]", "[2, 0]]", 10, "net.nodes[3]"),
        ("[2, 3]]", "[2, 1]]", 13, "net.elements[2]"),
        ("[initial]", "node_masses = [1]\n[initial]", 15, "net.node_masses"),
        ("[initial]", "fixed = [0, 7]\n[initial]", 15, "net.fixed[1]"),
        ("[initial]", "bullets = {mass = 1}\n[initial]", 15, "net.bullets"),
        ("packing = 1", "packing = 1\nnode_velocities = [[0, 0, 0]]", 17, "initial.node_velocities"),
        ("packing = 1", "packing = 0.5\nnode_positions = [[0,0,0],[1,0,0],[2,0,0],[3,0,0]]", 17,
         "initial.node_positions"),
        ("packing = 1", "packing = 1\n[launch]\nradial_speed = 1\naxial_speed = 0", 17, "launch"),
        ("output_times = [0.5]", "output_times = [2]", 3, "time.output_times[0]"),
        ("density = 1000", "density = 0", 14, "net.cable.density"),
        ("area = 1e-6", "area = 1e-6, diameter = 1", 14, "net.cable.area"),
        ("area = 1e-6", "diameter = 1e-200", 14, "net.cable"),
    ],
)  # fmt: skip
def test_one_fault_in_an_explicit_case(case: Any, old: str, new: str, line: int, key: str) -> None:
    ((found_line, found_key, _),) = case(changed(old, new, EXPLICIT))
    assert (found_line, found_key) == (line, key)


def test_all_faults_come_at_once_in_the_order_of_the_file(case: Any) -> None:
    text = changed("end = 1.0", "end = 0")
    text = changed("mesh = 1.0", "mesh = -0.3\ncolour = 1", text)
    text = changed("mass = 0.5\n", "", text)
    text = changed("packing = 0.1", "packing = nan", text)
    text = changed("alpha = 1e-3", 'alpha = "much"', text)
    assert [(line, key) for line, key, _ in case(text)] == [
        (4, "time.end"),
        (9, "net.mesh"),
        (10, "net.colour"),
        (20, "net.bullets.mass"),
        (22, "initial.packing"),
        (27, "effects.rayleigh_damping.alpha"),
    ]


# Lines of keys

TANGLED = '''\
# comment = 1
a.b.c = 1 # a.b
"quoted key".'x' = """
[not.a.header]
y = 2
""" # "
list = [ # one
  1, "]", # two ]
  '[', [2,
    3],
  {k = [
    5]},
]

[table . sub]
inline = { p = 1, q.r = [1, 2] }
   [table]
late = """a\\"""", """
[[many]]
x = 1
[many.deep]
y = 1
[[many]]
x = [
# nothing
]
when = 1979-05-27T07:32:00Z
'''


def test_lines_of_a_tangled_file() -> None:
    """Counted by eye in the text above."""
    tangled = TANGLED.replace('"""a\\"""", """', "'''a\n'''")
    found = key_lines(tangled)
    expected = {
        ("a",): 2,
        ("a", "b"): 2,
        ("a", "b", "c"): 2,
        ("quoted key", "x"): 3,
        ("list",): 7,
        ("list", 0): 8,
        ("list", 1): 8,
        ("list", 2): 9,
        ("list", 3): 9,
        ("list", 3, 0): 9,
        ("list", 3, 1): 10,
        ("list", 4): 11,
        ("table",): 17,
        ("table", "sub"): 15,
        ("table", "sub", "inline"): 16,
        ("table", "sub", "inline", "q", "r"): 16,
        ("table", "late"): 18,
        ("many", 0): 20,
        ("many", 0, "x"): 21,
        ("many", 0, "deep", "y"): 23,
        ("many", 1): 24,
        ("many", 1, "x"): 25,
        ("many", 1, "when"): 28,
    }
    assert {path: found.get(path) for path in expected} == expected
    assert ("k",) not in found


# Overrides


def loaded(*overrides: str) -> Case:
    return load(PLANAR, overrides)


def test_overrides_set_values_of_every_type() -> None:
    case = loaded(
        "time.end=0.5",
        "solver.method=RK44",
        "title=Another title",
        'net.cable = { area = 1e-6, density = 1e3, youngs_modulus = 1e9 }',
        "initial.velocity=[0, 0, 1]",
        "effects.gravity.acceleration=[0,0,-9.81]",
    )  # fmt: skip
    scene = case.scene
    assert (scene.time.end, scene.solver.method, scene.title) == (0.5, "RK44", "Another title")
    assert (scene.net.cable.area, scene.initial.velocity) == (1e-6, (0.0, 0.0, 1.0))
    assert scene.effects.gravity.acceleration == (0.0, 0.0, -9.81)
    assert case.overrides[0] == "time.end=0.5"
    assert case.text == PLANAR.read_text()


def test_an_empty_value_removes_a_key_or_a_table() -> None:
    scene = loaded("effects.rayleigh_damping=", "launch=", "solver.accuracy=").scene
    assert scene.effects.rayleigh_damping is None
    assert scene.launch is None


TOW = CASES / "missions" / "throw_close_tow.toml"


def test_overrides_reach_items_of_lists() -> None:
    of_script = ["script[2].delay=0.1", "script[2].after=throw", "script[1]="]
    scene = load(TOW, [*of_script, "bodies.box.size[1]=0.4", "bodies[1].mass=60.0"]).scene
    assert [entry.name for entry in scene.script] == ["throw", "close", "lock", "tow", "hold"]
    assert (scene.script[1].delay, scene.script[1].after) == (0.1, "throw")
    assert (scene.bodies["box"].size, scene.bodies["chaser"].mass) == ((0.5, 0.4, 0.3), 60.0)
    parts = load(CASES / "capture" / "satellite.toml", ["bodies.satellite.parts[2].radius=0.3"]).scene
    assert parts.bodies["satellite"].parts["arm"].radius == 0.3
    for name in ("parts.2.radius", "parts.radius", "parts[7].radius"):
        with pytest.raises(CaseError, match=r"\(.*arm.*\)"):
            load(CASES / "capture" / "satellite.toml", [f"bodies.satellite.{name}=0.3"])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("script[9].at=1.0", "script has 6 items"),
        ("bodies[2].mass=1.0", "bodies has 2 items"),
        ("time.end[0]=1.0", "time.end is not a list"),
        ("script.at=1.0", r"script\[0\]"),
        ("bodies.box.sizes[0]=1.0", "did you mean bodies.box.size"),
        ("net.cbale.diameter=", "did you mean net.cable"),
        ("bodies.bxo.mass=1.0", "bodies.bxo: .* did you mean 'box'"),
        ("script[-1].at=1.0", "key.path=value"),
    ],
)
def test_paths_to_nothing_are_refused_with_the_nearest_key(override: str, words: str) -> None:
    with pytest.raises(CaseError, match=words) as caught:
        load(TOW, [override])
    assert [fault.place for fault in caught.value.faults] == [f"--set {override}"]


def test_what_overrides_do_beside_what_they_state_is_a_warning(tmp_path: Path) -> None:
    """Keys that a new table does not have, and a numbered node that another mesh moves; a name stays."""
    numbered = tmp_path / "numbered.toml"
    numbered.write_text(TOW.read_text().replace('node = "centre"', "node = 24"))
    with pytest.warns(CaseWarning, match=r"drops step$"):
        load(TOW, ['solver={method="RK44"}'])
    with pytest.warns(CaseWarning, match=r"replaces net.mesh$"):
        assert load(PLANAR, ["net.meshes=4"]).scene.net.mesh is None
    with pytest.warns(CaseWarning, match=r"replaces net.meshes$"):
        assert load(PLANAR, ["net.mesh=", "net.meshes=4", "net.mesh=0.5"]).scene.net.meshes is None
    with pytest.warns(CaseWarning, match=r'tethers.tow.end.node: .*node 24 .*"centre"'):
        load(numbered, ["net.mesh=0.3"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(numbered, ["net.divisions=2", "net.size=3.0", "net.mesh=0.5"])
        load(numbered, ["net.mesh=0.3", "tethers.tow.end.node=14"])
        load(TOW, ["net.mesh=0.3", 'solver={method="RK44", step=5e-5}'])


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("time.end=-1", "time.end: "),
        ("time.end=", "time.end: "),
        ("effects.gravity.g=1", "effects.gravity.acceleration: "),
        ("net.mesh=0.3", "net.mesh: "),
        ("net.cable={}", "net.cable: "),
        ("time.edn=1", "time.edn: "),
        ("initial.velocity=1,2", "initial.velocity: "),
        ("initial.velocity=[1,2", ""),
        ("time", ""),
        ("=3", ""),
        ("a b=3", ""),
        ("time..end=3", ""),
        ("a=1\nb=2", ""),
        ("title.x=3", ""),
        ("title.x=", ""),
        ("net.netting.x=", ""),
        ("x=" + "[" * 5000, ""),
    ],
)
def test_faults_of_overrides_name_the_override(override: str, key: str) -> None:
    with pytest.raises(CaseError) as caught:
        load(PLANAR, [override])
    place = f"--set {override}".replace("\n", " ")
    assert str(caught.value).startswith(f"{place}: {key}" if key else place[:50])


def test_faults_of_the_file_keep_their_line_beside_overrides(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text(changed("end = 1.0", "end = 0"))
    with pytest.raises(CaseError) as caught:
        load(path, ["net.size=-1", "initial.packing=-1"])
    places = [fault.place for fault in caught.value.faults]
    assert places == [f"{path}:4", "--set net.size=-1", "--set initial.packing=-1"]


# Files that are no cases


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", 1),
        (b" \n\n", 1),
        (b"\xef\xbb\xbfformat = 1\n", 1),
        (b"format = 1\ntitle = '\xff'\n", 2),
        ("format = 1".encode("utf-16"), 1),
        (b"format = 1\n\n[time\nend = 1\n", 3),
        (b"format = 1\nformat = 1\n", 2),
        (b"[a]\nx = 1\n[b]\nx = 1\nx = 2\n", 5),
        (b"[a]\nx = 1\n[b]\n[a]\n", 4),
        (b"a = [1,\n2\n", 2),
        (b"format 1", 1),
        (b"a = 1\rb = 2", 1),
        (b"a\x00 = 1", 1),
        (b"a = " + b"[" * 100_000, None),
        (b"a = " + b"9" * 5000, None),
    ],
)
def test_files_that_are_not_toml(tmp_path: Path, content: bytes, line: int | None) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    with pytest.raises(CaseError) as caught:
        load(path)
    (fault,) = caught.value.faults
    assert fault.place == (f"{path}:{line}" if line else str(path))
    assert "\n" not in str(fault)


def test_paths_that_cannot_be_read(tmp_path: Path) -> None:
    huge = tmp_path / "huge.toml"
    with huge.open("wb") as stream:
        stream.truncate(MAX_BYTES + 1)
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    for path in (
        tmp_path / "none.toml",
        tmp_path / "none" / "x.toml",
        tmp_path,
        huge,
        pipe,
        tmp_path / ("x" * 5000),
        Path("a\0b"),
    ):
        with pytest.raises(InputError):
            load(path)


# Anything else

PATHS = [*tomllib.loads(GOOD), "solver.method", "solver.step", "effects.gravity"] + [
    f"{table}.{key}"
    for table, content in tomllib.loads(GOOD).items()
    if isinstance(content, dict)
    for key in content
]
ODD = st.one_of(
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(["", "{}", "[]", "true", "nan", "[[1,2,3]]", "1e308", "5e-324", "2020-01-01", "{a.b=1}"]),
    st.lists(st.floats(-3, 3), max_size=4).map(str),
    st.sampled_from(["square", "rectangular", "hexagonal", "radial", "explicit", "RK44", "DOPRI5"]),
    st.text(max_size=5),
)


def _reads_or_refuses(path: Path, overrides: list[str]) -> None:
    """Anything but a Case or a CaseError fails the test; so does an error without a place or of two lines."""
    faults: list[Fault] | None = None
    try:
        load(path, overrides)
    except CaseError as error:
        faults = error.faults
    assert faults != []
    assert all(fault.place and fault.reason and "\n" not in str(fault) for fault in faults or ())


@pytest.mark.ci
@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(PATHS), ODD), min_size=1, max_size=4))
def test_any_value_is_read_or_refused(changes: list[tuple[str, str]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.toml"
        path.write_text(GOOD)
        _reads_or_refuses(path, [f"{key}={value}" for key, value in changes])


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.sampled_from([GOOD, EXPLICIT]), st.data())
def test_any_damaged_text_is_read_or_refused(text: str, data: st.DataObject) -> None:
    """Pieces are cut out and odd ones put in."""
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = min(len(text), start + data.draw(st.integers(0, 12)))
        piece = data.draw(st.one_of(st.text(string.printable, max_size=6), ODD))
        text = text[:start] + piece + text[stop:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.toml"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        _reads_or_refuses(path, [])


# Bodies

BODIES = (
    GOOD + "[bodies.box]\nmass = 3\ninertia = [1, 2, 2.5]\n[bodies.target-2]\nmass = 1\ninertia = [1, 1, 2]\n"
)


def test_bodies_have_any_names_and_a_state_at_rest_by_default(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text(BODIES)
    bodies = load(path, ["bodies.box.attitude=[0, 0, 0, 2]", "bodies.box.velocity=[1, 0, 0]"]).scene.bodies
    assert list(bodies) == ["box", "target-2"]
    box, other = bodies.values()
    assert (box.mass, box.inertia, box.velocity) == (3.0, (1.0, 2.0, 2.5), (1.0, 0.0, 0.0))
    assert box.quaternion == (0.0, 0.0, 0.0, 1.0)
    assert (other.position, other.velocity, other.angular_velocity) == ((0.0, 0.0, 0.0),) * 3
    assert other.attitude == (1.0, 0.0, 0.0, 0.0)
    assert load(PLANAR).scene.bodies == {}


@pytest.mark.parametrize("size", [1e-300, 1e-200, 1.0, 1e300])
def test_an_attitude_of_any_size_is_brought_to_length_one(tmp_path: Path, size: float) -> None:
    """3^2 + 4^2 = 5^2."""
    path = tmp_path / "x.toml"
    path.write_text(BODIES)
    scene = load(path, [f"bodies.box.attitude=[{3 * size!r}, 0, 0, {4 * size!r}]"]).scene
    assert scene.bodies["box"].quaternion == pytest.approx((0.6, 0.0, 0.0, 0.8), rel=1e-15)


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("bodies.box.mass=0", "bodies.box.mass"),
        ("bodies.box.mass=", "bodies.box"),
        ("bodies.box.inertia=[1, 1, 2.1]", "bodies.box.inertia"),
        ("bodies.box.inertia=[3, 1, 1]", "bodies.box.inertia"),
        ("bodies.box.inertia=[1, 0, 1]", "bodies.box.inertia[1]"),
        ("bodies.box.inertia=[1, 1]", "bodies.box.inertia"),
        ("bodies.box.attitude=[0, 0, 0, 0]", "bodies.box.attitude"),
        ("bodies.box.attitude=[1, 0, 0]", "bodies.box.attitude"),
        ("bodies.box.velocity=[nan, 0, 0]", "bodies.box.velocity[0]"),
        ("bodies.box.mas=1", "bodies.box.mas"),
        ("bodies.box=3", "bodies.box"),
        ('bodies."a b"={mass = 1, inertia = [1, 1, 1]}', "bodies.'a b'"),
        ("bodies=3", "bodies"),
    ],
)
def test_faults_of_bodies(case: Any, override: str, key: str) -> None:
    ((_, found, _),) = case(BODIES, override)
    assert found == key


# The JSON schema and the template of the case format


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
        lambda name: not name.startswith("effects.") and name not in ("initial.fold", "capture"),
        tmp_path / "template.toml",
    )
    assert scene.launch is not None


def test_the_template_with_a_capture_is_a_valid_case(tmp_path: Path) -> None:
    on = ("bodies.target", "capture")
    scene = switched("square", lambda name: name in on, tmp_path / "template.toml")
    assert scene.capture.enclosed == 0.9


@pytest.mark.parametrize("effect", EFFECTS)
def test_the_template_with_an_effect_on_is_a_valid_case(effect: str, tmp_path: Path) -> None:
    needed = ["effects.orbit"] if effect == "j2" else []
    needed += {"contact": ["bodies.target"], "launch_force": ["bodies.chaser"]}.get(effect, [])
    changes = {"launch_force": ["launch"]}.get(effect, [])  # which it replaces
    changes += [] if EFFECTS[effect].NEEDS_BULLETS else ["launch", "net.bullets"]
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


SHIPPED = [*SHIPPED_CASES, *(CASES.parent / "tests" / "data" / "faults").glob("*.toml")]


@pytest.mark.parametrize("path", sorted(SHIPPED), ids=lambda path: path.stem)
def test_every_case_of_the_repository_is_valid_and_fits_the_schema(path: Path) -> None:
    assert load(path).scene.format == 1
    assert VALIDATOR.is_valid(tomllib.loads(path.read_text(encoding="utf-8")))
