"""A packed net that a body holds until it is ejected: books, before and after, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import BACKENDS, continue_alike

import exunet
from exunet.base.errors import CaseError
from exunet.bodies.rotations import rotation_matrix
from exunet.results.body_headlines import books_of_bodies
from exunet.results.course import course_of
from exunet.results.momenta import gained_by_parts, given_impulses
from exunet.simulation.simulation import Simulation
from exunet.studies.both_codes import read_both
from exunet.verification.topology import topology

CASE = Path(exunet.__file__).parent / "cases" / "bodies" / "launch.toml"
LATER, FREE = "initial.frame.eject_at=0.2", "tethers={}"
SHORT = (
    "time={end=0.3, output_step=0.02}",
    "solver.tolerance=1e-9",
    "bodies.chaser.angular_velocity=[0.5, 2.0, 1.0]",
)


# A way that bends and an attitude that turns to and fro; steps end where the second piece begins.
POSES = (
    ", pose_times=[0.0, 0.14, 0.3], pose_positions=[[0.0, 0.0, 0.0], [0.1, 0.2, -0.1], [-0.2, 0.3, 0.2]]"
    ", pose_attitudes=[[1.0, 0.0, 0.0, 0.0], [0.95, 0.2, 0.1, 0.05], [0.8, 0.1, 0.5, 0.3]]"
)


def case(*overrides: str) -> exunet.Case:
    return exunet.load(CASE, [*SHORT, LATER, *overrides])


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("tied", [False, True])
def test_the_books_of_a_later_ejection(form: str, tied: bool) -> None:
    """Momentum to 1e-12 and angular momentum to 1e-8 of what single parts have; the energy to 1e-5."""
    found = exunet.run(case(BACKENDS[form], *([] if tied else [FREE])))
    assert found.verdict == "ok"
    (event,) = found.provenance["ejection"]
    work = -event.pop("energy_lost_J")
    assert event["time_s"] == 0.2
    assert event["nodes"] == found.net.n_net_nodes
    assert event["body"] == "chaser"
    (before, after) = found.dissipated[np.searchsorted(found.time, 0.2 - 1e-12) - 1 :][:2]
    assert work == pytest.approx(before - after, abs=1e-3 * work)
    scale = float((found.net.mass[:, None] * np.linalg.norm(found.velocity, axis=-1).T).sum(axis=0).max())
    assert np.abs(found.momentum - found.momentum[0]).max() < 1e-12 * scale + 1e-13
    turning = float(np.linalg.norm(found.angular_momentum[0])) + scale
    assert np.abs(found.angular_momentum - found.angular_momentum[0]).max() < 1e-8 * turning
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total - total[0]).max() < 1e-5 * found.kinetic.max()
    thrown = found.time >= 0.2 - 1e-12  # a state that is stored then is the one after it
    speeds = np.linalg.norm(found.velocity[:, found.net.bullet_nodes], axis=-1)
    assert speeds[~thrown].max() < 2.5 < 2.9 < speeds[thrown].min()
    # until then the net rests in the chaser's frame
    body = found.bodies["chaser"]
    turn = rotation_matrix(np.asarray(body.attitude))
    net = found.position[:, : found.net.n_net_nodes]
    inside = np.einsum("kij,kni->knj", turn, net - np.asarray(body.position)[:, None])
    assert np.ptp(inside[found.time < 0.2], axis=0).max() < 1e-13
    assert np.ptp(inside[thrown], axis=0).max() > 0.1


def test_afterwards_it_goes_as_if_it_had_begun_then() -> None:
    """Against a run that begins in the state of the chaser just before, with the throw at time 0."""
    later = Simulation(case(FREE))
    later.advance_to(0.2 - 1e-13)
    chaser = later.state.bodies
    body = later.start.system.bodies[0]
    assert body.is_along_frame
    begin = {"position": chaser.position, "velocity": chaser.velocity, "attitude": chaser.attitude}
    begin |= {"angular_velocity": chaser.angular_velocity}
    keys = [f"bodies.chaser.{name}={values[0].tolist()}" for name, values in begin.items()]
    without = ["bodies.chaser.axis=", "bodies.chaser.angle=", "initial.frame.eject_at=0.0"]
    keys = [key for key in keys if not key.startswith("bodies.chaser.attitude")]
    # the file has axis and angle, which an attitude excludes: as a rotation vector
    turned = 2.0 * np.arccos(np.clip(chaser.attitude[0, 0], -1.0, 1.0))
    axis = chaser.attitude[0, 1:] / np.sin(0.5 * turned)
    keys += [f"bodies.chaser.axis={axis.tolist()}", f"bodies.chaser.angle={float(turned)!r}", without[-1]]
    now = Simulation(case(FREE, *keys))
    for ahead in (0.0, 0.05, 0.1):
        later.advance_to(0.2 + ahead)
        if ahead:
            now.advance_to(ahead)
        np.testing.assert_allclose(later.state.position, now.state.position, atol=1e-9)
        np.testing.assert_allclose(later.state.velocity, now.state.velocity, atol=1e-6)
        for one, other in zip(later.state.bodies.parts(), now.state.bodies.parts(), strict=True):
            np.testing.assert_allclose(np.abs(one), np.abs(other), atol=1e-9)


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("cut", [0.1, 0.24])
def test_a_snapshot_before_and_after(form: str, cut: float, tmp_path: Path) -> None:
    one, other = Simulation(case(BACKENDS[form])), Simulation(case(BACKENDS[form]))
    one.advance_to(cut)
    continue_alike(one, other, 0.28, tmp_path)


GIVEN_TO_THE_NET = ("initial.velocity=[0.3, -0.2, 1.0]", "initial.spin=[0.5, 1.0, 2.0]")
MOTIONS = {
    "free": (),
    "fixed": ("bodies.chaser={mass=80.0, inertia=[1.0, 1.0, 1.0], motion='fixed'}",),
    "prescribed": (f"bodies.chaser={{mass=80.0, inertia=[1.0, 1.0, 1.0], motion='prescribed'{POSES}}}",),
}


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("motion", MOTIONS)
def test_an_ejection_at_the_start_is_the_limit_of_a_later_one(motion: str, tied: bool) -> None:
    """At 0 and at 1e-9 s: what 1e-9 s do to a state is 1e-9 times its rates, which are below 100 a second."""
    short = "time={end=0.3, output_times=[0.001, 0.002]}"
    more = (*([] if tied else [FREE]), *MOTIONS[motion], *GIVEN_TO_THE_NET)
    if motion == "free":
        more = (*more, SHORT[2])
    runs = []
    for at in (0.0, 1e-9):
        sim = Simulation(exunet.load(CASE, [short, SHORT[1], *more, f"initial.frame.eject_at={at}"]))
        sim.advance_to(0.002)
        runs.append(sim)
    now, later = runs
    for name in ("position", "velocity", "first_order"):
        one, other = (getattr(sim.state, name) for sim in runs)
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7)
    for one, other in zip(now.state.bodies.parts(), later.state.bodies.parts(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
    (event,), (after,) = (sim.monitor.provenance()["ejection"] for sim in runs)
    assert (event.pop("time_s"), after.pop("time_s")) == (0.0, 1e-9)
    assert event.keys() == after.keys()
    for name in event.keys() - {"body"}:
        np.testing.assert_allclose(event[name], after[name], rtol=1e-7, atol=1e-7)
    assert event["energy_lost_J"] < -1.0
    assert now.monitor.dissipated == pytest.approx(later.monitor.dissipated, rel=1e-7)


@pytest.mark.parametrize("motion", MOTIONS)
def test_both_codes_throw_alike_at_the_start(motion: str) -> None:
    """Rung 1 of the ladder, with bodies; and the work that the throw has brought, to 1e-12 of it."""
    both = read_both(CASE, [*SHORT[:2], *MOTIONS[motion], *GIVEN_TO_THE_NET])
    assert [check.name for check in topology(both) if not check.holds] == []
    times = np.array([0.0, 1e-3])
    ours, theirs = both.run_exunet(times, booked=True), both.run_reference(times)
    assert ours.dissipated is not None
    np.testing.assert_allclose(ours.dissipated, theirs.dissipated, rtol=1e-9)
    assert ours.dissipated[0] == pytest.approx(theirs.dissipated[0], rel=1e-12)
    assert ours.dissipated[0] < -1.0


@pytest.mark.ci_for("fixed")
@pytest.mark.slow_for("fixed", "prescribed")
@pytest.mark.parametrize("motion", MOTIONS)
def test_the_books_of_an_ejection_at_the_start(motion: str, tmp_path: Path) -> None:
    """Line by line those of one at 1e-9 s: in the result, in its file, in its headlines and its figure."""
    short = "time={end=0.02, output_step=0.01}"
    found = []
    for at in (0.0, 1e-9):
        keys = [short, SHORT[1], FREE, *MOTIONS[motion], *GIVEN_TO_THE_NET, f"initial.frame.eject_at={at}"]
        result = exunet.run(exunet.load(CASE, keys))
        exunet.save(result, tmp_path / f"{at}.h5")
        again = exunet.load_result(tmp_path / f"{at}.h5")
        found.append(
            (result, {body.name: body.value(course_of(again)) for body in books_of_bodies(course_of(again))})
        )
    (now, books), (later, others) = found
    assert books.keys() == others.keys()
    assert books["work_of_ejection"] > 1.0
    for name, value in books.items():
        assert (value is None) == (others[name] is None)
        if value is not None:
            assert value == pytest.approx(others[name], rel=1e-6, abs=1e-6), name
    momentum = np.array([books[f"net_momentum_gained_{axis}"] for axis in "xyz"])
    if motion == "free":
        back = np.array([books[f"body_chaser_momentum_gained_{axis}"] for axis in "xyz"])
        np.testing.assert_allclose(momentum + back, 0.0, atol=1e-10)
        assert np.linalg.norm(momentum) > 1.0
    for courses in (gained_by_parts, given_impulses):
        ours, theirs = courses(now), courses(later)
        assert ours.keys() == theirs.keys()
        for name, course in ours.items():
            np.testing.assert_allclose(course[0][-1], theirs[name][0][-1], rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(course[1][-1], theirs[name][1][-1], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(gained_by_parts(now)["net"].linear[-1], momentum, rtol=1e-12)
    np.testing.assert_allclose(now.dissipated[1:], later.dissipated[1:], rtol=1e-6)
    for result in (now, later):
        total = result.kinetic + result.elastic + result.potential + result.dissipated
        assert np.ptp(total) < 1e-8 * result.kinetic.max()


@pytest.mark.slow
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_what_moves_the_chaser_takes_it(form: str, motion: str) -> None:
    """What a support or a guide gives is the change of the momenta; the ejection puts energy in."""
    keys = f"{{mass=80.0, inertia=[1.0, 1.0, 1.0], motion='{motion}'{POSES * (motion != 'fixed')}}}"
    short = SHORT[:2]
    found = exunet.run(exunet.load(CASE, [*short, LATER, FREE, BACKENDS[form], f"bodies.chaser={keys}"]))
    given = (found.states["chaser/impulse"].values, found.states["chaser/angular_impulse"].values)
    bound = 1e-11 if motion == "fixed" else 1e-8 * np.abs(given[0]).max()  # which is integrated
    assert np.ptp(found.momentum - given[0], axis=0).max() < bound
    assert np.ptp(found.angular_momentum - given[1], axis=0).max() < 10.0 * bound
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.ptp(total) < 1e-8 * found.kinetic.max()
    work, before = found.states["chaser/work"].values[:, 0], found.time < 0.2 - 1e-12
    if motion == "fixed":
        assert not found.kinetic[before].any()
        assert not work.any()
    else:  # which carries the net: what it has given is the net's energy, until it is thrown
        np.testing.assert_allclose(work[before], found.kinetic[before] - found.kinetic[0], atol=1e-8)
        assert np.ptp(work[before]) > 1.0
    assert found.kinetic[~before].min() > found.kinetic[before].max() + 1.0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("initial.frame.eject_at=-0.1", "eject_at:"),
        ("initial.frame.eject_at=0.3", "eject_at:"),
    ],
)
def test_what_is_refused(override: str, words: str) -> None:
    with pytest.raises(CaseError, match=words):
        Simulation(case(override))
