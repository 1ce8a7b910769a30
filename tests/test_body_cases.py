"""The shipped scenes of bodies: what the head of each file expects."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.results.measures import momentum_books
from exunet.results.summary import summarise
from exunet.simulation.preparation import NO_REACTION, prepare_case

CASES = Path(exunet.__file__).parent / "cases" / "bodies"


def result(name: str, *overrides: str) -> exunet.Result:
    return exunet.run(exunet.load(CASES / f"{name}.toml", overrides))


def stays(found: exunet.Result) -> None:
    """Linear momentum to 1e-10 and angular momentum to 1e-8 of their sizes."""
    for kind, bound in (("linear", 1e-10), ("angular", 1e-8)):
        book = momentum_books(found)[kind]
        assert book.residual < bound * book.size


def test_the_summary_has_the_books_of_momentum() -> None:
    """Of a launch: kept to round-off, of parts with up to 0.2 kg x 3 m/s; with gravity: its impulse."""
    found = result("launch", "time.end=0.1")
    books = summarise(found)["momentum"]
    assert books["linear_gained_kg_m_s"] < 1e-12 < 0.5 < books["linear_size_kg_m_s"] < 100.0
    assert books["angular_gained_kg_m2_s"] < 1e-8 < 1.0 < books["angular_size_kg_m2_s"]
    pulled = result("launch", "time.end=0.1", "effects.gravity.acceleration=[0.0, 0.0, -2.0]")
    given = (80.0 + float(found.net.mass.sum())) * 2.0 * 0.1
    books = summarise(pulled)["momentum"]
    assert books["linear_gained_kg_m_s"] == pytest.approx(given, rel=1e-6)
    assert books["linear_residual_kg_m_s"] < 1e-12


@pytest.mark.slow
def test_the_dumbbell_swings() -> None:
    """2 pi / (sqrt(3) n), longer by 0.1^2 / 4: in twice the angle it is a pendulum of amplitude 0.2."""
    found = result("dumbbell")
    span = found.bodies["above"].position - found.bodies["below"].position
    angle = np.arctan2(span[:, 1], span[:, 0])
    zeros = CubicSpline(found.time, angle).roots(extrapolate=False)
    period = 2.0 * math.pi / (math.sqrt(3.0) * 1.1e-3) * (1.0 + 0.1**2 / 4.0)
    assert 2.0 * float(zeros[1] - zeros[0]) == pytest.approx(period, rel=1e-3)
    assert found.tension[5:].min() > 0.0
    assert np.abs(angle).max() == pytest.approx(0.1, rel=1e-3)


@pytest.mark.slow_for("engine.backend=exudyn1", "engine.backend=compiled")
@pytest.mark.parametrize("form", [
    "engine.backend=exudyn",
    *(
        pytest.param(form, marks=pytest.mark.slow)
        for form in ("engine.backend=exudyn", "engine.backend=compiled")
    ),
])  # fmt: skip
def test_the_release_waits(form: str) -> None:
    """The line from a held bullet pulls at the deployer, also where the engine has elements of its own."""
    found = result("release", "time.end=0.5", form)
    stays(found)
    deployer, held = found.bodies["deployer"], found.time < 0.4
    net = found.position[:, : found.net.n_net_nodes] - deployer.position[:, None]
    inside = np.einsum("kij,kni->knj", rotation_matrix(np.asarray(deployer.attitude)), net)
    assert np.ptp(inside[held], axis=0).max() < 1e-13
    pulled = found.tension[:, found.net.tether_elements["line"]].max(axis=1) > 0.0
    first = found.time[pulled][0]
    assert 0.1 < first < 0.2
    spin = np.linalg.norm(deployer.angular_velocity - deployer.angular_velocity[0], axis=1)
    assert spin[found.time < first].max() < 1e-3 < 1e-2 < spin[held][-1]
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total - total[0]).max() < 1e-6 * found.kinetic.max()


@pytest.mark.slow
def test_the_body_that_holds_the_net_bears_what_pulls_on_it(tmp_path: Path) -> None:
    """Force and torque about the net's origin give deployer and net their momenta, about the scene's origin.

    By cubic splines through 600 stored times, over the start of the pull, which has kinks at both ends of
    slackness: 1e-3 of what is gained.
    """
    found = result("release", "time={end=0.41, output_step=5e-4}")
    exunet.save(found, tmp_path / "release.h5")
    of = exunet.loads(exunet.load_result(tmp_path / "release.h5"), "deployer")
    assert (of.nodes.size, of.carried is not None) == (0, True)
    assert of.carried.until == 0.4
    body, net = found.bodies["deployer"], slice(0, found.net.n_net_nodes)
    momentum = np.einsum("n,kni->ki", found.net.mass[net], found.velocity[:, net]) + 80.0 * body.velocity
    spin = np.cross(found.position[:, net], found.velocity[:, net])
    turn = rotation_matrix(np.asarray(body.attitude))
    own = np.einsum("kij,jl,kl->ki", turn, body.inertia, body.angular_velocity)
    angular = np.einsum("n,kni->ki", found.net.mass[net], spin) + own
    angular += 80.0 * np.cross(body.position, body.velocity)
    torque = of.carried.torque + np.cross(of.carried.origin, of.carried.force)
    last = found.time.searchsorted(0.4) - 1
    for gained, given in ((momentum, of.carried.force), (angular, torque)):
        whole = gained[last] - gained[0]
        impulse = CubicSpline(found.time, given).integrate(0.0, found.time[last])
        assert np.linalg.norm(whole) > 0.1
        np.testing.assert_allclose(impulse, whole, atol=1e-3 * np.linalg.norm(whole))
    place = np.array([0.0, 0.0, 0.8])
    np.testing.assert_allclose(of.carried.origin, body.position + turn @ place, atol=1e-14)
    summary = summarise(found)
    (entry,) = summary["attachments"]["deployer"]
    assert (entry["node"], entry["packed_net_until_s"]) == (None, 0.4)
    largest = summary["headlines"][f"{entry['headlines']}_largest_force_N"]["this_run"]
    assert largest == np.linalg.norm(of.carried.force, axis=1).max() > 1.0


def test_a_net_that_is_let_go_pulls_no_more() -> None:
    found = result("release", "time.end=0.45")
    of, gone = exunet.loads(found, "deployer").carried, found.time >= 0.4
    assert of is not None
    assert not of.force[gone].any()
    assert np.abs(of.force[found.time.searchsorted(0.4) - 1]).max() > 1.0
    assert exunet.loads(found, "satellite").carried is None


def test_a_launch_from_no_body_is_told() -> None:
    """The chaser is there, but the net is not in its frame; no word with the frame, or without a chaser."""
    bare = ["initial.frame="]
    notes = {
        name: prepare_case(exunet.load(CASES / "launch.toml", changes)).plan.notes
        for name, changes in {"frame": [], "bare": bare, "alone": ["bodies=", "tethers=", *bare]}.items()
    }
    assert {name: NO_REACTION in told for name, told in notes.items()} == {
        "frame": False,
        "bare": True,
        "alone": False,
    }


@pytest.mark.ci
@pytest.mark.slow
def test_the_snap_throws_back() -> None:
    found = result("snap", "time.end=1.4")
    stays(found)
    slack = found.tension.max(axis=1) == 0.0
    assert slack[0]
    assert not slack.all()
    chaser, target = found.bodies["chaser"], found.bodies["target"]
    assert target.velocity[-1, 2] < 0.5 < 1.0 < chaser.velocity[-1, 2]  # 2/3 - 1/3, 2/3 + 2/3 if on the line
    assert np.abs(chaser.angular_velocity[-1]).max() > 0.5
    total = found.kinetic + found.elastic
    assert np.abs(total / total[0] - 1.0).max() < 1e-5


def test_the_throw_turns_the_chaser() -> None:
    found = result("launch", "time.end=0.4")
    stays(found)
    chaser = found.bodies["chaser"]
    assert chaser.velocity[0] @ [0.0, -math.sin(0.3), math.cos(0.3)] < -0.02  # against the throw
    bullets = found.net.bullet_nodes
    way = found.velocity[0, bullets].mean(axis=0)
    assert way @ [0.0, -math.sin(0.3), math.cos(0.3)] == pytest.approx(3.0 * math.cos(0.5), rel=0.01)
    assert found.kinetic[0] == pytest.approx(0.5 * 4 * 0.2 * 9.0, rel=0.2)


def test_springs_eject_the_net_from_a_turning_chaser() -> None:
    found = result("ejection", "time.end=0.1")
    stays(found)
    chaser, bullets = found.bodies["chaser"], found.net.bullet_nodes
    mass, work = float(found.net.mass[bullets[0]]), 0.5 * 36.0 * 0.05
    assert found.potential[0] == pytest.approx(4.0 * work, rel=1e-12)
    inside = found.time[np.flatnonzero(found.potential)[-1]]
    # To one output step.
    assert inside == pytest.approx(0.5 * math.pi * math.sqrt(mass * 0.05 / 36.0), abs=0.002)
    out = np.flatnonzero(found.time > 0.027)[0]
    turn = rotation_matrix(chaser.attitude[out])
    spin = turn @ chaser.angular_velocity[out]
    relative = found.velocity[out, bullets] - chaser.velocity[out]
    relative -= np.cross(spin, found.position[out, bullets] - chaser.position[out])
    speed = math.sqrt(2.0 * work / mass * (1.0 + 4.0 * mass / 80.0 * math.cos(0.5) ** 2))
    # Bullets that turn with the chaser have m w^2 d^2 / 2 more from 0.8 m to 0.85 m: 0.5 % at 0.7 rad/s
    np.testing.assert_allclose(np.linalg.norm(relative, axis=1), speed, rtol=5e-3)
    back = 4.0 * mass * speed * math.cos(0.5) / (80.0 + 4.0 * mass)
    axis = np.array([0.0, -math.sin(0.3), math.cos(0.3)])
    assert chaser.velocity[out] @ axis == pytest.approx(-back, rel=0.02)
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total - total[0]).max() < 1e-5 * found.potential[0]


def test_the_frame_takes_its_net_along() -> None:
    found = result("frame", "time.end=0.3")
    stays(found)
    corners = found.position[:, found.bodies["frame"].nodes]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    np.testing.assert_allclose(sides, 1.96, rtol=1e-12)  # rigid
    assert found.tension.max() > 0.1
    total = found.kinetic + found.elastic + found.dissipated
    assert np.abs(total / total[0] - 1.0).max() < 1e-5


@pytest.mark.ci
@pytest.mark.slow
def test_the_tow_pays_out_and_winds_up() -> None:
    """The pull is that of the drive, docs/theory_bodies.md, Reels: N_e = force + damping x rate given way."""
    found = result("tow")
    stays(found)
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total / total[0] - 1.0).max() < 1e-7
    wound = found.states["tow/wound_up"].values[:, 0]
    rate = CubicSpline(found.time, wound)(found.time, 1)
    pull = exunet.loads(found, "chaser").size[:, 0]
    braking, winding = (found.time > 3.0) & (found.time < 9.5), (found.time > 11.0) & (found.time < 12.5)
    np.testing.assert_allclose(pull[braking], 6.0 - 40.0 * rate[braking], rtol=2e-3)
    np.testing.assert_allclose(pull[winding], 40.0 - 40.0 * rate[winding], rtol=2e-3)  # below 0.4 m/s
    assert rate[winding].max() < 0.4
    nodes = [event["event"].split(" ", 2)[2] for event in found.provenance["reels"] if "node" in event]
    assert nodes == ["comes off the drum", "goes onto the drum", "goes onto the drum"]
    assert found.tension[found.time > 20.0].max() == 0.0
    apart = np.linalg.norm(found.bodies["chaser"].position - found.bodies["target"].position, axis=1)
    assert (np.diff(apart[found.time > 20.0]) < 0.0).all()


def test_effects_are_not_chosen_for_bodies_and_tethers() -> None:
    """Their estimates are of a net alone: an orbit that swings a dumbbell would be switched off."""
    chosen = ["effects.choose=auto", "effects.threshold=1e-3"]
    with pytest.raises(exunet.ExunetError, match=r"effects\.choose: its estimates are of a net alone"):
        exunet.load(CASES / "dumbbell.toml", chosen)
