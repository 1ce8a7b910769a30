"""Contact with friction that sticks, in a net that is coupled to the body it meets, and in FMUs."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from contact_scenes import THROWN
from coupled import momenta
from fmu_hosts import CHost, Unpacked, built_host
from test_coupled_snapshots import all_of
from test_fmu_ports import tell

import exunet
from exunet import BodiesHost, Cosimulation, CoupledSnapshot, NetSystem, Simulation
from exunet.forces.contact.status import status_of

pytestmark = pytest.mark.slow  # each takes hundreds of macro steps

# A bullet touches the box from 20 ms on, and threads from 29 ms on; all have left it at 40 ms.
HERE, END = 0.03, 0.04  # s
STEP = 2e-4  # s, of the coupling: about half of the largest stable one
PORT = "bodies.box.motion=port"


@pytest.fixture
def case(tmp_path: Path) -> Path:
    path = tmp_path / "thrown.toml"
    path.write_text(THROWN)
    return path


def coupled(case: Path, step: float, iterations: int = 1) -> tuple[NetSystem, BodiesHost, Cosimulation]:
    net = NetSystem(case, [PORT])
    host = BodiesHost.of_ports(net)
    return net, host, Cosimulation(net, host, step=step, iterations=iterations)


def touches(sim: Simulation) -> bool:
    return status_of(sim.view.memory["contact/threads/box"]).touching > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_coupled_as_in_one_system(case: Path, iterations: int) -> None:
    """Second order of the body's motion through contact; momentum to round-off."""
    whole = Simulation(case)
    before = momenta(whole)
    whole.advance_to(END)
    known, errors, turned = whole.state.bodies, [], []
    for step in (STEP, 0.5 * STEP):
        net, host, both = coupled(case, step, iterations)
        both.advance_to(END)
        assert not both.books.cut
        assert status_of(net.simulation.view.memory["contact/threads/box"]).most > 1.0
        found, pairs = host.simulation.state.bodies, (momenta(net.simulation), momenta(host.simulation))
        errors.append(
            np.linalg.norm([found.position[0] - known.position[0], found.velocity[0] - known.velocity[0]])
        )
        now = [np.add(*both) for both in zip(*pairs, strict=True)]
        assert np.abs(now[0] - before[0]).max() < 1e-14  # N s; 0.046 N s in all
        turned.append(np.abs(now[1] - before[1]).max())
    assert errors[0] < 1e-6  # of 0.03 m/s that the box got: 1.4e-7 seen
    assert errors[1] < errors[0] / 3.0, errors
    assert turned[1] < turned[0] / 3.0 or turned[0] < 1e-13, turned  # repeats leave round-off


@pytest.mark.ci_for("1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_a_coupling_that_is_taken_back_in_mid_contact_repeats(
    case: Path, iterations: int, tmp_path: Path
) -> None:
    net, host, both = coupled(case, STEP, iterations)
    both.advance_to(HERE)
    assert touches(net.simulation)
    both.snapshot().save(tmp_path / "here")
    both.advance_to(END)
    once = all_of(net, both, host)
    both.restore(CoupledSnapshot.load(tmp_path / "here"))
    both.advance_to(END)
    assert all_of(net, both, host) == once
    net, host, both = coupled(case, STEP, iterations)
    both.restore(CoupledSnapshot.load(tmp_path / "here"))
    both.advance_to(END)
    assert all_of(net, both, host) == once


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["free", "port"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_state_of_an_fmu_in_mid_contact_repeats(
    case: Path, motion: str, fmi: int, tmp_path: Path
) -> None:
    """In memory, and from bytes in an instance that was reset; a port goes on as the box began."""
    start = NetSystem(case, [PORT]).frame("box")
    fmu = exunet.export_fmu(case, tmp_path / "net.fmu", [f"bodies.box.motion={motion}"], fmi=fmi)
    begin, middle, end = 0, round(HERE / STEP), round(END / STEP)

    def go(host: CHost, first: int, last: int) -> None:
        for k in range(first, last):
            if motion == "port":
                tell(host, start.after(k * STEP), "box")
            host.do("step", 0, k * STEP, STEP)

    with CHost(built_host(tmp_path), Unpacked.of(fmu, tmp_path / "unpacked")) as host:
        host.start()
        go(host, begin, middle)
        host.do("keep", 0, 0)
        host.do("save", 0, 0, tmp_path / "state")
        here = host.all_outputs()
        if motion == "port":
            assert host.get("ports.box.force.z") != 0.0  # in contact; nothing else pulls at the box
        go(host, middle, end)
        expected = host.all_outputs()
        assert expected != here
        host.do("back", 0, 0)
        assert host.all_outputs() == here
        go(host, middle, end)
        assert host.all_outputs() == expected
        host.do("load", 0, 1, tmp_path / "state")
        host.do("reset", 0)
        host.do("back", 0, 1)
        go(host, middle, end)
        assert host.all_outputs() == expected
        host.do("free", 0)


# A tumbling L, a mesh in a file of its own, which the net meets from 0.2 s on.
MESHED = Path(__file__).parents[2] / "cases" / "capture"
MESH_PORT, MESH_END, MESH_STEP = ["engine.backend=compiled", "bodies.l_shape.motion=port"], 0.3, 5e-4


@pytest.mark.slow
def test_a_mesh_at_a_port_as_in_one_system() -> None:
    """Limited by the fixed steps of the net, and by friction; momentum to round-off."""
    whole = Simulation(MESHED / "l_shape.toml", MESH_PORT[:1])
    before = momenta(whole)
    whole.advance_to(MESH_END)
    net = NetSystem(MESHED / "l_shape.toml", MESH_PORT)
    host = BodiesHost.of_ports(net)
    both = Cosimulation(net, host, step=MESH_STEP)
    both.advance_to(MESH_END)
    assert not both.books.cut
    assert np.abs(both.books.ports["l_shape"].impulse).max() > 1e-3  # N s
    off = np.subtract(host.simulation.bodies["l_shape"].position, whole.bodies["l_shape"].position)
    assert np.abs(off).max() < 1e-6  # m
    now = np.add(momenta(net.simulation)[0], momenta(host.simulation)[0])
    assert np.abs(now - before[0]).max() < 1e-12  # N s


@pytest.mark.slow
def test_a_mesh_at_the_port_of_an_fmu(tmp_path: Path) -> None:
    """Its file goes with the FMU: to the last bit what the net gives, when the file is gone."""
    for name in ("l_shape.toml", "l_shape.obj"):
        shutil.copy(MESHED / name, tmp_path / name)
    net = NetSystem(tmp_path / "l_shape.toml", MESH_PORT)
    fmu = exunet.export_fmu(tmp_path / "l_shape.toml", tmp_path / "net.fmu", MESH_PORT)
    (tmp_path / "l_shape.obj").unlink()
    with CHost(built_host(tmp_path), Unpacked.of(fmu, tmp_path / "unpacked")) as host:
        host.do("new", 0)
        host.do("enter", 0, 0.0)
        host.do("turn", 0, host.fmu.references["ports.inputs_at_end"], 1)
        host.do("exit", 0)
        for begin, end in pairwise((1e-3 * np.arange(301)).tolist()):
            told = net.frame("l_shape").after(end - begin)  # goes on as it began
            tell(host, told, "l_shape")
            host.do("step", 0, begin.hex(), end - begin)
            net.step(end, {"l_shape": told})
        net.finish()
        given = net.given("l_shape")
        assert np.abs(given.impulse).max() > 1e-3  # N s
        for name in ("impulse", "angular_impulse"):
            found = [host.get(f"ports.l_shape.{name}.{axis}") for axis in "xyz"]
            np.testing.assert_array_equal(found, getattr(given, name))
        host.do("free", 0)
