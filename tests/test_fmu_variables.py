"""What an FMU tells of itself: units, parameters, model description; and what is in its file."""

import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from commands import command
from fmu_hosts import PORT, THROWN, Unpacked, written
from test_shapes import stl

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.coupling.fmu import export
from exunet.coupling.fmu.parameters import Parameters
from exunet.coupling.fmu.served import Served
from exunet.coupling.fmu.variables import powers, structured, unit_in

CASES = Path(__file__).parent.parent / "cases"


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("m", {"m": 1}),
        ("kg m2", {"kg": 1, "m": 2}),
        ("N s/m", {"kg": 1, "s": -1}),
        ("m/(N s)", {"kg": -1, "s": 1}),
        ("1/s", {"s": -1}),
        ("rad/s", {"rad": 1, "s": -1}),
        ("Pa", {"kg": 1, "m": -1, "s": -2}),
        ("W/m2", {"kg": 1, "s": -3}),
    ],
)
def test_powers_of_base_units(unit: str, expected: dict[str, int]) -> None:
    assert powers(unit) == expected


@pytest.mark.parametrize("text", ["", "-", "w, x, y, z", "m/", "furlong", "gives 0 to 1"])
def test_what_is_no_unit(text: str) -> None:
    with pytest.raises(ValueError, match="not a unit"):
        powers(text)


def test_the_unit_in_a_description() -> None:
    assert unit_in("quaternion [w, x, y, z] that turns") == ""
    assert unit_in("length outside at time 0 [m]; absent: all of it") == "m"
    assert unit_in("C [-]: 1 absorbs all light") == ""


def test_names_of_the_case_become_structured_names() -> None:
    assert structured("bodies.the-target.mass") == "bodies.'the-target'.mass"
    assert structured("tethers.1.reel.commands[2].at") == "tethers.'1'.reel.commands[2].at"


EVERY = sorted(CASES.rglob("*.toml"), key=str)


@pytest.mark.parametrize("case", EVERY, ids=lambda path: str(path.relative_to(CASES)))
def test_parameters_have_the_values_of_the_case_within_their_bounds(case: Path) -> None:
    """Of every shipped case; as they are they change nothing."""
    parameters = Parameters(exunet.load(case).scene)
    starts = [item.start for item in parameters.variables]
    assert parameters.overrides(starts) == []
    assert len({entry.name for entry in parameters.variables}) == len(starts)
    for variable in parameters.variables:
        assert variable.low is None or variable.low <= variable.start
        assert variable.high is None or variable.start <= variable.high
        assert not variable.unit or powers(variable.unit)


def test_a_number_a_vector_and_a_command_of_a_reel_become_overrides() -> None:
    """Their case has these values then, and all others as before; a factor reaches net and tether."""
    path = CASES / "bodies" / "tow.toml"
    parameters = Parameters(exunet.load(path).scene)
    wanted = {
        "case.bodies.target.velocity.y": 0.25,
        "case.tethers.tow.reel.commands[1].force": 33.0,
        "case.tethers.tow.length": 18.5,
        "stiffness_factor": 0.5,
    }
    values = [wanted.get(variable.name, variable.start) for variable in parameters.variables]
    before, after = exunet.load(path).scene, exunet.load(path, parameters.overrides(values)).scene
    assert after.bodies["target"].velocity == (0.0, 0.25, 0.0)
    reel, was = after.tethers["tow"].reel, before.tethers["tow"].reel
    assert reel is not None
    assert was is not None
    assert [getattr(item, "force", None) for item in reel.commands] == [6.0, 33.0, None]
    assert [(entry.at, entry.mode) for entry in reel.commands] == [
        (element.at, element.mode) for element in was.commands
    ]
    assert after.tethers["tow"].length == 18.5
    assert after.tethers["tow"].youngs_modulus == 0.5 * before.tethers["tow"].youngs_modulus
    assert after.net.cable.youngs_modulus == 0.5 * before.net.cable.youngs_modulus


@pytest.mark.parametrize("name", ["cut.toml", "star.toml"])
def test_the_stiffness_factor_reaches_every_thread(name: str) -> None:
    """Border and strings too."""
    path = CASES / "nets" / name
    parameters = Parameters(exunet.load(path).scene)
    values = [
        0.5 if variable.name == "stiffness_factor" else variable.start for variable in parameters.variables
    ]
    before, after = (
        exunet.prepare(exunet.load(path, overrides).scene).net.youngs_modulus
        for overrides in ([], parameters.overrides(values))
    )
    np.testing.assert_allclose(after, 0.5 * before, rtol=1e-15)


def test_ports_start_by_their_inputs_not_by_parameters(tmp_path: Path) -> None:
    names = [
        variable.name for variable in Parameters(exunet.load(written(tmp_path, "port", PORT)).scene).variables
    ]
    assert "case.bodies.chaser.mass" in names
    assert not any(name.startswith("case.bodies.chaser.position") for name in names)
    assert "case.bodies.'the-target'.position.x" in names


@pytest.fixture(scope="module")
def thrown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("thrown"), "thrown net", THROWN)


@pytest.mark.ci_for("2")
@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_model_description_has_units_bounds_and_structure(thrown: Path, tmp_path: Path, fmi: int) -> None:
    title = ['title="A <net> & \\uFFFE"']  # with a character that XML cannot have
    with zipfile.ZipFile(exunet.export_fmu(thrown, tmp_path / "net.fmu", title, fmi=fmi)) as file:
        root = ElementTree.fromstring(file.read("modelDescription.xml"))
        names = file.namelist()
    assert root.attrib["description"] == "A <net> & ?"
    assert root.find("CoSimulation").attrib["modelIdentifier"] == "thrown_net"  # type: ignore[union-attr]
    assert any(name.endswith("thrown_net.so") for name in names)
    variables = {item.attrib["name"]: item for item in root.find("ModelVariables")}  # type: ignore[union-attr]
    angle = variables["case.launch.spread_angle"]
    number = angle if fmi == 3 else angle[0]
    assert {key: number.attrib[key] for key in ("unit", "min", "max", "start")} == {
        "unit": "rad",
        "min": "0.0",
        "max": "1.5707963267948966",
        "start": "1.2",
    }
    assert angle.attrib["causality"] == "parameter"
    outputs = [variable for variable in variables.values() if variable.attrib["causality"] == "output"]
    structure = root.find("ModelStructure")
    assert structure is not None
    path = ("InitialUnknown", "Output") if fmi == 3 else ("InitialUnknowns/Unknown", "Outputs/Unknown")
    assert [len(structure.findall(entry)) for entry in path] == [len(outputs)] * 2
    experiment = root.find("DefaultExperiment")
    assert experiment is not None
    assert experiment.attrib == {"startTime": "0.0", "stopTime": "0.5", "stepSize": "0.005"}


@pytest.mark.ci
@pytest.mark.slow
def test_a_method_that_cannot_restart_keeps_no_states(thrown: Path, tmp_path: Path) -> None:
    """An implicit one of Exudyn. A host that goes back is told what is left to it."""
    implicit = ["solver.method=GeneralizedAlpha", "solver.tolerance=", "solver.step=1e-4"]
    for fmi, suffix in ((2, "state"), (3, "State")):
        path = exunet.export_fmu(thrown, tmp_path / f"{fmi}.fmu", implicit, fmi=fmi)
        with zipfile.ZipFile(path) as file:
            root = ElementTree.fromstring(file.read("modelDescription.xml"))
        can = root.find("CoSimulation")
        assert can is not None
        assert can.attrib[f"canGetAndSetFMU{suffix}"] == can.attrib[f"canSerializeFMU{suffix}"] == "false"
    unpacked = Unpacked.of(path, tmp_path / "unpacked")
    served = Served(unpacked.folder / "resources")
    values = served.build(np.array(served.content.starts))
    served.step(0.0, 1e-3, values)
    words = r"to 0 s, but the net is at 0\.001 s: reset the FMU, which .*; it has no states to restore, since"
    with pytest.raises(InputError, match=words):
        served.step(0.0, 1e-3, values)


@pytest.mark.slow
def test_the_same_case_gives_the_same_file_another_one_another_token(thrown: Path, tmp_path: Path) -> None:
    """Byte by byte; the token follows from the content, so that states of one are refused by the other."""
    one = exunet.export_fmu(thrown, tmp_path / "one.fmu", ["launch.speed=5.0"])
    same = exunet.export_fmu(exunet.load(thrown), tmp_path / "same.fmu", ["launch.speed=5.0"])
    assert one.read_bytes() == same.read_bytes()
    other = exunet.export_fmu(thrown, same, ["launch.speed=5.5"], overwrite=True)
    tokens = []
    for path in (one, other):
        with zipfile.ZipFile(path) as file:
            tokens.append(json.loads(file.read("resources/content.json"))["token"])
    assert tokens[0] != tokens[1]


@pytest.mark.ci
@pytest.mark.slow
def test_meshes_go_with_the_case(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    stl(tmp_path / "cube.stl")
    box = "shape = 'mesh'\nfile = 'cube.stl'\nunit = 'cm'\nmass = 1.0\nmotion = 'fixed'\n"
    case = written(tmp_path, "meshed", f"{THROWN}\n[bodies.box]\n{box}position = [0.0, 0.0, -9.0]\n")
    path = exunet.export_fmu(case, tmp_path / "net.fmu")
    (tmp_path / "cube.stl").unlink()
    with zipfile.ZipFile(path) as file:
        file.extractall(tmp_path / "fmu")
    content = json.loads((tmp_path / "fmu/resources/content.json").read_text())
    found = exunet.load(tmp_path / "fmu/resources/case/meshed.toml", content["overrides"])
    assert Path(found.scene.bodies["box"].file or "").stat().st_size == 684  # 84 + 12 triangles of 50 bytes


@pytest.mark.ci
@pytest.mark.slow
def test_what_cannot_be_exported(thrown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = tmp_path / "there.fmu"
    there.write_text("kept")
    with pytest.raises(InputError, match="there is a file of that name"):
        exunet.export_fmu(thrown, there)
    with pytest.raises(InputError, match="fmi: must be 2 or 3, got 1"):
        exunet.export_fmu(thrown, tmp_path / "net.fmu", fmi=1)
    with pytest.raises(exunet.CaseError, match=r"launch\.speed"):
        exunet.export_fmu(thrown, tmp_path / "net.fmu", ["launch.speed=-1.0"])
    with pytest.raises(InputError, match="cannot be written"):
        exunet.export_fmu(thrown, tmp_path / "absent" / "net.fmu")
    broken = subprocess.CompletedProcess([], 1, "", "net.c:1:1: error: no such thing\n1 error")
    with monkeypatch.context() as patch:
        patch.setattr(export.subprocess, "run", lambda *_, **__: broken)
        with pytest.raises(InputError, match=r"cannot compile the FMU: .*no such thing"):
            exunet.export_fmu(thrown, tmp_path / "net.fmu")
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(MissingExtra, match="needs a C compiler: install gcc"):
        exunet.export_fmu(thrown, tmp_path / "net.fmu")
    assert there.read_text() == "kept"
    assert sorted(tmp_path.iterdir()) == [there]


@pytest.mark.ci
@pytest.mark.slow
def test_the_command_writes_beside_and_replaces_on_demand(thrown: Path, tmp_path: Path) -> None:
    there = tmp_path / "thrown net.fmu"
    there.write_text("kept")
    refused = command("fmu", thrown, folder=tmp_path)
    assert (refused.returncode, there.read_text()) == (2, "kept")
    assert "there is a file of that name" in refused.stderr
    done = command("fmu", thrown, "--fmi", "2", "--set", "launch.speed=4.0", "--overwrite", folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, "thrown net.fmu\n")
