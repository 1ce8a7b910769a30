"""Nets coupled to Exudyn systems: methods, runs, steps of the user's functions, faults; native items."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import (
    METHODS,
    MOMENTUM,
    POSITION,
    VELOCITY,
    ExudynBody,
    Scene,
    assert_same_bits,
    momenta,
    settings,
    spring,
)
from exudyn.itemInterface import (
    LoadForceVector,
    MarkerBodyPosition,
    MarkerBodyRigid,
    MarkerSuperElementRigid,
    NodePoint,
    ObjectGenericODE2,
    ObjectGround,
)
from exudyn.rigidBodyUtilities import InertiaCuboid
from scenes import CASES

import exunet
from exunet import InputError, NetSystem
from exunet.coupling.exudyn_coupling import Handover
from exunet.coupling.stability import STABLE, longest_step

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

END, HALF = 0.24, 0.12  # s


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


@pytest.mark.ci_for("RK44")
@pytest.mark.parametrize("method", METHODS)
def test_the_motion_is_that_of_one_system(scene: Scene, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of second order; momentum is kept, with what is in transit; forces are for the length of each step."""
    lengths, force_for = [], Handover.force_for

    def noted(self: Handover, mean: np.ndarray, step: float, *, recoils: bool) -> np.ndarray:
        lengths.append(step)
        return force_for(self, mean, step, recoils=recoils)

    monkeypatch.setattr(Handover, "force_for", noted)
    known, errors = scene.in_one(END).state.bodies.position[1], []
    for steps in (60, 120):
        host, net, coupling = scene.coupled()
        host.solve(method, steps, END)
        report = coupling.report()
        errors.append(float(np.linalg.norm(host.at_centre(POSITION) - known)))
        assert scene.lost(net, host, coupling) < 1e-12 * MOMENTUM
        assert (report.steps, report.repeated) == (steps, 0)
        assert lengths[-steps:] == pytest.approx([END / steps] * steps, rel=1e-9)
    # The engine's velocity Verlet is of first order for bodies that turn.
    order = 1 if method == "VelocityVerlet" else 2
    assert errors[0] / errors[1] > 0.8 * 2.0**order, errors
    assert errors[1] < (1e-4 if method == "VelocityVerlet" else 2e-5)  # of a way of 0.15 m


@pytest.mark.parametrize("method", METHODS)
def test_the_residual_is_the_drift_of_the_energy(scene: Scene, method: str) -> None:
    """Nearly 1; of velocity Verlet less what it adds by itself, beyond the work of the loads on the body.

    The engine's velocity Verlet turns bodies at first order, with or without a net, so that what it adds
    falls with the step; the residual falls with its square. Of a drift of both the residual was 1/1.6 at
    30 steps, 1/8.3 at 480 and 1/30 at 1920.
    """
    start, added, alone = exunet.Simulation(scene.whole), [], []
    body, own = start.start.system.bodies[1], start.state.bodies.of_body(1)
    speed, spin = own.velocity[0], own.angular_velocity[0]
    kinetic = 0.5 * (body.mass * speed @ speed + (spin * body.inertia) @ spin)
    for steps in (30, 120, 480):
        host, net, coupling = scene.coupled()
        host.solve(method, steps, END)
        balance = coupling.report().ports["second"]
        drift = host.energy + momenta(net.simulation)[2] - sum(momenta(start)[2:])
        assert abs(drift) > 1e-7  # J, far above round-off of the 7 J that there are
        if method == "VelocityVerlet":
            added.append(host.energy - kinetic - (balance.work + balance.residual))
            drift -= added[-1]
            host = ExudynBody.second(scene)
            host.mbs.Assemble()
            host.solve(method, steps, END)
            alone.append(host.energy - kinetic)
        assert drift / balance.residual == pytest.approx(1.0, abs=0.2)
    if method == "VelocityVerlet":  # in steps 4 times as short
        np.testing.assert_allclose(np.divide(added[:-1], added[1:]), 4.0, rtol=0.1)
        np.testing.assert_allclose(np.divide(alone[:-1], alone[1:]), 4.0, rtol=0.1)


def test_rejected_steps_are_as_if_they_had_not_been(scene: Scene) -> None:
    """An adaptive host on a stiff spring, and one that takes those steps only, one solver for each."""
    host, net, seen = ExudynBody.second(scene).on_spring(2e4), NetSystem(scene.net), []
    host.mbs.SetPreStepUserFunction(lambda mbs, t: seen.append(t) is None)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    adaptive = {"relativeTolerance": 0.0, "absoluteTolerance": 1e-7, "initialStepSize": 0.024}
    host.solve("DOPRI5", 10, END, **adaptive)
    report = coupling.report()
    ends = [time for time, after in pairwise([*seen, np.inf]) if after > time]
    assert report.repeated == len(seen) - len(ends) > 0
    given = net.simulation.view.first_order[:3]
    np.testing.assert_allclose(report.ports["second"].impulse, -given, atol=1e-13)
    other, own = ExudynBody.second(scene).on_spring(2e4), NetSystem(scene.net)
    again = exunet.couple(other.mbs, own, {"second": other.marker})
    for begin, end in pairwise([0.0, *ends]):
        tolerances = {"relativeTolerance": 0.0, "absoluteTolerance": 1e9}
        other.solve("DOPRI5", 1, end, begin, on=begin > 0.0, **tolerances)
    assert (again.report().repeated, again.report().steps) == (0, report.steps)
    np.testing.assert_allclose(other.at_centre(POSITION), host.at_centre(POSITION), atol=1e-12)
    both = (item.report().ports["second"].impulse for item in (coupling, again))
    np.testing.assert_allclose(*both, atol=4e-12)  # of 4 N s


@pytest.mark.parametrize("methods", [*pairwise(METHODS[::-1]), *((method, method) for method in METHODS)])
def test_a_run_continues_with_another_method(scene: Scene, methods: tuple[str, str]) -> None:
    """What one has left in transit the other gives, so that momentum is kept."""
    host, net, coupling = scene.coupled()
    host.solve(methods[0], 30, HALF)
    host.solve(methods[1], 30, END, HALF, on=True)
    assert scene.lost(net, host, coupling) < 1e-12 * MOMENTUM


@pytest.mark.ci_for("1")
@pytest.mark.parametrize("iterations", [1, 20])
def test_an_explicit_host_of_a_coupler(scene: Scene, iterations: int) -> None:
    """Of second order, with momentum at any step; what is repeated repeats bitwise."""
    known, errors = scene.in_one(END).state.bodies.position[1], []
    for step in (8e-3, 4e-3):
        own, net = ExudynBody.second(scene), NetSystem(scene.net)
        host = exunet.ExudynHost(own.mbs, {"second": own.marker}, step=1e-3)
        coupler = exunet.Coupler(net, host, step=step, iterations=iterations)
        coupler.advance_to(END)
        assert scene.lost(net, own) < 1e-12 * MOMENTUM
        errors.append(np.linalg.norm(own.at_centre(POSITION) - known))
    assert errors[0] / errors[1] > 0.8 * 4.0, errors
    assert errors[1] < 2e-5  # m, of a way of 0.15 m
    assert (coupler.ledger.repeated > 0) == (iterations > 1)
    loads, here = net.step(END + 4e-3, {"second": net.frame("second").after(4e-3)}), host.snapshot()
    ends: list[Any] = []
    steps: list[float] = []
    own.mbs.SetPreStepUserFunction(lambda mbs, t: steps.append(t) is None)
    for _ in range(2):
        host.restore(here)
        assert host.time == END
        host.step(END + 4e-3, loads)
        ends.append(host.frames()["second"])
    assert ends[0] == ends[1]
    assert len(steps) == 2 * 4  # of 1e-3 s


def test_hosts_of_a_coupler_in_exudyn(scene: Scene) -> None:
    """Ports at markers of one body; methods that do not restart; a run that a user's function ends."""
    own, other = ExudynBody.second(scene), {"referencePosition": [9.0, 0.0, 0.0]}
    number = own.mbs.CreateRigidBody(**other, inertia=InertiaCuboid(1.0, [1.0] * 3))
    ports = {"a": own.marker, "b": own.mbs.AddMarker(MarkerBodyRigid(bodyNumber=number)), "c": own.centre}
    assert sorted(exunet.ExudynHost(own.mbs, ports, step=1e-3).shared()) == [("a", "c"), ("b",)]
    own, net = ExudynBody.second(scene), NetSystem(scene.net)
    for arguments, words in (
        ({"method": "VelocityVerlet"}, "method"),
        ({"step": 0.0}, "step"),
        ({"ports": {"second": 99}}, "port second: .* 99"),
        ({"ports": [0]}, "requires"),
        ({"mbs": None}, "mbs"),
    ):
        usual = {"mbs": own.mbs, "ports": {"second": own.marker}, "step": 1e-3}
        with pytest.raises(InputError, match=f"ExudynHost: {words}"):
            exunet.ExudynHost(**(usual | arguments))  # type: ignore[arg-type]
    assert own.mbs.systemData.NumberOfLoads() == 0
    own.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.0225)
    host = exunet.ExudynHost(own.mbs, {"second": own.marker}, step=1e-3)
    with pytest.raises(InputError, match=r"to t = 0\.025 s ended at 0\.023 s"):
        exunet.Coupler(net, host, step=5e-3).advance_to(0.1)
    assert net.time == pytest.approx(0.02)


def test_a_flexible_body_at_the_mean_frame_of_its_nodes(tmp_path: Path) -> None:
    """Four masses on springs in an ObjectGenericODE2: what the net gives is what they get."""
    net, _ = spring(tmp_path)
    mass = 0.05 + net.carried_mass("b")
    offsets = np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    offsets -= offsets.mean(axis=0)
    mbs = exu.SystemContainer().AddSystem()
    start = {"initialVelocities": [0.01, 0.0, 0.0]}
    nodes = [
        mbs.AddNode(NodePoint(referenceCoordinates=[1.01 + x, y, z], **start)) for x, y, z in offsets.tolist()
    ]
    stiffness = np.zeros((12, 12))
    for i, j in combinations(range(4), 2):
        way = (offsets[j] - offsets[i]) / np.linalg.norm(offsets[j] - offsets[i])
        both = np.zeros((12, 12))
        both[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = both[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] = 1.0
        both[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = both[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = -1.0
        stiffness += 1e3 * both * np.tile(np.outer(way, way), (4, 4))
    body = ObjectGenericODE2(nodeNumbers=nodes, massMatrix=np.eye(12) * mass / 4.0, stiffnessMatrix=stiffness)
    weights = {"meshNodeNumbers": [0, 1, 2, 3], "weightingFactors": [0.25] * 4}
    marker = mbs.AddMarker(MarkerSuperElementRigid(bodyNumber=mbs.AddObject(body), **weights))
    coupling = exunet.couple(mbs, net, {"b": marker})
    mbs.SolveDynamic(settings(0.0, 0.1, 100), solverType=exu.DynamicSolverType.GeneralizedAlpha)
    speeds = [np.array(mbs.GetNodeOutput(node, VELOCITY)) for node in nodes]
    given = coupling.report().ports["b"].impulse
    assert np.abs(given).max() > mass * 0.01  # N s, as much as it had
    gained = mass * (np.mean(speeds, axis=0) - [0.01, 0.0, 0.0])
    np.testing.assert_allclose(gained + coupling.in_transit["b"], given, atol=1e-12 * np.abs(given).max())


# Functions and items of the user


def test_the_users_own_pre_step_function_is_called(scene: Scene) -> None:
    """Also after `detach`; the ledger is readable in it, where the host's time is the end of the next "
    "step."""
    host, net, seen = ExudynBody.second(scene), NetSystem(scene.net), []
    reported: list[int] = []

    def mine(mbs: Any, t: float) -> bool:
        seen.append(t)
        if net.time < END - 1e-3:
            report = coupling.report()
            reported.append(report.steps if not report.note else -1)
        return True

    host.mbs.SetPreStepUserFunction(mine)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 40, END)
    assert len(seen) == 40
    assert reported == list(range(40))
    report = str(coupling.report())
    chained = host.mbs.GetPreStepUserFunction()["function"]
    host.mbs.SetPreStepUserFunction(lambda mbs, t: seen.append(-t) is None and chained(mbs, t))
    coupling.detach()
    coupling.detach()
    free = host.at_centre(VELOCITY)
    host.solve("RK44", 40, END)  # from its start again, without the net
    assert len(seen) == 120  # by `mine` in both runs, by the later one in the second
    assert str(coupling.report()) == report  # what the host does alone is not in it
    assert net.time == pytest.approx(END)
    assert np.linalg.norm(host.at_centre(VELOCITY) - free) > 0.01  # m/s that the net had changed
    np.testing.assert_allclose(host.at_centre(VELOCITY), [0.5, 0.0, 0.3], atol=1e-9)


def test_loads_and_markers_may_be_deleted_except_the_couplings_own(scene: Scene) -> None:
    """The others get other numbers; the coupling follows its own."""
    host, net = ExudynBody.second(scene), NetSystem(scene.net)
    spare = host.mbs.AddMarker(MarkerBodyRigid(bodyNumber=host.object, localPosition=[0.05, 0.0, 0.0]))
    point = list(host.mbs.GetMarker(host.marker)["localPosition"])
    port = host.mbs.AddMarker(MarkerBodyRigid(bodyNumber=host.object, localPosition=point))
    first = host.mbs.AddLoad(LoadForceVector(markerNumber=host.centre, loadVector=[0.0] * 3))
    coupling = exunet.couple(host.mbs, net, {"second": port})
    host.mbs.AddMarker(MarkerBodyRigid(bodyNumber=host.object, localPosition=[0.0, 0.05, 0.0]))
    host.mbs.AddLoad(LoadForceVector(markerNumber=host.centre, loadVector=[0.0] * 3))
    host.mbs.DeleteLoad(first, False)
    host.mbs.DeleteMarker(spare)
    host.mbs.Assemble()
    host.solve("RK44", 30, HALF)
    assert scene.lost(net, host) < 1e-12 * MOMENTUM
    host.mbs.DeleteLoad(0, False)
    host.mbs.Assemble()
    with pytest.raises(exu.ModelError, match="port second: a load"):
        host.solve("RK44", 30, END, HALF, on=True)
    coupling.detach()


@pytest.mark.parametrize("method", ["RK44", "TrapezoidalIndex2"])
def test_a_pre_step_function_ends_the_run(scene: Scene, method: str) -> None:
    """The engine takes the step in which it does so; the net too, so that momentum is kept."""
    host, net = ExudynBody.second(scene), NetSystem(scene.net)
    host.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.095)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve(method, 24, END)
    assert host.mbs.systemData.GetTime() == pytest.approx(0.1)
    assert net.time == pytest.approx(0.1)
    report = coupling.report()
    assert (report.steps, report.note) == (10, "")
    assert scene.lost(net, host, coupling) < 1e-12 * MOMENTUM


def test_a_function_that_ends_the_run_without_the_coupling_s(scene: Scene) -> None:
    """The host is a step ahead of the net; the ledger notes it."""
    host, net, coupling = scene.coupled()
    ours = host.mbs.GetPreStepUserFunction()["function"]
    host.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.095 and ours(mbs, t))
    with pytest.raises(exu.ModelError, match=r"step from 0\.08 s to 0\.09 s"):
        host.solve("RK44", 24, END)
    assert net.time == pytest.approx(0.09)
    report = coupling.report()
    assert report.steps == 8
    words = r"t = 0\.09 s is not in the balance: the host has advanced to t = 0\.095 s"
    assert words.replace("\\", "") in report.note
    with pytest.raises(InputError, match=words):
        coupling.snapshot()
    coupling.detach()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ran", [False, True])
def test_a_function_that_does_not_call_the_coupling_s(scene: Scene, method: str, ran: bool) -> None:
    """Set before the first run, or between two: the last step's force acted on through all of the next."""
    host, _, coupling = scene.coupled()
    if ran:
        host.solve(method, 30, HALF)
    host.mbs.SetPreStepUserFunction(lambda mbs, t: True)
    begin = HALF if ran else 0.0
    with pytest.raises(exu.ModelError, match=rf"port second: .* s to {begin:g} s"):
        host.solve(method, 30, begin + HALF, begin, on=ran)
    coupling.detach()
    free = host.at_centre(VELOCITY) if ran else np.array([0.5, 0.0, 0.3])
    host.solve(method, 30, begin + HALF, begin, on=ran)
    np.testing.assert_allclose(host.at_centre(VELOCITY), free, atol=0.1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("late", [False, True])
def test_detached_in_a_run_what_the_host_continues_to_apply_counts(
    scene: Scene, method: str, late: bool
) -> None:
    """Before the coupling's part of a pre-step function, or after it, where the net has taken the step."""
    host, net = ExudynBody.second(scene), NetSystem(scene.net)

    def leave(mbs: Any, t: float) -> bool:
        if abs(t - 0.08) < 1e-6:
            coupling.detach()
        return True

    if not late:
        host.mbs.SetPreStepUserFunction(leave)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    if late:
        chained = host.mbs.GetPreStepUserFunction()["function"]
        host.mbs.SetPreStepUserFunction(lambda mbs, t: chained(mbs, t) and leave(mbs, t))
    host.solve(method, 60, END)
    assert net.time == pytest.approx(0.08 if late else 0.076)
    # generalised-alpha continues to apply less and less: by 0.73 a step, 40 of them
    off = 1e-6 if method == "GeneralizedAlpha" else 1e-12
    assert scene.lost(net, host, coupling) < off * MOMENTUM
    assert ("detached" in coupling.report().note) == late


# Runs


def not_stored(host: ExudynBody, first: str) -> None:
    """By the other method, which the system does not know."""
    other = exu.DynamicSolverType.TrapezoidalIndex2 if first == "RK44" else exu.DynamicSolverType.RK44
    host.mbs.SolveDynamic(settings(HALF, END, 24), solverType=other, storeSolver=False)


def own_solver(host: ExudynBody, _: str) -> None:
    exu.MainSolverImplicitSecondOrder().SolveSystem(host.mbs, settings(HALF, END, 24))


def solver_again(host: ExudynBody, first: str) -> None:
    """The stored one, with other settings than those that are stored."""
    other = settings(HALF, END, 24)
    if first == "RK44":
        other.timeIntegration.solverType = exu.DynamicSolverType.VelocityVerlet
    host.mbs.sys["dynamicSolver"].SolveSystem(host.mbs, other)


@pytest.mark.ci_for("RK44-not_stored")
@pytest.mark.parametrize("solve", [not_stored, own_solver, solver_again])
@pytest.mark.parametrize("first", ["RK44", "TrapezoidalIndex2"])
def test_a_second_run_of_an_unknown_method_is_refused(
    scene: Scene, first: str, solve: Callable[[ExudynBody, str], None]
) -> None:
    """It was taken for one by the method of the first, and lost 0.03 of 1.2 N s."""
    host, net, coupling = scene.coupled()
    host.solve(first, 24, HALF)
    state = host.mbs.systemData.GetSystemState()
    host.mbs.systemData.SetSystemState(state, exu.ConfigurationType.Initial)
    with pytest.raises(exu.ModelError, match="the host's method is not known"):
        solve(host, first)
    assert net.time == pytest.approx(HALF)
    host.solve("RK44", 24, END, HALF, on=True)
    assert scene.lost(net, host, coupling) < 1e-12 * MOMENTUM


def test_a_run_before_the_coupling_or_before_a_restore_does_not_give_the_method(scene: Scene) -> None:
    """One step, to the time at which the run before has ended."""
    host, net = ExudynBody.second(scene), NetSystem(scene.net)
    host.mbs.Assemble()
    host.solve("RK44", 1, 0.01)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    kind = exu.DynamicSolverType.TrapezoidalIndex2
    with pytest.raises(exu.ModelError, match="the host's method is not known"):
        host.mbs.SolveDynamic(settings(0.0, 0.01, 1), solverType=kind, storeSolver=False)
    start = coupling.snapshot()
    host.solve("RK44", 1, 0.01)
    coupling.restore(start)
    with pytest.raises(exu.ModelError, match="the host's method is not known"):
        host.mbs.SolveDynamic(settings(0.0, 0.01, 1), solverType=kind, storeSolver=False)


@pytest.mark.parametrize("reported", [False, True])
def test_a_run_that_begins_from_the_first_start(scene: Scene, reported: bool) -> None:
    """Without updateInitialValues in the run before; with a report in between, the net was led back."""
    host, net, coupling = scene.coupled()
    host.solve("RK44", 12, HALF)
    if reported:
        assert coupling.report().steps == 12
    here = net.snapshot().as_bytes()
    with pytest.raises(exu.ModelError, match="updateInitialValues"):
        host.solve("RK44", 12, END, HALF)
    assert net.snapshot().as_bytes() == here
    assert coupling.report().steps == (12 if reported else 11)  # Exudyn forgets where the last has ended
    host, net, coupling = scene.coupled()
    for begin, end in ((0.0, HALF), (HALF, END)):
        kind = exu.DynamicSolverType.RK44
        host.mbs.SolveDynamic(settings(begin, end, 12), solverType=kind, updateInitialValues=True)
    assert (coupling.report().steps, net.time) == (24, pytest.approx(END))


@pytest.mark.ci
def test_runs_at_other_times_and_nets_that_are_coupled(scene: Scene) -> None:
    host, net, coupling = scene.coupled()
    with pytest.raises(InputError, match="in a coupling already"):
        exunet.couple(host.mbs, net, {"second": host.marker})
    with pytest.raises(exu.ModelError, match="starts at t = 5 s, the net is at 0 s"):
        host.solve("RK44", 40, 5.24, 5.0)
    host.solve("RK44", 40, END)
    with pytest.raises(exu.ModelError, match=r"the net is at 0\.24 s"):
        host.solve("RK44", 40, END)  # from its start, where the net is not
    coupling.detach()
    net.reset()
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 20, HALF)
    host.mbs.Reset()
    report = coupling.report()
    assert report.steps == 19
    assert "t = 0.12 s is not in the balance" in report.note
    coupling.detach()


def spoil(host: ExudynBody, fault: str) -> None:
    """What a user's function may do to a system between two steps."""
    data = host.mbs.systemData
    if fault == "body":
        host.mbs.DeleteObject(host.object)
    elif fault == "marker":
        host.mbs.DeleteMarker(host.marker)
    elif fault == "NaN":
        speeds = data.GetODE2Coordinates_t()
        speeds[0] = np.nan
        data.SetODE2Coordinates_t(speeds)
    else:
        places = data.GetODE2Coordinates()
        places[0] += float(fault)
        data.SetODE2Coordinates(places)


FAULTS = {
    "NaN": "port second: marker 0 contains NaN",
    "0.5": r"at port second jumps: in the step from 0\.096 s to 0\.1 s",
    "-0.006": "at port second jumps",  # m, of 2 mm a step: back, and to the side of small jumps
    "0.002": "at port second jumps",
    "body": "port second: the body of its marker 0 was deleted",
    "marker": "port second: its marker was deleted",
}


@pytest.mark.parametrize("method", ["RK44", "GeneralizedAlpha"])
@pytest.mark.parametrize("fault", FAULTS)
def test_after_a_fault_net_and_ledger_are_those_of_the_last_good_step(
    scene: Scene, method: str, fault: str
) -> None:
    host, net = ExudynBody.second(scene), NetSystem(scene.net)

    def function(mbs: Any, t: float) -> bool:
        if t > 0.102:
            spoil(host, fault)
        return True

    host.mbs.SetPreStepUserFunction(function)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    with pytest.raises(exu.ModelError, match=FAULTS[fault]) as raised:
        host.solve(method, 60, END)
    assert isinstance(raised.value.__cause__, InputError)
    good, other = ExudynBody.second(scene), NetSystem(scene.net)
    good.mbs.SetPreStepUserFunction(lambda _, t: t < 0.098)  # False ends the run after the step
    exunet.couple(good.mbs, other, {"second": good.marker})
    good.solve(method, 60, END)
    report = coupling.report()
    assert report.steps == 24  # the one before is open: where it has led to is not known
    assert "t = 0.1 s is not in the balance" in report.note
    assert np.isfinite(report.as_array()).all()
    assert np.isfinite(coupling.in_transit["second"]).all()
    assert net.time == other.time == pytest.approx(0.1)
    assert_same_bits(net, other)
    coupling.detach()


@pytest.mark.parametrize("reports", [False, True])
def test_a_net_that_a_guard_stopped(tmp_path: Path, reports: bool) -> None:
    """At 25 m/s the second body stretches the cable beyond its law; the guards check many steps at once.

    reports : in each step, so that the guards check the net in a report
    """
    host, net, coupling = Scene(tmp_path, ("velocity = [0.5, 0.0", "velocity = [25.0, 0.0")).coupled()
    if reports:
        own = host.mbs.GetPreStepUserFunction()["function"]
        host.mbs.SetPreStepUserFunction(lambda mbs, t: bool(coupling.report()) and bool(own(mbs, t)))
    with pytest.raises(exu.ModelError) as raised:
        host.solve("RK44", 600, END)
    assert isinstance(raised.value.__cause__, exunet.RunStopped)
    ledger, impulse = coupling.report(), host.mass * (host.at_centre(VELOCITY) - [25.0, 0.0, 0.3])
    assert net.time < ledger.steps * END / 600 - 1e-9
    assert f"last good state, t = {net.time:.6g} s: diverged" in ledger.note
    np.testing.assert_allclose(
        ledger.ports["second"].impulse, impulse, atol=1e-12 * 75.0
    )  # of the body [N s]


# Bounds of the step, in runs


def mass_on_springs(mass: float) -> ExudynBody:
    """The body of `spring` in Exudyn."""
    return ExudynBody(mass, [1.0] * 3 + [0.0] * 3, [1.01, 0, 0, 0, 0, 0], [0.01, 0, 0, 0, 0, 0])


@pytest.mark.ci
def test_two_nets_at_one_body_have_one_bound(tmp_path: Path) -> None:
    """What they put on it adds up; alone, after `detach` of the other, each has its own again."""
    nets = [spring(tmp_path)[0] for _ in range(2)]
    host = mass_on_springs(0.05 + sum(net.carried_mass("b") for net in nets))
    couplings = [exunet.couple(host.mbs, net, {"b": host.marker}) for net in nets]
    alone = longest_step(nets[0], STABLE)
    with pytest.raises(exu.ModelError, match=f"{alone / math.sqrt(2.0):.4g} s"):
        host.solve("RK44", round(1.0 / (0.75 * alone)), 1.0)
    host.solve("RK44", round(3.0 / (0.7 * alone)), 3.0)
    for coupling in couplings:
        assert coupling.report().residual < 0.0  # J: it takes out
    couplings[0].detach()
    nets[1].reset()
    couplings[1].detach()
    again = exunet.couple(host.mbs, nets[1], {"b": host.marker})
    host.solve("RK44", round(1.0 / (0.75 * alone)), 1.0)
    assert again.report().residual < 0.0


@pytest.mark.ci
def test_invalid_arguments_of_couple(scene: Scene) -> None:
    host, net = ExudynBody.second(scene), NetSystem(scene.net)
    point = host.mbs.AddMarker(MarkerBodyPosition(bodyNumber=host.object, localPosition=[0.0] * 3))
    for ports, words in (
        ({}, "port second"),
        ({"third": host.marker}, "'third'"),
        ({"second": 99}, "port second: .* 99"),
        ({"second": "x"}, "port second: .* 'x'"),
        ({"second": host.centre}, "port second: its position"),
        ({"second": point}, "port second: marker .* attitude"),
        ([host.marker], "requires"),
    ):
        with pytest.raises(InputError, match=words):
            exunet.couple(host.mbs, net, ports)  # type: ignore[arg-type]
    for arguments, words in (
        ((None, net, {"second": 0}), "mbs"),
        ((host.mbs, "net.toml", {}), "net"),
        ((host.mbs, NetSystem(exunet.load(scene.whole)), {}), "the net has no port"),
    ):
        with pytest.raises(InputError, match=f"couple: {words}"):
            exunet.couple(*arguments)  # type: ignore[arg-type]
    for longest in (-1.0, 0, True, math.nan, "1"):
        with pytest.raises(InputError, match="longest"):
            exunet.couple(host.mbs, net, {"second": host.marker}, longest=longest)  # type: ignore[arg-type]
    assert host.mbs.systemData.NumberOfLoads() == 0


# Native items


@pytest.mark.ci
def test_native_items_move_as_one_system(scene: Scene) -> None:
    known = scene.in_one(END).state
    host = ExudynBody.second(scene, in_frame=True)
    items = exunet.add_to(host.mbs, scene.net, {"second": host.object})
    assert items.items == {"ObjectRigidBody": 1, "MassPoint": 1, "ObjectConnectorSpringDamper": 2}
    assert list(items.bodies) == ["first"]
    assert (items.nodes >= 0).tolist() == [False, True, False]
    host.mbs.Assemble()
    host.solve("RK44", 24000, END)
    place = host.mbs.GetNodeOutput(int(items.nodes[1]), POSITION)
    # The kink of the law leaves second order: 1e-5 s squared times 1e3 m/s3 is 1e-7 m.
    np.testing.assert_allclose(place, known.position[1], atol=1e-7)
    np.testing.assert_allclose(host.at_centre(POSITION), known.bodies.position[1], atol=1e-7)


@pytest.mark.ci
def test_what_has_no_native_items(scene: Scene) -> None:
    host = ExudynBody.second(scene, in_frame=True)
    own, net = {"second": host.object}, scene.net
    apart = ExudynBody.second(scene)  # whose node is the centre of mass, and not the origin of the frame
    ground = apart.mbs.AddObject(ObjectGround())
    launch = CASES / "bodies" / "launch.toml"
    thrown = ["engine.backend=compiled", "bodies.chaser.motion=port"]
    fixed = ["bodies.first.motion=fixed", "bodies.first.velocity=[0,0,0]"]
    for mbs, case, ports, overrides, words in (
        (host.mbs, net, own, fixed, "fixed"),
        (host.mbs, net, own, ["effects.breaking={strain=0.5}"], "breaks"),
        (host.mbs, net, own, ["effects.air_drag={density=1.0, drag_coefficient=1.0}"], "air_drag"),
        (host.mbs, net, own, ["effects.rayleigh_damping={alpha=0.1, beta=1e-4}"], "damping"),
        (host.mbs, net, {}, [], "second"),
        (host.mbs, net, {"second": 99}, [], "99"),
        (host.mbs, net, own | {"x": 0}, [], "'x'"),
        (host.mbs, launch, {"chaser": host.object}, thrown, "chaser"),
        (apart.mbs, net, {"second": apart.object}, [], "port second: its position"),
        (apart.mbs, net, {"second": ground}, [], "port second: object 1"),
    ):
        with pytest.raises(exunet.ExunetError, match=words):
            exunet.add_to(mbs, case, ports, overrides)
