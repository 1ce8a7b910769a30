"""A free rigid body with three different moments of inertia: all forms, result file, snapshot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.methods.method import Method, Plan
from exunet.simulation.preparation import prepare_case
from exunet.simulation.run import run_into, simulate
from exunet.verification.answers.turning import FreeRotation

CASE = Path(__file__).parents[1] / "cases" / "verification" / "snap.toml"
INERTIA = np.array([2.0, 3.0, 4.0])
SPIN = np.array([0.01, 2.0, 0.02])  # nearly about the intermediate axis: it turns over
TURNS = 10
END = float(TURNS * 2.0 * np.pi / SPIN[1])
ATTITUDE = np.array([0.9, 0.1, 0.3, 0.2]) / np.linalg.norm([0.9, 0.1, 0.3, 0.2])
BODY = (
    "bodies.target={mass=7.0, inertia=[2.0, 3.0, 4.0], position=[3, 0, 0], velocity=[0, 0.1, 0], "
    "attitude=[0.9, 0.1, 0.3, 0.2], angular_velocity=[0.01, 2.0, 0.02]}"
)
BACKENDS = {
    "compiled": "engine.backend=compiled",
    "exudyn": "engine.backend=exudyn",
}


def with_body(form, method, *more):
    step = "solver.tolerance=1e-10" if method in ("DOPRI5", "ODE23") else "solver.step=1e-3"
    times = (f"time.end={END!r}", "time.output_step=1.0", "time.output_times=")
    return exunet.load(CASE, [BODY, BACKENDS[form], f"solver.method={method}", step, *times, *more])


@pytest.fixture(scope="module")
def known():
    return FreeRotation(np.diag(INERTIA), SPIN, rotation_matrix(ATTITUDE))


# Largest errors over ten turns, which include a turn over that multiplies errors by about 1e2. Measured with
# 3142 steps a turn: 2e-11 (RK44, and Verlet in the compiled loop, which rotates bodies by a step of order 4
# between the half steps of the torque), 5e-11 to 3e-10 (DOPRI5 at 1e-10), 3e-7 (implicit, order 2).
ALLOWED = {"DOPRI5": 1e-8, "RK44": 1e-9, "VelocityVerlet": 1e-9, "GeneralizedAlpha": 1e-5}
PAIRS = [
    ("compiled", "DOPRI5"), ("compiled", "VelocityVerlet"), ("exudyn", "DOPRI5"),
    ("exudyn", "RK44"), pytest.param("compiled", "RK44", marks=pytest.mark.slow),
    pytest.param("exudyn", "GeneralizedAlpha", marks=pytest.mark.slow),
]  # fmt: skip


@pytest.mark.ci_for("exudyn-RK44")
@pytest.mark.slow_for("compiled", "RK44", "GeneralizedAlpha")
@pytest.mark.parametrize(("form", "method"), PAIRS)
def test_a_free_body_turns_as_jacobis_functions_say(form, method, known):
    result = exunet.run(with_body(form, method))
    body, allowed = result.bodies["target"], ALLOWED[method]
    frame = rotation_matrix(body.attitude)
    assert np.abs(frame - known.attitudes(result.time)).max() < 2.0 * allowed  # twice those of quaternions
    assert np.abs(body.angular_velocity - known.rates(result.time)).max() < 10.0 * allowed
    energy = 0.5 * body.angular_velocity**2 @ INERTIA
    turning = np.einsum("kab,kb->ka", frame, INERTIA * body.angular_velocity)
    assert np.ptp(energy) < allowed * energy[0]
    assert np.abs(turning - turning[0]).max() < 10.0 * allowed * np.linalg.norm(turning[0])
    way = [3.0, 0.1 * END, 0.0]
    np.testing.assert_allclose(body.position[-1], way, atol=1e-10)  # eps x 31 416 added steps x 6 m


def test_the_engines_verlet_is_of_first_order_for_turning_bodies_and_says_so():
    result = exunet.run(with_body("exudyn", "VelocityVerlet", "time.end=1.0"))
    assert any("first order" in note and "target" in note for note in result.provenance["notes"])


@pytest.mark.parametrize("form", BACKENDS)
def test_a_body_changes_nothing_of_the_net_that_it_does_not_touch(form):
    equal = ("solver.method=RK44", "solver.step=1e-4")  # which RK44 would choose by the bodies too
    alone = exunet.run(exunet.load(CASE, [BACKENDS[form], *equal]))
    beside = exunet.run(exunet.load(CASE, [BACKENDS[form], *equal, BODY]))
    np.testing.assert_array_equal(beside.position, alone.position)


@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("method", ["DOPRI5", "RK44"])
def test_a_snapshot_holds_the_body(form, method, tmp_path):
    case = with_body(form, method)
    whole = exunet.Simulation(case)
    for time in (0.3, 0.6, 0.9):
        whole.advance_to(time)
    half = exunet.Simulation(case)
    half.advance_to(0.3)
    half.snapshot().save(tmp_path / "half")
    rest = exunet.Simulation(case)
    rest.restore(exunet.Snapshot.load(tmp_path / "half"))
    for time in (0.6, 0.9):
        rest.advance_to(time)
    for ours, theirs in zip(rest.state.bodies.parts(), whole.state.bodies.parts(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert rest.energy == whole.energy


def test_the_result_file_holds_the_body(tmp_path):
    case = with_body("compiled", "DOPRI5", "time.end=2.0")
    made = run_into(tmp_path, case)
    read = exunet.load_result(tmp_path)
    body, again = made.bodies["target"], read.bodies["target"]
    for name in ("position", "velocity", "attitude", "angular_velocity"):
        np.testing.assert_array_equal(getattr(again, name), getattr(body, name))
    assert again.mass == 7.0
    np.testing.assert_array_equal(again.inertia, np.diag(INERTIA))
    moved = 7.0 * np.array([0.0, 0.1, 0.0])
    alone = exunet.run(exunet.load(CASE, ["engine.backend=compiled"])).momentum[0]
    np.testing.assert_allclose(read.momentum[0] - alone, moved, rtol=1e-14)
    spin = rotation_matrix(ATTITUDE) @ (INERTIA * SPIN)
    about_origin = np.cross([3.0, 0.0, 0.0], moved)
    rest = exunet.run(exunet.load(CASE, ["engine.backend=compiled"])).angular_momentum[0]
    np.testing.assert_allclose(read.angular_momentum[0] - rest, spin + about_origin, rtol=1e-13)


def test_the_guards_look_at_bodies():
    """Steps of five radians, which a script has planned: the energy of the body has its balance."""
    fast = "bodies.target.angular_velocity=[2e3, 4e3, 2e3]"
    case = with_body("compiled", "DOPRI5", fast, "solver.retry=0")
    start = replace(prepare_case(case), plan=Plan(Method.RK44, step=1e-3))
    with pytest.raises(exunet.RunStopped, match="the energy of the rigid bodies changed by"):
        simulate(start)


def test_a_body_does_not_blunt_the_guards_of_the_net():
    """The balances are apart: a step too long stops the run where it would without the heavy body."""
    planar = CASE.parents[1] / "planar_undamped.toml"
    rough = [
        "engine.backend=compiled",
        "solver.method=RK44",
        "solver.step=4e-4",
        "solver.force=true",
        "solver.retry=0",
    ]
    heavy = "bodies.target={mass=500.0, inertia=[80.0, 100.0, 120.0], angular_velocity=[0.0, 1.0, 0.1]}"
    words = []
    for more in ([], [heavy]):
        with pytest.raises(exunet.RunStopped) as stopped:
            exunet.run(exunet.load(planar, [*rough, *more]))
        words.append(str(stopped.value))
    assert words[0] == words[1]


def test_a_body_of_the_name_of_a_point_mass_is_refused():
    case = CASE.parents[1] / "effects" / "launch_force.toml"
    body = "bodies.chaser={mass=1.0, inertia=[1.0, 1.0, 1.0]}"
    with pytest.raises(exunet.CaseError, match=r"bodies\.chaser.*point mass of this name"):
        exunet.run(exunet.load(case, [body]))
