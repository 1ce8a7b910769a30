"""Accuracy of the automatic choice on nearly deployed starts: reached where it is stated."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import BACKENDS, CASES, every_backend, pair_of_masses

import exunet
from exunet.results.measures import bullet_speeds
from exunet.simulation import pilot
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.error_estimate import estimate_error

PLANAR = CASES / "planar_undamped.toml"

SPEED = 2.5  # m/s, of the launch

ACCURACY = 1e-4

TIGHT = 1e-12 * SPEED

SHORT_STRINGS = ("initial.packing=0.95", "net.strings.length=1.4")


def case(*overrides: str) -> exunet.Case:
    return exunet.load(PLANAR, ["solver=", *overrides])


def start(*overrides: str) -> Start:
    return prepare(case(*overrides).scene)


def error(*overrides: str) -> tuple[float, bool]:
    """Error of the bullet speeds at the end of a run by auto, over the launch speed; is it promised?"""
    asked = case(*overrides)
    told = " ".join(prepare(asked.scene).plan.notes)
    tight = case(*overrides, "engine.backend=compiled", f"solver.tolerance={TIGHT}")
    ours, theirs = (bullet_speeds(exunet.run(item))[-1] for item in (asked, tight))
    promised = "with a margin of" in told
    assert promised != ("is reached" in told or "accuracy unknown" in told)
    return float(np.abs(ours - theirs).max()) / SPEED, promised


@pytest.mark.ci_for("0.115-compiled")
@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("end", [0.105, 0.11, 0.115, 0.12])
def test_inside_the_snaps_of_a_nearly_deployed_start(end: float, backend: str) -> None:
    """With the table's tolerance the errors in Exudyn were 9.9e-5, 5.3e-4, 2.1e-3 and 4.7e-4.

    Exudyn's runs keep the accuracy too, but some with less room than the statement requires.
    """
    found, promised = error(*SHORT_STRINGS, f"time.end={end}", BACKENDS[backend])
    assert found <= ACCURACY
    assert promised or backend == "exudyn"


@pytest.mark.slow
def test_the_estimate_is_the_error_inside_a_snap() -> None:
    """Against a run with a tenth of the tolerance, whose error may be as large, it was 7 times too small."""
    for end in (0.105, 0.11, 0.115, 0.12):
        ends = (*SHORT_STRINGS, f"time.end={end}", "time.output_step=", "time.output_times=[]")
        loose = case(*ends, "solver.tolerance=7.9e-10")
        result = exunet.run(loose)
        tight = exunet.run(case(*ends, "engine.backend=compiled", f"solver.tolerance={TIGHT}"))
        true = float(np.abs(bullet_speeds(result)[-1] - bullet_speeds(tight)[-1]).max()) / SPEED
        assert true / 3.0 < estimate_error(loose.scene, result).at_end < 3.0 * true


def test_what_cannot_be_measured_is_not_promised() -> None:
    for change, why in (
        ("solver.method=ODE23", "not measured for ODE23"),
        ("time.end=100.0", "too long"),
        ("effects.thrust={bullets=[0],time=[0.0,1.0],force=[[0,0,1],[0,0,1]]}", "change at events"),
    ):
        plan = start("initial.packing=0.9", change).plan
        assert any("accuracy unknown" in note and why in note for note in plan.notes), plan.notes
        assert plan.expected_error is None


def test_nearly_deployed_nets_without_bullets_are_promised_nothing() -> None:
    """The paper's net at packing 0.95 with masses at nodes in place of bullets: errors of 8e-4 at 1e-4."""
    for packing, promised in ((1.0, False), (0.79, True)):
        plan = prepare(pair_of_masses(initial={"packing": packing})).plan
        assert (plan.expected_error is not None) == promised
        words = " ".join(plan.notes)
        assert ("accuracy unknown" in words and "without bullets" in words) != promised
        assert ("expected speed error of the bullets" in words) == promised


def test_the_ladder_and_what_follows_from_it() -> None:
    """Errors of round numbers: the largest tolerance within the accuracy, and until when it is kept."""
    steps = len(pilot.TOLERANCES)
    error_at = np.array([[0.0, 10.0**-k, 10.0 ** (1 - k)] for k in range(1, steps + 1)])
    found = pilot.Pilot(np.array([0.0, 1.0, 2.0]), error_at, error_at[:, -1])
    assert found.chosen(0.1, 1.0) == 1
    assert found.chosen(0.1, 100.0) == 3
    assert found.chosen(1e-9, 1.0) is None
    assert found.until(1e-5, 1.0) == 1.0
    assert found.until(1e-9, 1.0) == 0.0


@pytest.mark.slow
def test_single_nodes_that_are_far_off_are_told() -> None:
    """Of the paper's net in its first snaps (packing 0.97, to 0.084 s) bullets are right to 2e-7 at the end,
    and one node is off by 0.18 of the launch speed in Exudyn, by 0.005 in the compiled loop.
    """
    words = "single nodes exceed the accuracy"
    short = ("net.strings.length=1.4", "solver.accuracy=1e-4")
    notes = " ".join(start("initial.packing=0.97", "time.end=0.084", *short).plan.notes)
    assert words in notes
    assert "error of the bullets" in notes
    assert words not in " ".join(start("initial.packing=0.9", "time.end=0.05", *short).plan.notes)


@pytest.mark.ci
@pytest.mark.slow
def test_the_pilot_stops_at_the_times_of_poses_as_the_run_does() -> None:
    """A body led through poses pulls a bullet by a tether. The pilot's error with its loosest tolerance is
    that of the run with it: the same steps, to the last bit; without these stops it was another.
    """
    places = [[3.0, 3.0, 0.0], [3.2, 3.1, 0.1], [3.1, 3.4, 0.0], [3.3, 3.3, 0.2]]
    poses = f"motion='prescribed', pose_times=[0.0, 0.0233, 0.0617, 0.08], pose_positions={places}"
    poses += f", pose_attitudes={[[1.0, 0.0, 0.0, 0.0]] * 4}"
    tether = "length=1.0, divisions=2, diameter=0.002, density=1390.0, youngs_modulus=70e9"
    given = (
        *("initial.packing=0.95", "time.end=0.08", "time.output_step=0.02", "engine.backend=compiled"),
        f"bodies.hand={{mass=1.0, inertia=[0.1, 0.1, 0.1], {poses}}}",
        f"tethers.lead={{{tether}, start={{bullet=2}}, end={{body='hand'}}}}",
    )
    begun = start(*given)
    found = pilot.try_tolerances(begun.system, begun.state, begun.plan, begun.scene.time.stored_times, SPEED)
    assert found is not None
    ends = [
        simulate(start(*given, f"solver.tolerance={tolerance * SPEED!r}"))
        for tolerance in (pilot.TOLERANCES[0], pilot.TIGHT)
    ]
    bullets = begun.net.bullet_nodes
    off = np.linalg.norm(ends[0].velocity[-1, bullets] - ends[1].velocity[-1, bullets], axis=-1).max() / SPEED
    assert found.error[0, -1] == pytest.approx(off, rel=1e-6)
    off = np.linalg.norm(ends[0].velocity[-1] - ends[1].velocity[-1], axis=-1).max() / SPEED
    assert found.nodes[0] == pytest.approx(off, rel=1e-6)
