"""A coupling taken back, or into another process: net, host, and what the scheme remembers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import Scene
from test_couple_exudyn import Host

import exunet
from exunet import BodiesHost, Cosimulation, CoupledSnapshot, InputError, NetSystem

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

HERE, END = 0.21, 0.24  # s; the cable snaps taut at some 0.1 s
STEP = 0.01


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


def made(scene: Scene, host: str, **arguments: Any) -> tuple[NetSystem, Any, Cosimulation]:
    net: NetSystem = NetSystem(scene.net)
    own: Any = BodiesHost.of_ports(net)
    if host == "Exudyn":
        system = Host(scene)
        own = exunet.ExudynHost(system.mbs, {"second": system.marker}, step=1e-3)
        own.keeps = system  # alive
    return net, own, Cosimulation(net, own, step=STEP, **arguments)


def all_of(net: NetSystem, both: Cosimulation, host: Any) -> dict[str, Any]:
    """Every number, and the report."""
    arrays = {name: part.tobytes() for name, part in net.simulation.state.arrays().items()}
    return {**arrays, "host": host.frames(), "books": str(both.books), "of": both.books.numbers().tobytes()}


@pytest.mark.ci_for("{}-Exudyn")
@pytest.mark.slow
@pytest.mark.parametrize("host", ["bodies", "Exudyn"])
@pytest.mark.parametrize("arguments", [{}, {"iterations": 20}, {"energy": 1e-5}], ids=str)
def test_cosimulation_goes_on_to_the_same_bits(
    scene: Scene, tmp_path: Path, host: str, arguments: dict[str, Any]
) -> None:
    """In the middle of a snap: set back, set back after a reset of all, and in new ones from a file."""
    net, own, both = made(scene, host, **arguments)
    both.advance_to(HERE)
    assert net.simulation.net.tension.max() > 1.0  # N: taut
    here = both.snapshot()
    assert here.time == HERE
    here.save(tmp_path / "here")
    both.advance_to(END)
    once = all_of(net, both, own)
    both.restore(here)
    assert both.time == net.time == own.time == HERE
    both.advance_to(END)
    assert all_of(net, both, own) == once
    net, own, both = made(scene, host, **arguments)
    both.restore(CoupledSnapshot.load(tmp_path / "here"))
    both.advance_to(END)
    assert all_of(net, both, own) == once


@pytest.mark.slow
def test_in_a_new_process(scene: Scene, tmp_path: Path) -> None:
    _, own, both = made(scene, "bodies")
    both.advance_to(HERE)
    both.snapshot().save(tmp_path / "here")
    both.advance_to(END)
    script = (
        "import sys; from exunet import *\n"
        "net = NetSystem(sys.argv[1]); host = BodiesHost.of_ports(net)\n"
        f"both = Cosimulation(net, host, step={STEP})\n"
        "both.restore(CoupledSnapshot.load(sys.argv[2]))\n"
        f"both.advance_to({END})\n"
        "print(both.books.numbers().tobytes().hex(), [float(x).hex() for x in host.frames()['second'][0]])"
    )
    found = subprocess.run(
        [sys.executable, "-c", script, scene.net, tmp_path / "here"],
        capture_output=True,
        text=True,
        check=True,
    )
    place = [float(x).hex() for x in own.frames()["second"].position]
    assert found.stdout.strip() == f"{both.books.numbers().tobytes().hex()} {place}"


@pytest.mark.ci_for("other steps-1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize("back", ["both", "net", "reset", "other steps"])
def test_net_and_host_without_what_the_coupling_remembers_are_refused(
    scene: Scene, iterations: int, back: str
) -> None:
    """Set back by a step both passed as good: the motion before was that of a later time."""
    net, host, both = made(scene, "bodies", iterations=iterations)
    both.advance_to(HERE - STEP)
    here, kept = both.snapshot(), (net.snapshot(), host.snapshot())
    both.advance_to(HERE)
    if back == "reset":
        net.reset()
        host.simulation.reset()
    elif back == "other steps":  # to the time at which the coupling is, by another way
        net.restore(kept[0])
        net.step(HERE, {"second": net.frame("second").after(STEP)})
    else:
        net.restore(kept[0])
        if back == "both":
            host.restore(kept[1])
    words = "where the coupling left them: set both back by its own snapshot|restore both by a snapshot"
    for attempt in (lambda: both.advance_to(END), both.snapshot):
        with pytest.raises(InputError, match=words):
            attempt()
    both.restore(here)  # which puts all right
    both.advance_to(END)
    net, host, straight = made(scene, "bodies", iterations=iterations)
    for until in (HERE - STEP, END):
        straight.advance_to(until)
    assert straight.books.numbers().tobytes() == both.books.numbers().tobytes()


@pytest.mark.ci
@pytest.mark.slow
def test_what_a_snapshot_is_not_of(scene: Scene, tmp_path: Path) -> None:
    """Refused in words, and nothing has moved."""
    net, host, both = made(scene, "bodies")
    both.advance_to(0.05)
    here, before = both.snapshot(), all_of(net, both, host)
    system, other = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(system.mbs, other, {"second": system.marker})
    exudyn = made(scene, "Exudyn")[2].snapshot()
    case, spins = ["bodies.first.mass=2.5"], ["bodies.second.angular_velocity=[0.0, 110.0, 0.0]"]
    elsewhere, cut = (
        Cosimulation(net, BodiesHost.of_ports(net), step=STEP).snapshot()
        for net in (NetSystem(scene.net, case), NetSystem(scene.net, spins))
    )
    for given, words in (
        (None, r"needs what its `snapshot` or `CoupledSnapshot\.load` gave, got None"),
        (net.snapshot(), "needs what its `snapshot`"),
        (coupling.snapshot(), "is of a couple with ports second, this is one with second"),
        (elsewhere, "is of "),
        (cut, "is of "),  # whose step is cut to 1/110 s
        (exudyn, "restore: needs what `snapshot`"),  # the net fits, the host does not
    ):
        with pytest.raises(InputError, match=words):
            both.restore(given)  # type: ignore[arg-type]
        assert all_of(net, both, host) == before
    net.snapshot().save(tmp_path / "net")
    with pytest.raises(InputError, match="requires"):
        CoupledSnapshot.load(tmp_path / "net")
    with pytest.raises(InputError, match="a host whose snapshot is a tuple is not of a file"):
        CoupledSnapshot(here.scheme, here.ports, here.net, (1.0,), here.memory).save(tmp_path / "no")
    two = exu.SystemContainer().AddSystem()
    for _ in range(2):
        two.CreateMassPoint(mass=1.0)
    two.Assemble()
    with pytest.raises(InputError, match="the state is not of this system: it has other coordinates"):
        exunet.coupling.exudyn_state.put_back("couple", two, here.memory)


@pytest.mark.ci_for("{'iterations': 20}")
@pytest.mark.slow
@pytest.mark.parametrize("other", [{"step": 2 * STEP}, {"iterations": 20}, {"energy": 1e-5}], ids=str)
def test_a_snapshot_of_other_arguments_is_refused(scene: Scene, other: dict[str, Any]) -> None:
    """With another step it went on by the snapshot's, which neither of both had done."""
    _, _, both = made(scene, "bodies")
    both.advance_to(0.05)
    here = both.snapshot()
    other = {"step": STEP} | other
    net = NetSystem(scene.net)
    again = Cosimulation(net, BodiesHost.of_ports(net), **other)
    with pytest.raises(InputError, match=r"is of one with step=0\.01, iterations=1, .*; this one has step="):
        again.restore(here)
    assert again.time == 0.0
    again.advance_to(0.05)
    with pytest.raises(InputError, match="is of one with step="):
        both.restore(again.snapshot())
    both.restore(here)


@pytest.mark.ci_for("RK44")
@pytest.mark.slow
@pytest.mark.parametrize("first", ["RK44", "VelocityVerlet"])
def test_couple_goes_on_to_the_same_bits(scene: Scene, tmp_path: Path, first: str) -> None:
    """Between two runs, in the same system and in a new one; what velocity Verlet left in transit too."""

    def on(host: Host, net: NetSystem, coupling: Any) -> dict[str, Any]:
        host.solve("RK44", 3, on=True, startTime=HERE, endTime=END)
        arrays = {name: part.tobytes() for name, part in net.simulation.state.arrays().items()}
        books, state = coupling.report().numbers().tobytes(), host.mbs.systemData.GetSystemState()
        return {**arrays, "books": books, "host": [np.array(part).tobytes() for part in state]}

    host, net = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve(first, 20, endTime=0.2)
    transit = np.abs(coupling.in_transit["second"]).max()
    assert (transit > 0.0) == (first == "VelocityVerlet")
    host.solve("RK44", 1, on=True, startTime=0.2, endTime=HERE)
    here = coupling.snapshot()
    here.save(tmp_path / "here")
    once = on(host, net, coupling)
    coupling.restore(here)
    assert on(host, net, coupling) == once
    other, own = Host(scene), NetSystem(scene.net)
    again = exunet.couple(other.mbs, own, {"second": other.marker})
    again.restore(CoupledSnapshot.load(tmp_path / "here"))
    assert on(other, own, again) == once


@pytest.mark.ci
@pytest.mark.slow
def test_what_couple_does_not_take_back(scene: Scene) -> None:
    """Methods that keep more than the engine gives, and a net that was set back without the coupling."""
    for method in ("GeneralizedAlpha", "VelocityVerlet", "DOPRI5"):
        host, net = Host(scene), NetSystem(scene.net)
        coupling = exunet.couple(host.mbs, net, {"second": host.marker})
        start = coupling.snapshot()
        host.solve(method, 4, endTime=0.04)
        with pytest.raises(InputError, match=f"the host's last run was by {method}, which keeps"):
            coupling.snapshot()
        coupling.restore(start)
    host.solve("RK44", 20, endTime=0.2)
    kept, state = net.snapshot(), host.mbs.systemData.GetSystemState()
    host.solve("RK44", 1, on=True, startTime=0.2, endTime=HERE)
    net.restore(kept)
    host.mbs.systemData.SetSystemState(state, exu.ConfigurationType.Current)
    with pytest.raises(InputError, match=r"the net, at t = 0\.2 s, is not where the coupling left it"):
        coupling.snapshot()
    with pytest.raises(exu.ModelError, match=r"the net, at t = 0\.2 s, is not where the coupling left it"):
        host.solve("RK44", 1, on=True, startTime=0.2, endTime=HERE)
    coupling.detach()
    for what in (coupling.snapshot, lambda: coupling.restore(start)):
        with pytest.raises(InputError, match="the coupling was detached"):
            what()
