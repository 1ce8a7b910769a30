"""The books of momentum and energy, body by body, and how bodies have moved: headlines with their spread."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.results.course import Course, course_of
from exunet.results.ends import END
from exunet.results.headlines import headline, headlines_for, headlines_of
from exunet.results.judged import words_of_vector
from exunet.results.margins import Peak
from exunet.results.measures import all_have_lines, dissipation, energy_errors
from exunet.results.spread import Spread
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case
from exunet.studies.ensemble import perturbed_bodies_of
from exunet.studies.spread import spread_of

FREE = """
format = 1
title = "A body that turns"
[time]
end = 0.1
output_step = 0.01
[solver]
method = "VelocityVerlet"
step = 1e-4
[net]
topology = "explicit"
nodes = [[5.0, 3.0, 0.0]]
elements = []
node_masses = [0.1]
[net.cable]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e9
[initial]
packing = 1.0
[bodies.one]
mass = 10.0
inertia = [2.0, 3.0, 4.5]
angular_velocity = [0.05, 3.0, 0.02]
"""
CASES = Path(__file__).parents[1] / "cases" / "bodies"
THROWN = "release", ("time.end=0.45", "engine.backend=compiled")  # the net is thrown at 0.4 s
TOWED = "tow", ("time.end=6.0", "solver.tolerance=1e-6")  # the brake pays out under a load
HELD = "snap", ("time.end=0.9", "solver.step=1e-3", "engine.backend=compiled", "bodies.chaser.motion=fixed")


def vector(found: dict[str, Any], name: str, unit: str) -> np.ndarray:
    return np.array([found[f"{name}_{axis}_{unit}"] for axis in "xyz"])


@pytest.mark.slow_for("towed")
@pytest.mark.parametrize(("case", "overrides"), [THROWN, TOWED, HELD], ids=["thrown", "towed", "held"])
def test_the_books_close(case: str, overrides: tuple[str, ...]) -> None:
    """What all have gained is what given bodies have given, and the works less the dissipation."""
    result = exunet.run(exunet.load(CASES / f"{case}.toml", overrides))
    found = headlines_of(course_of(result))
    free = [f"body_{name}" for name in result.bodies if f"body_{name}_momentum_gained_x_kg_m_s" in found]
    given = [f"body_{name}" for name in result.bodies if f"body_{name}_work_J" in found]
    assert len(free) + len(given) == len(result.bodies) == 2
    moved = 0.0
    for gained, unit, impulse, units in (
        ("momentum_gained", "kg_m_s", "impulse", "N_s"),
        ("angular_momentum_gained", "kg_m2_s", "angular_impulse", "N_m_s"),
    ):
        every = np.array([vector(found, f"{name}_{gained}", unit) for name in (*free, "net")])
        back = sum((vector(found, f"{name}_{impulse}", units) for name in given), np.zeros(3))
        assert np.abs(every.sum(axis=0) - back).max() < 1e-7 * np.abs(every).max()
        moved = max(moved, float(np.abs(every).max()))
    assert moved > 0.1
    gains = [found[f"{name}_kinetic_energy_gained_J"] for name in (*free, "net")]
    gains += [found["elastic_energy_gained_J"], found.get("potential_energy_gained_J") or 0.0]
    works = [found[f"{name}_work_J"] for name in given] + [found["work_of_ejection_J"] or 0.0]
    works += [one for key, one in found.items() if key.endswith("_work_of_reel_J")]
    allowed = 1e-6 * float(result.kinetic.max())
    assert sum(gains) == pytest.approx(sum(works) - found["dissipated_energy_J"], abs=allowed)


@pytest.mark.parametrize(("case", "overrides", "work"), [(*THROWN, 1.0), (*TOWED, -1.0)])
def test_no_work_that_is_put_in_counts_as_dissipated(case: str, overrides: Any, work: float) -> None:
    """The throw puts energy in, a brake takes it out: neither is in what damping has taken."""
    result = exunet.run(exunet.load(CASES / f"{case}.toml", overrides))
    taken = dissipation(result)
    assert abs(float(result.dissipated[-1])) > 1.0
    assert np.diff(taken).min() > -1e-6
    assert 0.0 < taken[-1] < 0.5
    found = headlines_of(course_of(result))
    put_in = found["work_of_ejection_J"] or found["tether_tow_work_of_reel_J"]
    assert put_in is not None
    assert put_in * work > 1.0
    assert put_in == pytest.approx(taken[-1] - result.dissipated[-1], rel=1e-12)


@pytest.fixture(scope="module")
def thrown() -> tuple[exunet.Result, Spread]:
    case = exunet.load(CASES / f"{THROWN[0]}.toml", THROWN[1])
    return exunet.run(case), spread_of(prepare_case(case), 2)


def test_moved_starts_have_the_same_headlines(thrown: tuple[exunet.Result, Spread]) -> None:
    result, spread = thrown
    ours, theirs = headlines_of(course_of(result)), headlines_of(spread.plain)
    assert list(ours) == list(theirs)
    for key, value in ours.items():
        if value is None:
            assert theirs[key] is None
        elif "attachment_" in key:  # peaks at other times: test_attachment_headlines.py has them at the same
            continue
        elif "body_" in key or key.startswith("net_") or "energy" in key or "work" in key:
            assert theirs[key] == pytest.approx(value, rel=1e-4, abs=1e-6), key
    for item in headlines_for(spread.plain):
        assert headline(item.key).key == item.key
        assert headline(item.key).words == item.words


def test_bodies_are_moved_too_but_not_those_of_given_motion() -> None:
    """A body holds the net that is thrown: moves of its nodes alone would change nothing."""
    start = prepare_case(
        exunet.load(CASES / "release.toml", (*THROWN[1], "bodies.satellite.motion=prescribed"))
    )
    first, last = (perturbed_bodies_of(start, 2, 1e-9, 3, first=k) for k in (0, 1))
    assert first is not None
    assert last is not None
    for own, moved, again in zip(start.state.bodies.parts(), first.parts(), last.parts(), strict=True):
        assert np.array_equal(moved[1], again[0])  # a run is moved in one way, however many there are
        assert np.array_equal(moved[:, 1], np.stack([own[1]] * 2))  # the satellite
    places, attitudes = np.abs(first.position - start.state.bodies.position), first.attitude[:, 0]
    assert 1e-10 < places.max() <= 1e-9
    assert (first.velocity == start.state.bodies.velocity).all()
    np.testing.assert_allclose(np.linalg.norm(attitudes, axis=-1), 1.0, rtol=1e-14)
    assert 1e-10 < np.abs(attitudes - start.state.bodies.attitude[0]).max() < 1e-9
    one, other = spread_of(start, 2).courses
    assert not np.array_equal(one.ends["spin"], other.ends["spin"])
    assert not np.array_equal(one.area, other.area)
    alone = prepare_case(exunet.load(CASES.parent / "planar_deployment.toml"))
    assert perturbed_bodies_of(alone, 2, 1e-9, 3) is None


@pytest.mark.ci
@pytest.mark.slow
def test_no_number_of_a_body_stands_alone(thrown: tuple[exunet.Result, Spread]) -> None:
    """Each has an error in the summary and in the table; parts of a vector share a row and an error."""
    result, spread = thrown
    summary = summarise(result, None, spread)
    of_bodies = [key for key in summary["headlines"] if key.startswith("body_")]
    for name in ("velocity", "angular_velocity", "momentum_gained", "angular_momentum_gained"):
        assert any(f"body_deployer_{name}_x" in key for key in of_bodies), name
    assert {"body_satellite_turned_rad", "body_satellite_kinetic_energy_gained_J"} < set(of_bodies)
    for key in of_bodies:
        assert summary["headlines"][key]["error"] is not None, key
    table = dict(rows(summary, spread))
    assert "± " in table["momentum gained by deployer"]
    assert table["velocity of deployer"].endswith("m/s (at the end, in the scene's axes)")
    assert table["angular momentum gained by satellite"].endswith("kg m2/s (about the scene's origin)")
    assert table["momentum gained by the net"].endswith("kg m/s (in the scene's axes)")
    assert list(table).index("books") < list(table).index("momentum gained by deployer")
    assert "velocity of deployer, x" not in table
    alone = dict(rows(summarise(result)))
    assert alone["velocity of deployer"].count(",") >= 2


def turning(spin: float, angle: float) -> Course:
    """A body of 2 kg that flies at 3 m/s along x, and turns about z."""
    ends = np.zeros((2, 2), dtype=END)
    ends["velocity"][:, 0], ends["momentum"][:, 0] = [3.0, 0.0, 0.0], [6.0, 0.0, 0.0]
    ends["attitude"][0, 0] = [1.0, 0.0, 0.0, 0.0]
    ends["attitude"][1, 0] = [np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)]
    ends["spin"][1, 0] = [0.0, 1e-4, spin]
    time = np.linspace(0.0, 2.0, 5)
    zeros = np.zeros(5)
    return Course(
        time=time,
        area=zeros,
        achievable_area=0.0,
        centre=np.zeros((5, 3)),
        bullet_speed=np.zeros((5, 0)),
        kinetic=zeros,
        elastic=zeros,
        dissipated=zeros,
        tension=zeros,
        peaks={"net": Peak(0.0, 0.0, -1)},
        potential=zeros,
        body_names=("box",),
        body_centre=np.outer(time, [3.0, 0.0, 0.0])[:, None],
        reel=np.zeros((5, 0, 2)),
        loaded=np.zeros((5, 0)),
        loaded_element=np.zeros((5, 0), dtype=np.int64),
        units=np.zeros((5, 0)),
        pull=np.zeros((5, 0, 2)),
        mouth=np.zeros((5, 0)),
        edge=np.zeros((5, 0)),
        spin=np.zeros((5, 1, 3)),
        momentum=np.zeros((5, 2, 6)),
        taken=np.zeros((5, 0)),
        turning=("box",),
        ends=ends,
    )


def spread(*courses: Course) -> Spread:
    return Spread(courses, (), courses[0], courses[0], 0, 1e-9, "DOPRI5", 1e-6, None, 1e-7)


def test_by_hand() -> None:
    found = headlines_of(turning(0.5, 0.25))
    assert vector(found, "body_box_velocity", "m_s").tolist() == [3.0, 0.0, 0.0]
    assert found["body_box_angular_velocity_z_rad_s"] == 0.5
    assert found["body_box_turned_rad"] == pytest.approx(0.25, rel=1e-14)
    assert headlines_of(turning(0.5, 6.0))["body_box_turned_rad"] == pytest.approx(2.0 * np.pi - 6.0)
    assert found["body_box_momentum_gained_x_kg_m_s"] == 0.0
    assert "potential_energy_gained_J" in found
    assert found["potential_energy_gained_J"] is None
    resting = replace(turning(0.5, 0.25), guided=("box",))
    assert "body_box_velocity_x_m_s" not in headlines_of(resting)
    assert "body_box_impulse_x_N_s" in headlines_of(resting)


def test_a_vector_in_words() -> None:
    """Its small parts have the digits of the whole; beyond the horizon each part has its own range."""
    keys = [f"body_box_angular_velocity_{axis}_rad_s" for axis in "xyz"]
    sure = spread(turning(0.5, 0.25), turning(0.5, 0.25)).judged
    assert words_of_vector([sure[key] for key in keys]) == "(0, 0.0001, 0.5000) rad/s"
    unsure = spread(turning(0.5, 0.25), turning(0.7, 0.25)).judged
    found = words_of_vector([unsure[key] for key in keys])
    assert found == "x: 0 rad/s; y: 0.0001 rad/s; z: median 0.6000 rad/s, 0.5000 to 0.7000 rad/s"


def test_a_part_is_judged_by_the_size_of_its_vector() -> None:
    """y differs by a third of itself, but by 1e-5 of the vector: that is known to the printed digits."""
    one, other = turning(0.5, 0.25), turning(0.5, 0.25)
    other.ends["spin"][1, 0, 1] *= 1.3
    judged = spread(one, other).judged["body_box_angular_velocity_y_rad_s"]
    assert judged.predictable
    assert judged.headline.last_digit(1e-4) < 1e-6 < judged.last_digit(1e-4)


def test_an_entry_is_judged_beside_the_largest_of_its_book() -> None:
    """The net gains 1e-6 of what the body gains, give or take a tenth: known to the printed digits."""

    def exchanging(part: float) -> Course:
        made = turning(0.5, 0.25)
        made.ends["kinetic"] = [[1.0, 2.0], [3.0, 2.0 + part]]
        return replace(made, elastic=np.linspace(0.0, part, 5))

    found = spread(exchanging(2e-6), exchanging(2.2e-6)).judged
    for key in ("net_kinetic_energy_gained_J", "elastic_energy_gained_J"):
        assert found[key].predictable
        assert found[key].words() in ("0.0000020 ± 0.0000002 J", "0.0000020 ± 0.0000003 J")  # and round-off
    assert found["body_box_kinetic_energy_gained_J"].words() == "2.000 J"


def test_a_body_that_hardly_turns_is_known_not_to() -> None:
    assert spread(turning(0.5, 1e-6), turning(0.5, 3e-6)).judged["body_box_turned_rad"].predictable


def test_balances_say_what_is_absolute_and_what_relative() -> None:
    """Absolute changes have a unit, and parts say of what; momenta say in which axes, about which point."""
    short = ("time.end=0.01", "engine.backend=compiled", "bodies.chaser.motion=fixed")
    summary = summarise(exunet.run(exunet.load(CASES / "snap.toml", short)))
    summary["energy"] = {"balance_error": 3.9e-9, "scale_J": 43.5438, "scale_of": "deformation"}
    summary["momentum"] |= {
        "linear_gained_kg_m_s": 2e-12, "linear_residual_kg_m_s": 2e-12, "linear_size_kg_m_s": 400.0,
        "angular_gained_kg_m2_s": 0.0, "angular_residual_kg_m2_s": 0.0, "angular_size_kg_m2_s": 0.0,
    }  # fmt: skip
    table = dict(rows(summary))
    words = "largest error 3.9e-09 as a part of the 43.5438 J that can deform the net"
    assert table["energy balance"] == words
    words = "changes by at most 2e-12 kg m/s, 5e-15 as a part of its size 400 kg m/s (in the scene's axes"
    why = "; error; besides what chaser gave)"  # nothing else acts from outside
    assert table["momentum of all"] == words + why
    words = "changes by at most 0 kg m2/s (about the scene's origin"
    assert table["angular momentum of all"] == words + why
    assert table["axes"].endswith("in the scene's axes, which are inertial")
    summary["momentum"]["residual_is_error"] = False
    words = "changes by at most 0 kg m2/s (about the scene's origin; by forces from outside, or error; "
    assert dict(rows(summary))["angular momentum of all"] == words + "besides what chaser gave)"
    summary["effects"] = ["orbit"]
    assert dict(rows(summary))["axes"].endswith("which turn with the orbit, relative to these")


def test_what_a_thrust_puts_in_is_said() -> None:
    result = exunet.run(exunet.load(CASES / "snap.toml", ("time.end=0.01", "engine.backend=compiled")))
    assert "put in" not in dict(rows(summarise(result)))["energy dissipated"]
    pushed = replace(result, provenance=result.provenance | {"effects": ["thrust"]})
    assert "less what thrust put in" in dict(rows(summarise(pushed)))["energy dissipated"]


def test_what_is_left_of_momentum_is_error_where_all_else_has_a_line() -> None:
    """Material damping pulls along elements; gravity has a line; a chaser that is a point mass has none."""
    for more in (["effects="], [], ["effects.gravity.acceleration=[0.0, 0.0, -2.0]"]):
        found = exunet.run(exunet.load(CASES / "launch.toml", ["time.end=0.005", *more]))
        assert all_have_lines(found)
        assert "; error)" in dict(rows(summarise(found)))["momentum of all"]
    alone = exunet.load(CASES.parent / "effects" / "launch_force.toml", ["time.end=0.005"])
    assert not all_have_lines(exunet.run(alone))
    method = {"method": "TrapezoidalIndex2"}  # which has no first-order states
    assert not all_have_lines(replace(found, provenance=found.provenance | method))


def test_the_error_of_the_energy_is_a_part_of_what_is_printed(tmp_path: Path) -> None:
    """Of a body that no force acts on, nothing can deform the net: its error is a part of all motion.

    Exudyn's Verlet turns bodies by Euler's method: within 0.1 s it errs by 4e-8 J (measured).
    """
    path = tmp_path / "free.toml"
    path.write_text(FREE, encoding="utf-8")
    found = exunet.run(exunet.load(path))
    energy = summarise(found)["energy"]
    error = np.abs(energy_errors(found)).max()
    assert energy["scale_of"] == "motion"
    assert energy["scale_J"] == found.kinetic.max() > 10.0
    assert energy["balance_error"] == error / energy["scale_J"] > 1e-9
    words = dict(rows(summarise(found)))["energy balance"]
    assert words.endswith(
        f" as a part of the {energy['scale_J']:.6g} J of all motion: nothing can deform the net"
    )
    tumbling = exunet.run(exunet.load(CASES / "tumbling.toml", ["time.end=0.04", "engine.backend=compiled"]))
    energy = summarise(tumbling)["energy"]
    assert energy["scale_of"] == "deformation"
    assert energy["scale_J"] < 1.0 < 800.0 < tumbling.kinetic[0]  # 869 J of spin
