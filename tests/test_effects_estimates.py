"""Estimates against measured changes, advice, the automatic choice, what an effect needs of a case."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from exunet.base.errors import CaseError
from exunet.cli.main import app
from exunet.forces.effects import EFFECTS
from exunet.forces.environment import EARTH_RADIUS, bullet_disc
from exunet.model.effect_survey import finding, setting_of, survey
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.studies.ablation import Toggled, ablate

ROOT = Path(__file__).parents[1]
CASES = ROOT / "cases" / "effects"
PLANAR = ROOT / "cases" / "planar_deployment.toml"
IN_ORBIT = CASES / "orbit.toml"

# Case, overrides, effect: the list of docs/effects.md, in its order.
EARLY = ("time.end=1.2", "time.output_step=0.05")
EARLIER = ("time.end=0.5", "time.output_step=0.05")  # before snaps multiply what is so small
PAIRS: list[tuple[str, tuple[str, ...], str]] = [
    ("planar_deployment.toml", EARLY, "orbit"),
    ("planar_deployment.toml", EARLY, "gravity"),
    ("planar_deployment.toml", EARLY, "rayleigh_damping"),
    ("planar_deployment.toml", EARLY, "mass_damping"),
    ("planar_deployment.toml", EARLY, "launch_force"),
    ("planar_deployment.toml", EARLIER, "solar_pressure"),
    ("planar_deployment.toml", EARLIER, "molecular_drag"),
    ("planar_deployment.toml", EARLY, "air_drag"),
    ("planar_deployment.toml", EARLY, "bending"),
    ("effects/air_drag.toml", (), "air_drag"),
    ("effects/bending.toml", (), "bending"),
    ("effects/breaking.toml", (), "breaking"),
    ("effects/j2.toml", (), "j2"),
    ("effects/launch_force.toml", (), "launch_force"),
    ("effects/mass_damping.toml", (), "mass_damping"),
    ("effects/material_damping.toml", (), "material_damping"),
    ("effects/molecular_drag.toml", (), "molecular_drag"),
    ("effects/orbit.toml", (), "orbit"),
    ("effects/parabolic_flight.toml", (), "gravity"),
    ("effects/solar_pressure.toml", (), "solar_pressure"),
    ("effects/thermal_strain.toml", (), "thermal_strain"),
]
QUICK = ("breaking", "material_damping", "thermal_strain", "bending")


def toggled(path: str, overrides: tuple[str, ...], name: str) -> Toggled:
    (one,) = ablate(load(ROOT / "cases" / path, overrides).scene, (name,))
    return one


def holds(path: str, overrides: tuple[str, ...], name: str) -> None:
    one = toggled(path, overrides, name)
    assert one.failure == ""
    assert one.until > 0.0
    assert one.ratio is not None
    assert 1 / 3 < one.ratio < 3, one


@pytest.mark.ci_for("pair1")
@pytest.mark.slow_for("pair1", "pair2", "pair3")
@pytest.mark.parametrize(
    "pair", [pair for pair in PAIRS if pair[2] in QUICK and pair[0] != "planar_deployment.toml"]
)
def test_an_estimate_is_right_within_a_factor_of_three(pair: tuple[str, tuple[str, ...], str]) -> None:
    holds(*pair)


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: f"{Path(pair[0]).stem}-{pair[2]}")
def test_all_listed_estimates_are_right_within_a_factor_of_three(
    pair: tuple[str, tuple[str, ...], str],
) -> None:
    holds(*pair)


def test_the_list_in_the_documentation_is_the_tested_one() -> None:
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([\w/]+\.toml)`[^|]*\| (\w+) \|", text, re.MULTILINE)
    assert listed == [(path, name) for path, _, name in PAIRS]


# Advice


def test_the_papers_case_is_told_to_leave_out_the_orbit() -> None:
    """Paper, sec. 3.1 and 4: gravitational, centrifugal and Coriolis forces disregarded for 2 s.

    By hand: 2 n v for the bullets (0.5 kg of 0.59 kg a corner), n = 1.060e-3 rad/s at 700 km, v = 2.5 m/s,
    turned in the plane where only the in-plane normal counts: |h x v| averages v / sqrt 2 over the four
    diagonals.
    """
    scene = load(PLANAR).scene
    one = finding(scene, "orbit")
    assert one.estimate is not None
    coriolis = 2 * 1.060e-3 * 2.5 / math.sqrt(2)
    assert one.estimate.acceleration == pytest.approx(coriolis, rel=0.1)
    assert one.relative == pytest.approx(
        0.5 * coriolis * 2.0**2 / 7.0, rel=0.1
    )  # of the 7 m from bullet to bullet
    assert one.advice(0.01) == "would move the net by 1e-03 of its size: not needed"
    assert "700 km" in one.assumption
    parts = dict(re.findall(r"(Coriolis|gradient) [^=]*= ([\d.e-]+) m/s2", one.estimate.source))
    assert float(parts["Coriolis"]) == pytest.approx(coriolis, rel=0.1)
    # n^2 y of nodes that reach 3.5 / 2 m in the root mean square, half-way through: below 3 n^2 x 3.5 m.
    assert 1e-6 < float(parts["gradient"]) < 3 * 1.060e-3**2 * 3.5
    moved = [float(part) for part in re.findall(r"moves ([\d.e-]+) of the size", one.estimate.source)]
    assert moved == pytest.approx([1e-3, 6e-7], rel=0.1)


def test_advice_covers_the_four_cases() -> None:
    found = {item.name: item for item in survey(load(PLANAR).scene)}
    assert set(found) == set(EFFECTS)
    assert found["rayleigh_damping"].advice(1e-3) == "needed at this accuracy"
    assert found["rayleigh_damping"].advice(0.5) == "not needed at this accuracy"
    assert found["bending"].advice(1e-3) == "needed at this accuracy: switch it on"
    assert found["j2"].advice(1e-3).endswith("not needed")
    assert found["gravity"].advice(1e-3).startswith("off; on the ground")


# Keys that an acceleration is proportional to, whatever the scene.
PROPORTIONAL = {
    "air_drag": "density",
    "bending": "modulus",
    "gravity": "acceleration",
    "mass_damping": "alpha",
    "material_damping": "relaxation_time",
    "molecular_drag": "density",
    "solar_pressure": "flux",
    "thermal_strain": "expansion_coefficient",
}


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_effect_is_estimated_on_every_case(path: Path) -> None:
    """What must hold whatever the numbers: proportions, growth with time, cost just where there is work."""
    scene = load(path).scene
    for item in survey(scene):
        if item.estimate is None:
            nominal = EFFECTS[item.name].nominal
            assert "None" in nominal.__annotations__["return"]  # it says that there may be nothing to assume
            assert nominal(setting_of(scene, item.name)) is None
            assert not item.on
            continue
        basis = setting_of(scene, item.name)
        given = getattr(scene.effects, item.name)
        assert (item.keys == given) != bool(item.assumption)
        assert item.relative == pytest.approx(item.estimate.displacement / basis.size, rel=1e-12)
        changes_numbers_only = item.name in ("breaking", "thermal_strain")
        assert (item.cost > 0.0) == (not changes_numbers_only) or item.estimate.acceleration == 0.0
        longer = finding(scene, item.name, 2.0 * scene.time.end).estimate
        assert longer is not None
        assert 0.0 <= item.estimate.displacement <= longer.displacement * (1.0 + 1e-12)
        key = PROPORTIONAL.get(item.name)
        if key is None or getattr(item.keys, key) is None:
            continue
        twice = item.keys.model_copy(update={key: (2.0 * np.array(getattr(item.keys, key))).tolist()})
        more = EFFECTS[item.name].magnitude(twice, basis)
        assert more.acceleration == pytest.approx(2.0 * item.estimate.acceleration, rel=1e-3)
        numbers = [float(word) for word in re.findall(r"\d\.?\d*(?:e[+-]\d+)?", item.estimate.source)]
        assert numbers, item.estimate.source  # of this scene, beside the formula


def test_speeds_count_as_often_as_the_law_of_each_drag_says() -> None:
    """The same way twice as fast, in half the time: drag as its square, damping as itself."""

    def launched(speed: float, name: str) -> float:
        speeds = [f"launch.{key}_speed={speed}" for key in ("radial", "axial")]
        found = finding(load(CASES / "air_drag.toml", speeds).scene, name, duration=0.2 / speed).estimate
        assert found is not None
        return found.acceleration

    for name, power in (("air_drag", 2), ("mass_damping", 1), ("gravity", 0)):
        assert launched(2.0, name) == pytest.approx(2.0**power * launched(1.0, name), rel=1e-9), name


def test_the_assumed_ball_has_the_area_of_its_mass() -> None:
    """1 kg of aluminium, 2700 kg/m3: a radius of 44.55 mm, so a disc of 6.235e-3 m2; area as m^(2/3)."""
    radius = (3.0 / (4.0 * math.pi * 2700.0)) ** (1.0 / 3.0)
    assert radius == pytest.approx(0.04455, abs=5e-6)
    assert bullet_disc(1.0) == pytest.approx(math.pi * radius**2, rel=1e-14)
    assert bullet_disc(8.0) == pytest.approx(4.0 * bullet_disc(1.0), rel=1e-14)
    assert bullet_disc(1e-3) == pytest.approx(1e-2 * bullet_disc(1.0), rel=1e-14)


# The automatic choice


def test_auto_switches_on_what_matters_and_says_why() -> None:
    start = prepare(load(CASES / "auto.toml", ["effects.threshold=3e-3"]).scene)
    on = {name for name in EFFECTS if getattr(start.scene.effects, name) is not None}
    assert "mass_damping" in on
    assert not on & {"orbit", "solar_pressure"}
    auto = [note for note in start.plan.notes if re.match(r"auto: \w+ (on|off):", note)]
    assert len(auto) == 4
    assert any(note.startswith("auto: orbit off: ") and "< 0.003" in note for note in auto)
    linear = start.system.forces.linear
    assert linear is not None
    assert linear.gyroscopic is None
    summary = summarise(simulate(start))
    assert [value for name, value in rows(summary) if name == "note" and value in auto] == auto
    assert summary["effects"] == sorted(on)


def test_the_table_says_what_auto_came_to() -> None:
    found = {item.name: item for item in survey(load(CASES / "auto.toml").scene)}
    assert found["mass_damping"].on
    assert not found["orbit"].on
    assert found["orbit"].advice(1e-3) == "a candidate below effects.threshold: left off"
    assert not found["air_drag"].on


@pytest.mark.ci
@pytest.mark.slow
def test_an_ablation_under_auto_toggles_what_auto_came_to() -> None:
    """A candidate left off is switched on, and one without a table too, whatever the threshold."""
    scene = load(CASES / "auto.toml").scene
    for item in ablate(scene, ("orbit", "rayleigh_damping", "mass_damping")):
        assert item.ratio is not None
        assert 1 / 3 < item.ratio < 3


def test_a_lower_threshold_switches_more_on() -> None:
    start = prepare(load(CASES / "auto.toml", ["effects.threshold=1e-12"]).scene)
    assert all(
        getattr(start.scene.effects, n) for n in ("mass_damping", "orbit", "solar_pressure", "bending")
    )


# What a case must have


DRAG = "{flow=[1.0,0.0,0.0], drag_coefficient=2.2, bullet_area=1e-3"
AIR = "density=1.2,drag_coefficient=1.0,bullet_drag_coefficient=0.5"
AXES = "radial=[0.0,0.0,1.0], along_track=[1.0,0.0,0.0]"
ORBIT = f'effects.orbit={{altitude=7e5, {AXES}, model="linear"}}'
GUN = "force=1.0,stroke=0.1,spread_angle=0.1,chaser_mass=1.0"
SUN = "{flux=1.0,direction=[0,0,0],pressure_coefficient=1.0,bullet_area=0.0}"
BREAKING = ["effects.rayleigh_damping=", "effects.breaking.strain=0.1"]
FAULTS = {
    "orbit without altitude": ([f'effects.orbit={{{AXES}, model="linear"}}'], "effects.orbit: "),
    "drag without density": ([f"effects.molecular_drag={DRAG}}}"], "effects.molecular_drag: "),
    "drag with both": ([f"effects.molecular_drag={DRAG}, density=1e-9, altitude=3e5}}"], "drag.altitude: "),
    "drag below its model": ([f"effects.molecular_drag={DRAG}, altitude=1e4}}"], "drag.altitude: "),
    "no area": ([f"effects.air_drag={{{AIR}}}"], "needs bullet_area, since the net has bullets"),
    "two gravities": (["effects.gravity.acceleration=[0,0,-9]", ORBIT], "contradicts effects.orbit"),
    "two atmospheres": (
        [f"effects.air_drag={{{AIR},bullet_area=1e-3}}", f"effects.molecular_drag={DRAG}, density=1e-9}}"],
        "contradicts effects.molecular_drag",
    ),
    "two heights": ([f"effects.molecular_drag={DRAG}, altitude=3e5}}", ORBIT], "differs from that of eff"),
    "J2 without an orbit": (
        [f"effects.j2={{altitude=7e5, {AXES}, inclination=1.0, argument_of_latitude=0.0}}"],
        "needs [effects.orbit]",
    ),
    "J2 of a long scene": (
        [ORBIT, f"effects.j2={{altitude=7e5, {AXES}, inclination=1.0, argument_of_latitude=0.0}}",
         "time={end=400.0,output_step=1.0}"],
        "valid for 296 s of this orbit; the scene lasts 400 s",
    ),
    "two launches": ([f'effects.launch_force={{kind="spring",{GUN}}}'], "contradicts [launch]"),
    "gas without its keys": (["launch=", f'effects.launch_force={{kind="gas",{GUN}}}'], "launch_force: "),
    "two limits": (["effects.breaking={strain=0.1,force=3.0}"], "effects.breaking.force: "),
    "breaking with eq. (13)": (["effects.breaking.strain=0.1"], "rayleigh_damping.beta"),
    "breaking with Verlet": ([*BREAKING, "solver={method='VelocityVerlet'}"], "not VelocityVerlet"),
    "auto without a threshold": (["effects.choose=auto"], "effects: "),
    "a threshold without auto": (["effects.threshold=0.1"], 'for choose = "auto" only'),
    "two forms of launch": (["launch.speed=3.0"], "spread_angle"),
    "an absurd strain": (
        ["effects.thermal_strain={temperature_change=1e4,expansion_coefficient=1e-3}"],
        "between -0.1 and 0.1",
    ),
    "light of no direction": ([f"effects.solar_pressure={SUN}"], "must have length 1"),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_what_is_missing_or_contradicts_is_told(what: str) -> None:
    overrides, words = FAULTS[what]
    with pytest.raises(CaseError) as caught:
        load(PLANAR, overrides)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "override",
    [
        "effects.gravity.acceleration=[0.0,0.0,1e300]",
        "effects.mass_damping.alpha=1e300",
        "effects.material_damping.relaxation_time=1e300",
        "effects.bending.modulus=1e300",
        f'effects.orbit={{mean_motion=1e-300, {AXES}, model="two_body"}}',
        "effects.molecular_drag={density=1e300,flow=[1e300,0.0,0.0],drag_coefficient=1.0,bullet_area=0.1}",
    ],
)
def test_numbers_that_overflow_are_refused_and_not_estimated(override: str) -> None:
    scene = load(PLANAR, [override]).scene
    name = override.split("effects.")[1].split("=")[0].split(".")[0]
    for refused in (prepare, survey):
        with pytest.raises(CaseError, match=f"effects.{name}: leads to numbers outside the range"):
            refused(scene)


def test_an_estimate_of_an_overflowing_scene_is_refused() -> None:
    with pytest.raises(CaseError, match="or the scene"):
        survey(load(PLANAR, ["launch.radial_speed=1e200"]).scene)


def test_conflicts_are_told_with_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / "two.toml"
    text = (CASES / "orbit.toml").read_text(encoding="utf-8")
    text += "\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.81]\n"
    path.write_text(text, encoding="utf-8")
    line = text.splitlines().index("[effects.gravity]") + 1
    with pytest.raises(CaseError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}:{line}: effects.gravity: contradicts effects.orbit")


# The command


def run_command(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["effects", *arguments])


def test_the_command_lists_every_effect() -> None:
    done = run_command(str(PLANAR))
    assert done.exit_code == 0
    for name in EFFECTS:
        assert re.search(rf"^{name} ", done.stdout, re.MULTILINE), name
    assert "needed" in done.stdout  # or not, folded between the two words


def test_the_command_says_what_its_estimates_leave_out() -> None:
    """Above the table, by name, and in the head of the column of advice; not where there is only a net."""
    done = run_command(str(CASES.parent / "bodies" / "tow.toml"))
    words = " ".join(done.stdout.split())
    assert "of the net alone. They leave out the bodies (chaser, target) and tethers (tow)" in words
    assert (
        words.index("leave out the bodies") < words.index("advice for the net") < words.index("gravity off")
    )
    assert "Not modelled on bodies: air_drag, molecular_drag, solar_pressure." in words
    plain = run_command(str(PLANAR)).stdout
    assert "NOTE" not in plain
    assert "advice for the net" not in plain


@pytest.mark.ci
@pytest.mark.slow
def test_the_command_measures() -> None:
    done = run_command(str(CASES / "material_damping.toml"), "--ablate")
    assert done.exit_code == 0
    assert re.search(r"^material_damping +on +until .* of the size, estimate", done.stdout, re.MULTILINE)
    assert re.search(r"^launch_force +off +not estimated", done.stdout, re.MULTILINE)


@pytest.mark.parametrize(
    ("override", "height"),
    [("effects.orbit.altitude=400e3", 400e3), ("effects.orbit.along_track=[0.0,1.0,0.0]", None)],
)
def test_effects_assume_the_orbit_of_the_case(override, height):
    scene = load(IN_ORBIT, [override]).scene
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
    scene = load(IN_ORBIT, ["effects.orbit.altitude=", "effects.orbit.mean_motion=1.1e-3"]).scene
    assert finding(scene, "j2").keys.mean_motion == 1.1e-3
    assert finding(scene, "molecular_drag").keys.altitude == pytest.approx(528.2e3, abs=200.0)


def test_nothing_is_assumed_below_the_known_atmosphere():
    assert finding(load(IN_ORBIT, ["effects.orbit.altitude=100e3"]).scene, "molecular_drag").keys is None
