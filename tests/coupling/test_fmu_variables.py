"""Units, parameters and model description of an FMU, and what is in its file."""

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
from scenes import CASES, SHIPPED_CASES

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.coupling.fmu import export
from exunet.coupling.fmu.variables import Parameters, powers, structured, unit_in
from exunet.coupling.fmu.worker import Served


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
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


def test_units_and_names_of_keys() -> None:
    for text in ("", "-", "w, x, y, z", "m/", "furlong", "gives 0 to 1"):
        with pytest.raises(ValueError, match="not a unit"):
            powers(text)
    assert unit_in("quaternion [w, x, y, z] that turns") == ""
    assert unit_in("length outside at time 0 [m]; absent: all of it") == "m"
    assert structured("bodies.the-target.mass") == "bodies.'the-target'.mass"
    assert structured("tethers.1.reel.commands[2].at") == "tethers.'1'.reel.commands[2].at"


def test_parameters_have_the_values_of_the_case_within_their_bounds() -> None:
    """Of every shipped case; as they are they change nothing."""
    for case in SHIPPED_CASES:
        parameters = Parameters(exunet.load(case).scene)
        assert parameters.overrides([item.start for item in parameters.variables]) == []
        assert len({entry.name for entry in parameters.variables}) == len(parameters.variables)
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
    before, after = (
        exunet.load(path, changes).scene.model_dump() for changes in ([], parameters.overrides(values))
    )
    before["bodies"]["target"]["velocity"] = (0.0, 0.25, 0.0)
    tow = before["tethers"]["tow"]
    tow["reel"]["commands"][1]["force"], tow["length"] = 33.0, 18.5
    for cable in (tow, before["net"]["cable"]):
        cable["youngs_modulus"] *= 0.5
    assert after == before


@pytest.mark.parametrize("name", ["border", "strings"])
def test_the_stiffness_factor_reaches_every_thread(name: str, tmp_path: Path) -> None:
    path = CASES / "nets" / "cut.toml" if name == "border" else written(tmp_path, "thrown", THROWN)
    parameters = Parameters(exunet.load(path).scene)
    values = [0.5 if item.name == "stiffness_factor" else item.start for item in parameters.variables]
    before, after = (
        exunet.prepare(exunet.load(path, changes).scene).net.youngs_modulus
        for changes in ([], parameters.overrides(values))
    )
    np.testing.assert_allclose(after, 0.5 * before, rtol=1e-15)


def test_ports_start_by_their_inputs_not_by_parameters(tmp_path: Path) -> None:
    scene = exunet.load(written(tmp_path, "port", PORT)).scene
    names = [variable.name for variable in Parameters(scene).variables]
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
    assert root.attrib["description"].startswith("A <net> & ?: ")
    assert root.find("CoSimulation").attrib["modelIdentifier"] == "thrown_net"  # type: ignore[union-attr]
    assert any(name.endswith("thrown_net.so") for name in names)
    variables = {item.attrib["name"]: item for item in root.find("ModelVariables")}  # type: ignore[union-attr]
    angle = variables["case.launch.spread_angle"]
    number = angle if fmi == 3 else angle[0]
    known = {"unit": "rad", "min": "0.0", "max": "1.5707963267948966", "start": "1.2"}
    assert {key: number.attrib[key] for key in known} == known
    assert angle.attrib["causality"] == "parameter"
    outputs = [variable for variable in variables.values() if variable.attrib["causality"] == "output"]
    structure = root.find("ModelStructure")
    assert structure is not None
    path = ("InitialUnknown", "Output") if fmi == 3 else ("InitialUnknowns/Unknown", "Outputs/Unknown")
    assert [len(structure.findall(entry)) for entry in path] == [len(outputs)] * 2
    experiment = root.find("DefaultExperiment").attrib  # type: ignore[union-attr]
    assert experiment == {"startTime": "0.0", "stopTime": "0.5", "stepSize": "0.005"}


@pytest.mark.ci
@pytest.mark.slow
def test_a_method_that_cannot_restart_keeps_no_states(thrown: Path, tmp_path: Path) -> None:
    """An implicit one of Exudyn. A host that goes back can reset."""
    implicit = ["solver.method=GeneralizedAlpha", "solver.tolerance=", "solver.step=1e-4"]
    for fmi, suffix in ((2, "state"), (3, "State")):
        path = exunet.export_fmu(thrown, tmp_path / f"{fmi}.fmu", implicit, fmi=fmi)
        with zipfile.ZipFile(path) as file:
            root = ElementTree.fromstring(file.read("modelDescription.xml"))
        can = root.find("CoSimulation").attrib  # type: ignore[union-attr]
        assert can[f"canGetAndSetFMU{suffix}"] == can[f"canSerializeFMU{suffix}"] == "false"
    served = Served(Unpacked.of(path, tmp_path / "unpacked").folder / "resources")
    values = served.build(np.array(served.content.starts))
    served.step(0.0, 1e-3, values)
    with pytest.raises(InputError, match=r"the net is at 0\.001 s: reset the FMU"):
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
def test_what_cannot_be_exported(thrown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is written then; the command writes beside the case and replaces on demand."""
    there = tmp_path / "thrown net.fmu"
    there.write_text("kept")
    for path, changes, fmi, error, words in (
        (there, [], 3, InputError, "there is a file of that name"),
        (tmp_path / "net.fmu", [], 1, InputError, "fmi: must be 2 or 3"),
        (tmp_path / "net.fmu", ["launch.speed=-1.0"], 3, exunet.CaseError, r"launch\.speed"),
        (tmp_path / "absent" / "net.fmu", [], 3, InputError, "cannot be written"),
    ):
        with pytest.raises(error, match=words):
            exunet.export_fmu(thrown, path, changes, fmi=fmi)
    broken = subprocess.CompletedProcess([], 1, "", "net.c:1:1: error: no such thing\n1 error")
    with monkeypatch.context() as patch:
        patch.setattr(export.subprocess, "run", lambda *_, **__: broken)
        with pytest.raises(InputError, match="no such thing"):
            exunet.export_fmu(thrown, tmp_path / "net.fmu")
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "which", lambda _: None)
        with pytest.raises(MissingExtra, match="gcc"):
            exunet.export_fmu(thrown, tmp_path / "net.fmu")
    refused = command("fmu", thrown, folder=tmp_path)
    assert (refused.returncode, there.read_text()) == (2, "kept")
    assert sorted(tmp_path.iterdir()) == [there]
    done = command("fmu", thrown, "--fmi", "2", "--set", "launch.speed=4.0", "--overwrite", folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, "thrown net.fmu\n")
