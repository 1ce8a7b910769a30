"""Nets coupled to Exudyn systems: methods, runs, steps of the user's functions, faults; native items."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

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

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

END, HALF = 0.24, 0.12  # s


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


@pytest.mark.ci_for("RK44-1")
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize("method", METHODS)
def test_the_motion_is_that_of_one_system(scene: Scene, method: str, iterations: int) -> None:
    """Of second order, with momentum at any step; what is repeated repeats bitwise."""
    known, errors = scene.in_one(END).state.bodies.position[1], []
    for step in (8e-3, 4e-3):
        body, net, coupler = scene.coupled(method, step, iterations)
        coupler.advance_to(END)
        assert scene.lost(net, body) < 1e-12 * MOMENTUM
        errors.append(float(np.linalg.norm(body.at_centre(POSITION) - known)))
    assert errors[0] / errors[1] > 0.8 * 4.0, errors
    assert errors[1] < 2e-5  # m, of a way of 0.15 m
    assert (coupler.ledger.repeated > 0) == (iterations > 1)


@pytest.mark.parametrize("method", METHODS)
def test_the_residual_is_the_drift_of_the_energy(scene: Scene, method: str) -> None:
    """Of host and net, far above round-off of the 7 J that there are."""
    start = exunet.Simulation(scene.whole)
    for step in (8e-3, 2e-3):
        body, net, coupler = scene.coupled(method, step)
        coupler.advance_to(END)
        drift = body.energy + momenta(net.simulation)[2] - sum(momenta(start)[2:])
        assert abs(drift) > 1e-7  # J
        assert drift / coupler.ledger.ports["second"].residual == pytest.approx(1.0, abs=0.2)


@pytest.mark.ci_for("RK44")
@pytest.mark.parametrize("method", METHODS)
def test_a_restored_host_repeats_bitwise(scene: Scene, method: str) -> None:
    """Also an implicit one, which begins each run with new accelerations."""
    body, net, coupler = scene.coupled(method, 4e-3)
    coupler.advance_to(END)
    host = exunet.ExudynHost(body.mbs, {"second": body.marker}, step=1e-3, method=method)
    host.restore(host.snapshot() | {"time": np.array([END])})
    loads, here = net.step(END + 4e-3, {"second": net.frame("second").after(4e-3)}), host.snapshot()
    steps: list[float] = []
    body.mbs.SetPreStepUserFunction(lambda mbs, t: steps.append(t) is None)
    ends = []
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
    point = own.mbs.AddMarker(MarkerBodyPosition(bodyNumber=own.object, localPosition=[0.0] * 3))
    for arguments, words in (
        ({"method": "VelocityVerlet"}, "method"),
        ({"settings": 1}, "settings"),
        ({"step": 0.0}, "step"),
        ({"ports": {"second": 99}}, "port second: .* 99"),
        ({"ports": {"second": "x"}}, "port second: .* 'x'"),
        ({"ports": {"second": point}}, "port second: marker .* attitude"),
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
    host = exunet.ExudynHost(mbs, {"b": marker}, step=1e-3, method="GeneralizedAlpha")
    coupler = exunet.Coupler(net, host, step=1e-3)
    coupler.advance_to(0.1)
    speeds = [np.array(mbs.GetNodeOutput(node, VELOCITY)) for node in nodes]
    given = coupler.ledger.ports["b"].impulse
    assert np.abs(given).max() > mass * 0.01  # N s, as much as it had
    gained = mass * (np.mean(speeds, axis=0) - [0.01, 0.0, 0.0])
    np.testing.assert_allclose(gained, given, atol=1e-12 * np.abs(given).max())


# Items of the user, and faults


def test_loads_and_markers_may_be_deleted_except_the_couplings_own(scene: Scene) -> None:
    """The others get other numbers; the coupling follows its own."""
    body, net = ExudynBody.second(scene), NetSystem(scene.net)
    spare = body.mbs.AddMarker(MarkerBodyRigid(bodyNumber=body.object, localPosition=[0.05, 0.0, 0.0]))
    point = list(body.mbs.GetMarker(body.marker)["localPosition"])
    port = body.mbs.AddMarker(MarkerBodyRigid(bodyNumber=body.object, localPosition=point))
    first = body.mbs.AddLoad(LoadForceVector(markerNumber=body.centre, loadVector=[0.0] * 3))
    host = exunet.ExudynHost(body.mbs, {"second": port}, step=1e-3)
    coupler = exunet.Coupler(net, host, step=4e-3)
    body.mbs.DeleteLoad(first, False)
    body.mbs.DeleteMarker(spare)
    body.mbs.Assemble()
    coupler.advance_to(HALF)
    assert scene.lost(net, body) < 1e-12 * MOMENTUM
    body.mbs.DeleteLoad(0, False)
    body.mbs.Assemble()
    with pytest.raises(InputError, match="port second: a load"):
        coupler.advance_to(END)


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
    "0.5": r"at port second jumps: in the step from 0\.1 s to 0\.104 s",
    "-0.006": "at port second jumps",  # m, of 2 mm a step: back, and to the side of small jumps
    "0.002": "at port second jumps",
    "body": "port second: the body of its marker 0 was deleted",
    "marker": "port second: its marker was deleted",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_after_a_fault_net_and_ledger_are_those_of_the_last_good_step(scene: Scene, fault: str) -> None:
    body, net, coupler = scene.coupled("RK44", 4e-3)
    coupler.advance_to(0.1)
    good, other, known = scene.coupled("RK44", 4e-3)
    known.advance_to(0.1)
    if fault in ("body", "marker"):
        spoil(body, fault)
    else:
        body.mbs.SetPreStepUserFunction(lambda mbs, t: t < 0.1035 or spoil(body, fault) is None)
    with pytest.raises((InputError, exu.ModelError), match=FAULTS[fault]):
        coupler.advance_to(END)
    assert coupler.ledger.steps == 25
    assert np.isfinite(coupler.ledger.as_array()).all()
    assert_same_bits(net, other)
    assert good.mbs is not body.mbs


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
