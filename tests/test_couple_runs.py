"""Runs of a coupled system in Exudyn: which solver goes on, how a run ends, and two nets at one body."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import Scene, momenta, spring
from exudyn.itemInterface import MarkerBodyRigid, NodeRigidBodyRotVecLG, ObjectRigidBody
from test_couple_exudyn import END, VELOCITY, Host

import exunet
from exunet import InputError, NetSystem
from exunet.coupling.prediction import MARGIN, STABLE, longest_step

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

HALF = 0.12  # s


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


def coupled(scene: Scene) -> tuple[Host, NetSystem, Any]:
    host, net = Host(scene), NetSystem(scene.net)
    return host, net, exunet.couple(host.mbs, net, {"second": host.marker})


def settings(begin: float, end: float, steps: int) -> Any:
    made = exu.SimulationSettings()
    made.solution.file.write = False
    time = made.timeIntegration
    time.startTime, time.endTime, time.numberOfSteps = begin, end, steps
    time.explicit.useLieGroupIntegration = True
    return made


def not_stored(host: Host, first: str) -> None:
    """By the other method, and without a word to the system about it."""
    other = exu.DynamicSolverType.TrapezoidalIndex2 if first == "RK44" else exu.DynamicSolverType.RK44
    host.mbs.SolveDynamic(settings(HALF, END, 24), solverType=other, storeSolver=False)


def own_solver(host: Host, _: str) -> None:
    exu.MainSolverImplicitSecondOrder().SolveSystem(host.mbs, settings(HALF, END, 24))


def solver_again(host: Host, first: str) -> None:
    """The stored one, with other settings than those that are stored."""
    other = settings(HALF, END, 24)
    if first == "RK44":
        other.timeIntegration.solverType = exu.DynamicSolverType.VelocityVerlet
    host.mbs.sys["dynamicSolver"].SolveSystem(host.mbs, other)


@pytest.mark.ci_for("RK44-not_stored")
@pytest.mark.slow
@pytest.mark.parametrize("solve", [not_stored, own_solver, solver_again])
@pytest.mark.parametrize("first", ["RK44", "TrapezoidalIndex2"])
def test_a_second_run_whose_method_is_not_told_is_refused(
    scene: Scene, first: str, solve: Callable[[Host, str], None]
) -> None:
    """It was taken for one by the method of the first, and lost 0.03 of 1.2 N s."""
    host, net, coupling = coupled(scene)
    host.solve(first, 24, endTime=HALF)
    state = host.mbs.systemData.GetSystemState()
    host.mbs.systemData.SetSystemState(state, exu.ConfigurationType.Initial)
    with pytest.raises(exu.ModelError, match=r"the host's method is not known: use mbs\.SolveDynamic"):
        solve(host, first)
    assert net.time == pytest.approx(HALF)
    host.solve("RK44", 24, on=True, startTime=HALF)
    momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
    before = momenta(exunet.Simulation(scene.whole))[0]
    assert np.abs(momentum + coupling.in_transit["second"] - before).max() < 1e-12 * 1.8


@pytest.mark.slow
def test_a_run_before_the_coupling_or_before_a_restore_tells_nothing(scene: Scene) -> None:
    """One step, to the time at which the run before has ended."""
    host, net = Host(scene), NetSystem(scene.net)
    host.mbs.Assemble()
    host.solve("RK44", 1, endTime=0.01)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    kinds = exu.DynamicSolverType.TrapezoidalIndex2
    with pytest.raises(exu.ModelError, match="the host's method is not known"):
        host.mbs.SolveDynamic(settings(0.0, 0.01, 1), solverType=kinds, storeSolver=False)
    start = coupling.snapshot()
    host.solve("RK44", 1, endTime=0.01)
    coupling.restore(start)
    with pytest.raises(exu.ModelError, match="the host's method is not known"):
        host.mbs.SolveDynamic(settings(0.0, 0.01, 1), solverType=kinds, storeSolver=False)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK44", "TrapezoidalIndex2"])
def test_a_pre_step_function_ends_the_run(scene: Scene, method: str) -> None:
    """The engine takes the step in which it does so; the net too, so that momentum is kept."""
    host, net = Host(scene), NetSystem(scene.net)
    host.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.095)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve(method, 24)
    assert host.mbs.systemData.GetTime() == pytest.approx(0.1)
    assert net.time == pytest.approx(0.1)
    report = coupling.report()
    assert (report.steps, report.cut) == (10, "")
    momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
    before = momenta(exunet.Simulation(scene.whole))[0]
    assert np.abs(momentum + coupling.in_transit["second"] - before).max() < 1e-12 * 1.8


@pytest.mark.slow
def test_books_are_read_in_a_pre_step_function(scene: Scene) -> None:
    """In which the host's time is the end of the step that comes already."""
    host, net = Host(scene), NetSystem(scene.net)
    seen = list[int]()

    def look(mbs: Any, t: float) -> bool:
        report = coupling.report()
        seen.append(report.steps if not report.cut else -1)
        return True

    host.mbs.SetPreStepUserFunction(look)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 24)
    assert seen == list(range(24))
    assert coupling.report().steps == 24


@pytest.mark.slow
def test_a_function_that_ends_the_run_and_does_not_call_the_coupling_s(scene: Scene) -> None:
    """The host is a step ahead of the net; the report stays readable and says so."""
    host, net, coupling = coupled(scene)
    ours = host.mbs.GetPreStepUserFunction()["function"]
    host.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.095 and ours(mbs, t))
    with pytest.raises(exu.ModelError, match=r"forces are for the step from 0\.08 s to 0\.09 s"):
        host.solve("RK44", 24)
    assert net.time == pytest.approx(0.09)
    report = coupling.report()
    assert report.steps == 8
    words = (
        r"the step to t = 0\.09 s is not in the books: the host has gone on to t = 0\.095 s without the net"
    )
    assert words.replace("\\", "") in report.cut
    with pytest.raises(InputError, match=words):
        coupling.snapshot()
    coupling.detach()


@pytest.mark.slow
def test_a_host_that_is_set_back_says_that_its_run_was_ended(scene: Scene) -> None:
    own, net = Host(scene), NetSystem(scene.net)
    own.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.0225)
    host = exunet.ExudynHost(own.mbs, {"second": own.marker}, step=1e-3)
    both = exunet.Cosimulation(net, host, step=5e-3)
    words = r"the run to t = 0\.025 s ended at 0\.023 s: a pre-step function of the system has ended it"
    with pytest.raises(InputError, match=words):
        both.advance_to(0.1)
    assert net.time == pytest.approx(0.02)


class Mass:
    """The spring's mass in Exudyn, between as many nets as are given."""

    def __init__(self, mass: float) -> None:
        self.mbs: Any = exu.SystemContainer().AddSystem()
        moves = {"initialCoordinates": [1.01, 0, 0, 0, 0, 0], "initialVelocities": [0.01, 0, 0, 0, 0, 0]}
        node = self.mbs.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[0.0] * 6, **moves))
        body = self.mbs.AddObject(ObjectRigidBody(mass=mass, inertia=[1, 1, 1, 0, 0, 0], nodeNumber=node))
        self.marker = self.mbs.AddMarker(MarkerBodyRigid(bodyNumber=body))

    def solve(self, step: float, end: float) -> None:
        self.mbs.SolveDynamic(settings(0.0, end, round(end / step)), solverType=exu.DynamicSolverType.RK44)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.15, 1.35])
def test_energy_that_grows_is_doubted(tmp_path: Path, factor: float) -> None:
    """A case that says the body is heavier than it is: at 1.35 it had 5500 times its energy after 3 s."""
    spring(tmp_path)
    file = tmp_path / "spring.toml"
    net = NetSystem(file, [f"bodies.b.mass={0.05 * factor}"])
    host = Mass(0.05 + net.carried_mass("b"))
    coupling = exunet.couple(host.mbs, net, {"b": host.marker}, longest=1.0)
    host.solve(0.98 * longest_step(net, STABLE) / MARGIN, 3.0)
    report = coupling.report()
    if factor == 1.0:
        assert report.doubts == ()
    else:
        assert report.residual > 1e-3  # J, of 2.6e-6 J at the start
        assert len(report.doubts) == 1
        assert "port b: the coupling has added" in report.doubts[0]


@pytest.mark.ci
@pytest.mark.slow
def test_two_nets_at_one_body_have_one_bound(tmp_path: Path) -> None:
    """What they put on it adds up; alone, after `detach` of the other, each has its own again."""
    nets = [spring(tmp_path)[0] for _ in range(2)]
    host = Mass(0.05 + sum(net.carried_mass("b") for net in nets))
    couplings = [exunet.couple(host.mbs, net, {"b": host.marker}) for net in nets]
    alone = longest_step(nets[0], STABLE)
    with pytest.raises(exu.ModelError, match="with what another net puts on the same body") as told:
        host.solve(0.75 * alone, 1.0)
    assert f"largest stable one of its method, {alone / math.sqrt(2.0):.4g} s" in str(told.value)
    host.solve(0.7 * alone, 3.0)
    for coupling in couplings:
        assert coupling.report().residual < 0.0  # J: it takes out
    couplings[0].detach()
    nets[1].reset()
    couplings[1].detach()
    again = exunet.couple(host.mbs, nets[1], {"b": host.marker})
    host.solve(0.75 * alone, 1.0)
    assert again.report().residual < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("reported", [False, True])
def test_a_run_that_begins_from_the_first_start_is_told(scene: Scene, reported: bool) -> None:
    """Without updateInitialValues in the run before; where a report came between, the net was led back."""
    host, net, coupling = coupled(scene)
    host.solve("RK44", 12, endTime=HALF)
    if reported:
        assert coupling.report().steps == 12
    here = net.snapshot().as_bytes()
    with pytest.raises(exu.ModelError, match=r"mbs\.SolveDynamic\(\.\.\., updateInitialValues=True\)"):
        host.solve("RK44", 12, startTime=HALF)
    assert net.snapshot().as_bytes() == here
    assert coupling.report().steps == (12 if reported else 11)  # Exudyn forgets where the last has ended
    host, net, coupling = coupled(scene)
    for begin, end in ((0.0, HALF), (HALF, END)):
        host.mbs.SolveDynamic(
            settings(begin, end, 12), solverType=exu.DynamicSolverType.RK44, updateInitialValues=True
        )
    assert (coupling.report().steps, net.time) == (24, pytest.approx(END))


METHODS = ("RK44", "VelocityVerlet", "TrapezoidalIndex2", "GeneralizedAlpha")


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ran", [False, True])
def test_a_function_that_does_not_call_the_coupling_s_is_told(scene: Scene, method: str, ran: bool) -> None:
    """Set before the first run, or between two: the last step's force acted on through all of the next."""
    host, net = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    if ran:
        host.solve(method, 30, endTime=0.12)
    host.mbs.SetPreStepUserFunction(lambda mbs, t: True)
    begin = 0.12 if ran else 0.0
    words = (
        rf"port second: the host is at t = 0\.\d+ s, but its forces are for the step from .* s to {begin:g} s"
    )
    with pytest.raises(exu.ModelError, match=words) as told:
        host.solve(method, 30, on=ran, startTime=begin, endTime=begin + 0.12)
    assert "was not called" in str(told.value.__cause__)
    coupling.detach()
    free = host.of_centre(VELOCITY) if ran else np.array([0.5, 0.0, 0.3])
    host.solve(method, 30, on=ran, startTime=begin, endTime=begin + 0.12)
    np.testing.assert_allclose(host.of_centre(VELOCITY), free, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("late", [False, True])
def test_detached_in_a_run_what_the_host_goes_on_to_apply_is_booked(
    scene: Scene, method: str, late: bool
) -> None:
    """Before the coupling's part of a pre-step function, or after it, where the net has taken the step."""
    before = momenta(exunet.Simulation(scene.whole))[0]
    host, net = Host(scene), NetSystem(scene.net)

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
    host.solve(method, 60)
    assert net.time == pytest.approx(0.08 if late else 0.076)
    momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
    # generalised-alpha goes on to apply less and less: by 0.73 a step, 40 of them
    off = 1e-6 if method == "GeneralizedAlpha" else 1e-12
    assert np.abs(momentum + coupling.in_transit["second"] - before).max() < off * 1.8
    assert ("detached in it" in coupling.report().cut) == late


def spoil(host: Host, fault: str) -> None:
    """What a user's function may do to a system between two steps."""
    if fault == "a deleted body":
        host.mbs.DeleteObject(host.object)
        return
    data = host.mbs.systemData
    if fault == "NaN":
        speeds = data.GetODE2Coordinates_t()
        speeds[0] = np.nan
        data.SetODE2Coordinates_t(speeds)
    else:
        places = data.GetODE2Coordinates()
        places[0] += 0.5
        data.SetODE2Coordinates(places)


FAULTS = {
    "NaN": r"couple: port second: marker 0 contains NaN or infinity: the host diverged",
    "a jump": r"couple: the host's body at port second jumps: in the step from 0\.096 s to 0\.1 s its",
    "a deleted body": r"couple: port second: the body of its marker 0 was deleted: the coupling cannot go on",
}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK44", "GeneralizedAlpha"])
@pytest.mark.parametrize("fault", FAULTS)
def test_after_a_fault_net_and_books_are_those_of_the_last_good_step(
    scene: Scene, method: str, fault: str
) -> None:
    host, net = Host(scene), NetSystem(scene.net)

    def function(mbs: Any, t: float) -> bool:
        if t > 0.102:
            spoil(host, fault)
        return True

    host.mbs.SetPreStepUserFunction(function)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    with pytest.raises(exu.ModelError, match=FAULTS[fault]) as told:
        host.solve(method, 60)
    assert isinstance(told.value.__cause__, InputError)
    good, other = Host(scene), NetSystem(scene.net)
    good.mbs.SetPreStepUserFunction(lambda _, t: t < 0.098)  # False ends the run after the step
    exunet.couple(good.mbs, other, {"second": good.marker})
    good.solve(method, 60)
    report = coupling.report()
    assert report.steps == 24  # the one before is open: where it has led to is not known
    assert re.search(rf"the step to t = 0\.1 s is not in the books: {FAULTS[fault]}", report.cut)
    assert "nan" not in str(report).replace("NaN or infinity", "")
    assert "nan" not in str(coupling.in_transit)
    if method == "GeneralizedAlpha":
        assert np.abs(coupling.in_transit["second"]).max() > 0.0
    assert net.time == other.time == pytest.approx(0.1)
    for name, values in other.simulation.state.arrays().items():
        np.testing.assert_array_equal(net.simulation.state.arrays()[name], values)
    coupling.detach()


@pytest.mark.slow
def test_a_marker_that_is_deleted_in_a_run_is_told_by_its_port(scene: Scene) -> None:
    host, net = Host(scene), NetSystem(scene.net)

    def delete(mbs: Any, t: float) -> bool:
        if t > 0.102:
            mbs.DeleteMarker(host.marker)
        return True

    host.mbs.SetPreStepUserFunction(delete)
    exunet.couple(host.mbs, net, {"second": host.marker})
    with pytest.raises(exu.ModelError, match="port second: its marker was deleted: the coupling cannot"):
        host.solve("RK44", 60)
    assert net.time == pytest.approx(0.1)


@pytest.mark.slow
def test_a_system_that_is_reset_before_the_report_is_told(scene: Scene) -> None:
    """Its last step was missing from the books without a word."""
    host, _, coupling = coupled(scene)
    host.solve("RK44", 24, endTime=HALF)
    host.mbs.Reset()
    books = coupling.report()
    assert books.steps == 23
    assert "the step to t = 0.12 s is not in the books: couple: the host's run has ended there" in books.cut
    assert "t = 0 s now: it was reset or set back" in str(books)
    coupling.detach()


@pytest.mark.slow
@pytest.mark.parametrize("reports", [False, True])
def test_a_net_that_a_guard_stopped_is_told_in_the_report(tmp_path: Path, reports: bool) -> None:
    """At 25 m/s the second body stretches the cable beyond its law; the guards look at many steps at once.

    The report had the steps that the host took since without a word, or gave another reason.
    reports : in each step, so that the guards look in a report
    """
    scene = Scene(tmp_path)
    for file in (scene.whole, scene.net):
        file.write_text(file.read_text().replace("velocity = [0.5, 0.0", "velocity = [25.0, 0.0"))
    host, net, coupling = coupled(scene)
    if reports:
        own = host.mbs.GetPreStepUserFunction()["function"]

        def report_first(mbs: Any, time: float) -> bool:
            coupling.report()
            return bool(own(mbs, time))

        host.mbs.SetPreStepUserFunction(report_first)
    with pytest.raises(exu.ModelError) as raised:
        host.solve("RK44", 600)
    assert isinstance(raised.value.__cause__, exunet.RunStopped)
    books, impulse = coupling.report(), host.body.mass * (host.of_centre(VELOCITY) - [25.0, 0.0, 0.3])
    assert net.time < books.steps * END / 600 - 1e-9
    assert re.search(
        r"the steps to t = 0\.0\d+ s are in the books, which the host took, but the net is at its last good "
        r"state, t = 0\.03\d+ s: diverged at t = 0\.035\d* s",
        books.cut,
    )
    np.testing.assert_allclose(books.ports["second"].impulse, impulse, atol=1e-12 * 75.0)  # of the body [N s]
