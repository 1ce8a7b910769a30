"""Mistakes of beginners: each gives an error or a warning at its key before anything runs."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from commands import command
from scenes import CASES, NET_AT_BALL, SHIPPED_CASES, of_text

import exunet
from exunet.base.errors import CaseError
from exunet.methods.method import Method
from exunet.model.limits import drive_factor, largest_damping_rate, largest_frequency, stable_step
from exunet.net import weave
from exunet.scene.casefile import implausible
from exunet.scene.plausibility import damping_note, place_notes
from exunet.simulation.preparation import prepare_case

FAR = "bodies.ball.position=[0.0, 0.0, 1.5]"  # 1.35 m away, reached after 0.68 s
# The override of a mistake, or several, and the key that its warning names.
WARNED: dict[str, tuple[str | tuple[str, ...], str]] = {
    "modulus in GPa": ("net.cable.youngs_modulus=70.0", "net.cable.youngs_modulus"),
    "modulus in MPa": ("net.cable.youngs_modulus=7e4", "net.cable.youngs_modulus"),
    "modulus in kPa of GPa": ("net.cable.youngs_modulus=7e13", "net.cable.youngs_modulus"),
    "density in g/cm3": ("net.cable.density=1.39", "net.cable.density"),
    "density in g/m3": ("net.cable.density=1.39e6", "net.cable.density"),
    "thread of 1 m": ("net.cable.diameter=1.0", "net.cable.diameter"),
    "diameter in km": ("net.cable.diameter=1e-6", "net.cable.diameter"),
    "strength of a hawser": ("net.cable.strength=4e5", "net.cable.strength"),
    "relaxation in ms": ("effects.material_damping.relaxation_time=0.1", "effects.material_damping."),
    "relaxation in Ms": ("effects.material_damping.relaxation_time=1e-10", "effects.material_damping."),
    "tether's modulus": ("tethers.tow.youngs_modulus=70.0", "tethers.tow.youngs_modulus"),
    "bullets in g": ("net.bullets.mass=500.0", "net.bullets.mass"),
    "bullets too heavy": ("net.bullets.mass=20.0", "net.bullets.mass"),
    "bullets in t": ("net.bullets.mass=2e-5", "net.bullets.mass"),
    "threads fly through": (
        ("effects.contact.threads=[]", "effects.contact.stiffness="),
        "effects.contact.bullets",
    ),
    "bullets of 10 m": ("effects.contact.bullet_radius=10.0", "effects.contact.bullet_radius"),
    "soft contact of threads": ("effects.contact.stiffness=0.1", "effects.contact.stiffness"),
    "soft contact of bullets": ("effects.contact.bullet_stiffness=1.0", "effects.contact.bullet_stiffness"),
    "friction in percent": ("effects.contact.friction.coefficient=40.0", "effects.contact.friction."),
    "impact in mm/s": ("effects.contact.impact_speed=2000.0", "effects.contact.impact_speed"),
    "line in g/m": ("closing.linear_density=100.0", "closing.linear_density"),
    "line's stiffness in GN": ("closing.stiffness=1e-7", "closing.stiffness"),
    "line's strength in MN": ("closing.strength=1e-6", "closing.strength"),
    "strength in kN": ("net.cable.strength=0.04", "net.cable.strength"),
    "body in g": ("bodies.ball.mass=1e4", "bodies.ball.mass"),
    "body in t": ("bodies.ball.mass=1e-3", "bodies.ball.mass"),
    "body in mm": ("bodies.ball.radius=150.0", "bodies.ball"),
    "spin in degrees": ("bodies.ball.angular_velocity=[0.0, 0.0, 180.0]", "bodies.ball.angular_velocity"),
    "thrown at mm/s": ("initial.velocity=[0.0, 0.0, 2000.0]", "initial.velocity"),
    "not thrown": ("initial.velocity=[0.0, 0.0, 0.0]", "initial.velocity"),
    "thrown backwards": ("initial.velocity=[0.0, 0.0, -2.0]", "initial.velocity"),
    "target out of reach": ("bodies.ball.position=[0.0, 0.0, 100.0]", "time.end"),
    "target beside the way": ("bodies.ball.position=[3.0, 0.0, 0.5]", "initial.velocity"),
    "target behind": ("bodies.ball.position=[0.0, 0.0, -5.0]", "initial.velocity"),
    "tether too short": ("tethers.tow.length=0.3", "tethers.tow.length"),
    "stiff reel": (  # stops 0.09 kg within m v / c = 0.2 mm
        ("tethers.tow.reel.damping=1000.0", FAR),
        "tethers.tow.reel.commands[0]",
    ),
    "reel's rate in km/s": ("tethers.tow.reel.largest_rate=1e-3", "tethers.tow.reel.largest_rate"),
    "reel locked": ("tethers.tow.reel.commands=[]", "tethers.tow.reel"),
    "winch too weak": (
        "closing.winch.commands=[{at=0.2, mode='tension', force=0.001}]",
        "closing.winch",
    ),
    "line stays long": ("closing.winch.shortest=3.0", "closing.winch.shortest"),
    "mouth in cm": ("capture.mouth=28.0", "capture.mouth"),
    "too late to capture": ((FAR, "time.end=0.9"), "time.end"),
    "no time to capture": ("capture.duration=3.0", "capture.duration"),
    "gravity in mm/s2": ("effects.gravity={acceleration=[0.0, 0.0, -9810.0]}", "effects.gravity."),
    "air in g/m3": (
        "effects.air_drag={density=1225.0, drag_coefficient=1.0, bullet_drag_coefficient=0.5, "
        "bullet_area=1e-3}",
        "effects.air_drag.density",
    ),
    "altitude in km": (
        "effects.orbit={altitude=700.0, radial=[0.0, 0.0, 1.0], along_track=[1.0, 0.0, 0.0], model='linear'}",
        "effects.orbit.altitude",
    ),
    "states after the end": ("time.output_step=20.0", "time.output_step"),
    "event after the end": ("script=[{name='late', at=20.0, do='note'}]", "script[0].at"),
}
BRAKE_OF_SCRIPT = "script=[{name='free', at=0.0, do='brake', on='tow', force=0.1}]"
REFUSED = {
    "negative mass": ("net.bullets.mass=-0.02", "net.bullets.mass"),
    "angle in degrees": ("launch={speed=2.0, spread_angle=45.0}", "launch.spread_angle"),
    "text for a number": ("net.cable.youngs_modulus='1e8'", "net.cable.youngs_modulus"),
    "meshes do not fit": ("net.mesh=0.3", "net.mesh"),
    "unknown body": ("effects.contact.threads=['box']", "effects.contact.threads[0]"),
    "unknown target": ("capture.target='bal'", "capture.target"),
    "more paid out than there is": ("tethers.tow.reel.paid_out=30.0", "tethers.tow.reel.paid_out"),
    "nothing to wind up": ("closing.winch.shortest=5.0", "closing.winch.shortest"),
    "packed to less than nothing": ("initial.packing=-1.0", "initial.packing"),
    "misspelt key": ("net.bullets.mas=0.02", "net.bullets.mas"),
}


@pytest.mark.parametrize("mistake", WARNED)
def test_a_mistake_is_warned_of(mistake: str) -> None:
    overrides, key = WARNED[mistake]
    overrides = (overrides,) if isinstance(overrides, str) else overrides
    found = [fault.key for fault in implausible(of_text(NET_AT_BALL, *overrides))]
    assert any(item == key or (key.endswith(".") and item.startswith(key)) for item in found), found


def test_only_a_mistake_is_warned_of() -> None:
    """A plausible scene, and the force alone of a brake that would stop after 3.6 m by its damping."""
    assert implausible(of_text(NET_AT_BALL)) == []
    for force, keys in ((0.0, []), (600.0, ["tethers.tow.reel.commands[0]"])):
        brake = f"tethers.tow.reel.commands=[{{at=0.0, mode='brake', force={force}}}]"
        faults = implausible(of_text(NET_AT_BALL, FAR, "tethers.tow.reel.damping=0.05", brake))
        assert [fault.key for fault in faults] == keys


def test_a_brake_of_a_script_that_stops_the_net_is_warned_of() -> None:
    """0.22 kg at 2 m/s: 20 N s/m stop it after m v / c = 0.02 m, 0.05 N s/m after 8 m."""
    for damping, keys in ((20.0, ["script[0]"]), (0.05, [])):
        reel = f"tethers.tow.reel={{damping={damping}, largest_rate=5.0, paid_out=0.3}}"
        faults = implausible(of_text(NET_AT_BALL, FAR, reel, BRAKE_OF_SCRIPT))
        assert [fault.key for fault in faults] == keys


def test_a_brake_that_is_released_before_it_stops_the_net_is_not_warned_of() -> None:
    """0.091 kg at 2 m/s, taut after 0.1 s: 1 N and 0.05 N s/m take m / c log(1 + c v / F) = 0.17 s."""
    reel = "tethers.tow.reel={damping=0.05, largest_rate=5.0, paid_out=0.3}"
    brake = BRAKE_OF_SCRIPT.replace("0.1}]", "1.0}, {name='s', at=%g, do='release', on='tow'}]")
    for later, keys in ((0.2, []), (2.0, ["script[0]"])):
        script = brake % later
        faults = implausible(of_text(NET_AT_BALL, FAR, reel, script))
        assert [fault.key for fault in faults] == keys


def test_a_drive_that_shortens_the_step_is_named(tmp_path: Path) -> None:
    """By the ratio of the stable steps of a free brake and of a drum that turns at the launch speed."""
    brake = of_text(NET_AT_BALL, "solver={}", "tethers.tow.reel.damping=0.01")
    turning = "tethers.tow.reel={damping=1e9, paid_out=0.3, commands=[{at=0.0, mode='rate', rate=-2.0}]}"
    spool = of_text(NET_AT_BALL, "solver={}", turning)
    systems = [prepare_case(case).system for case in (brake, spool)]
    short, long = (
        stable_step(Method.VELOCITY_VERLET, largest_frequency(system), largest_damping_rate(system))
        for system in systems
    )
    assert drive_factor(systems[0]) == pytest.approx(long / short, rel=0.05)  # the thread's own damping
    assert drive_factor(systems[0]) > 2.0 > drive_factor(systems[1])
    (tmp_path / "ball.toml").write_text(NET_AT_BALL)
    (tmp_path / "result.h5").touch()  # which ends the command after its first lines
    changes = ("--out", ".", "--set", "solver={}", "--set", "tethers.tow.reel.damping=0.01")
    assert "tethers.tow.reel" in command("run", "ball.toml", *changes, folder=tmp_path).stderr


@pytest.mark.parametrize("mistake", REFUSED)
def test_a_mistake_is_refused(mistake: str) -> None:
    override, key = REFUSED[mistake]
    with pytest.raises(CaseError) as error:
        of_text(NET_AT_BALL, override)
    assert key in [fault.key for fault in error.value.faults]


def test_a_warning_has_its_place() -> None:
    """The line of the file, or the override that changed the key."""
    line = next(n for n, text in enumerate(NET_AT_BALL.splitlines(), 1) if text.startswith("youngs_modulus"))
    text = NET_AT_BALL.replace("youngs_modulus = 1e8", "youngs_modulus = 70.0", 1)
    assert f"scene.toml:{line}" in [fault.place for fault in implausible(of_text(text))]
    override = "net.cable.youngs_modulus=70.0"
    assert implausible(of_text(NET_AT_BALL, override))[-1].place.startswith("--set net.cable.youngs_modulus")


@pytest.mark.parametrize(
    ("ratio", "converges", "plausible"),
    [(1e-5, False, False), (0.01, False, True), (0.11, True, True), (0.29, True, True), (0.31, True, False)],
)
def test_damping_that_converges_is_plausible(ratio: float, converges: bool, plausible: bool) -> None:
    """Of the first axial mode of a side of 1 m: w = pi c / L, c2 = E / density, with the ratio tau w / 2.

    Stiffness-proportional Rayleigh damping counts alike; a damping at all is not enough.
    """
    case = CASES / "planar_undamped.toml"
    time = 2.0 * ratio / (math.pi * math.sqrt(70e9 / 1390.0))
    net = exunet.load(case, ["net.strings.length=1.0", f"effects.material_damping.relaxation_time={time}"])
    rayleigh = exunet.load(case, [f"effects.rayleigh_damping={{alpha=0.0, beta={time}}}"])
    for damped in (net.scene, rayleigh.scene):
        assert (damping_note(damped, weave(damped.net)) is None) == converges
    assert (implausible(net) == []) == plausible


def test_a_modulus_of_no_fibre_is_the_cause() -> None:
    """70 GPa without the giga: the damping of such a thread is not what is wrong."""
    keys = [fault.key for fault in implausible(of_text(NET_AT_BALL, "net.cable.youngs_modulus=70.0"))]
    assert "net.cable.youngs_modulus" in keys
    assert "effects.material_damping.relaxation_time" not in keys


def test_a_centre_without_a_knot_is_noted() -> None:
    """Of 4 x 4 meshes a knot is there, of 5 x 5 it is 0.14 m off."""
    overrides = ('tethers.tow.end.node="centre"', "tethers.tow.reel.paid_out=", "net.mesh=", "solver.step=")
    for number, noted in ((4, False), (5, True)):
        case = of_text(NET_AT_BALL, *overrides, f"net.meshes={number}")
        assert any(place_notes(case.scene, weave(case.scene.net))) == noted


@pytest.mark.parametrize("path", SHIPPED_CASES, ids=lambda path: path.stem)
def test_shipped_cases_list_their_warnings(path: Path) -> None:
    """In the line "# Implausible on purpose: KEY, ..." at their head."""
    listed = re.search(r"^# Implausible on purpose: (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    expected = set() if listed is None else set(listed[1].split(", "))
    assert {fault.key for fault in implausible(exunet.load(path))} == expected
