"""What commands print: help, version, quiet, tables of 80 columns, and what is not told apart."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from commands import command

from exunet.base.version import VERSION
from exunet.case.casefile import load
from exunet.forces.environment import EARTH_RADIUS
from exunet.system.effect_survey import finding

CASES = Path(__file__).parent.parent / "cases"
PLANAR = CASES / "planar_deployment.toml"
ORBIT = CASES / "effects" / "orbit.toml"
SHORT = ("--set", "time.end=0.02", "--set", "time.output_step=0.01")
COMMANDS = ("run", "ensemble", "resume", "check", "effects", "schema", "verify", "cost", "compare", "plot")


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_is_short_for_h(tmp_path, name):
    arguments = [name] if name else []
    short, long = (command(*arguments, option, folder=tmp_path) for option in ("-h", "--help"))
    assert short.returncode == long.returncode == 0
    assert short.stdout == long.stdout
    assert "Usage: exunet" in short.stdout


def test_help_has_the_units(tmp_path):
    for name, words in (("ensemble", "[m]"), ("cost", "runs [s]"), ("plot", "figure [mm]")):
        assert words in " ".join(command(name, "-h", folder=tmp_path).stdout.split())


def test_the_version_is_told(tmp_path):
    done = command("--version", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"exunet {VERSION}\n", "")


@pytest.mark.slow
def test_a_quiet_run_says_nothing_but_errors(tmp_path):
    done = command("run", PLANAR, *SHORT, "--quiet", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list(tmp_path.rglob("result.h5"))) == 1
    done = command("run", PLANAR, *SHORT, "--quiet", "--set", "net.mesh=0.7", folder=tmp_path)
    assert done.returncode == 2
    assert "net.mesh" in done.stderr


@pytest.mark.parametrize(
    ("override", "height"),
    [("effects.orbit.altitude=400e3", 400e3), ("effects.orbit.along_track=[0.0,1.0,0.0]", None)],
)
def test_effects_assume_the_orbit_of_the_case(override, height):
    scene = load(ORBIT, [override]).scene
    orbit = scene.effects.orbit
    height = height or orbit.altitude
    for name in ("j2", "molecular_drag"):
        found = finding(scene, name)
        assert not found.on
        assert found.keys.altitude == height
        assert f"{height / 1e3:.0f} km" in found.assumption
    assert finding(scene, "j2").keys.along_track == orbit.along_track
    flow = finding(scene, "molecular_drag").keys.flow
    speed = math.sqrt(3.986004418e14 / (EARTH_RADIUS + height))
    assert flow == pytest.approx(tuple(-speed * part for part in orbit.along_track), rel=1e-6)


def test_effects_without_an_orbit_assume_one_at_700_km():
    scene = load(PLANAR).scene
    for name in ("j2", "molecular_drag"):
        assert finding(scene, name).keys.altitude == 700e3


def test_an_orbit_by_its_mean_motion_is_taken_too():
    scene = load(ORBIT, ["effects.orbit.altitude=", "effects.orbit.mean_motion=1.1e-3"]).scene
    assert finding(scene, "j2").keys.mean_motion == 1.1e-3
    assert finding(scene, "molecular_drag").keys.altitude == pytest.approx(528.2e3, abs=200.0)


def test_nothing_is_assumed_below_the_known_atmosphere():
    assert finding(load(ORBIT, ["effects.orbit.altitude=100e3"]).scene, "molecular_drag").keys is None
