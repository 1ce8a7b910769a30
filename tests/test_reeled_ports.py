"""Ports with reels: the largest stable macro step holds whatever is wound up."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from coupled import energy_of

from exunet import BodiesHost, Cosimulation, InputError, NetSystem
from exunet.coupling.prediction import CONTRACTING, MARGIN, STABLE, longest_step

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

# A body of 2 kg and one of 800 kg on a tether of 19 m, of which 5 m are outside: 100 J at 0.5 m/s.
SCENE = """
format = 1
title = "A reel on a port"
time = { end = 20.0, output_step = 0.1 }
solver = { method = "RK44", step = 1e-4 }
engine.backend = "compiled"
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[5.0, 3.0, 0.0]]
net.elements = []
net.node_masses = [0.1]
net.cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e8 }

[bodies.chaser]
motion = "port"
mass = 2.0
inertia = [1.0, 1.0, 1.0]

[bodies.target]
mass = 800.0
inertia = [100.0, 100.0, 100.0]
position = [5.0, 0.0, 0.0]
velocity = [0.5, 0.0, 0.0]

[tethers.tow]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e8
length = 19.0
start = { body = "chaser" }
end = { body = "target" }
reel = { paid_out = 5.0, damping = 10.0, commands = [{ at = 0.0, mode = "lock" }] }
"""
STIFFNESS = 1e8 * math.pi * 0.001**2  # EA [N]
QUARTER = 19.0 / 4.0  # m; of an element, if there is one
PULL = "tethers.tow.reel.commands=[{at=3.0, mode='rate', rate=0.1}]"
BRAKE = "tethers.tow.reel.commands=[{at=3.0, mode='brake', force=1.0}]"
FAR_END = ["bodies.chaser.motion=free", "bodies.target.motion=port"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "reel.toml"
    path.write_text(SCENE)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "mass", "shortest"),
    [
        ([], 2.0, 5.0),  # locked at all times: what is outside
        (["tethers.tow.reel.paid_out="], 2.0, 19.0),
        (["tethers.tow.reel.commands=[]"], 2.0, QUARTER),  # a script may wind it up
        ([PULL], 2.0, QUARTER),
        ([PULL, "tethers.tow.reel.shortest=4.9"], 2.0, 4.9),
        ([PULL, "tethers.tow.divisions=2"], 2.0, QUARTER / 2.0),
        ([BRAKE], 2.0, 5.0),  # it only pays out
        # 14 m wound up leave 0.25 m of the third element, so the outlet is the fourth with 5 m; as it pays
        # out, a node comes off at 1.5 elements and leaves a half
        ([BRAKE, "tethers.tow.divisions=4"], 2.0, 0.5 * QUARTER),
        (["tethers.tow.divisions=4"], 2.0, 5.0),
        # The tether ends at the port: the outlet comes there when all nodes are wound up.
        ([*FAR_END, PULL, "tethers.tow.divisions=2"], 800.0, QUARTER / 2.0),
        ([*FAR_END, BRAKE, "tethers.tow.divisions=2", "tethers.tow.reel.paid_out=19.0"], 800.0, 9.5),
    ],
)
def test_the_least_length_of_the_outlet_counts(
    file: Path, overrides: list[str], mass: float, shortest: float
) -> None:
    """Springs alone: sqrt(m L / EA), m with the node at the port, L the least that the outlet may have."""
    net = NetSystem(file, overrides)
    known = MARGIN * math.sqrt((mass + net.carried_mass(net.ports[0])) * shortest / STIFFNESS)
    for bound, times in ((STABLE, 1.0), (CONTRACTING, math.sqrt(6.0))):
        nothing_is_fed = bound._replace(beside=bound.beside._replace(most=0.0))
        assert longest_step(net, nothing_is_fed) == pytest.approx(times * known, rel=1e-9)


@pytest.mark.slow
def test_what_may_come_onto_the_drum_counts_as_held(file: Path) -> None:
    """Nine inner nodes of 0.116 kg; a drum that never winds holds none of them."""
    heavy = ["tethers.tow.divisions=10", "tethers.tow.density=19500.0", "tethers.tow.reel.paid_out=19.0"]
    assert longest_step(NetSystem(file, [*heavy, BRAKE, "bodies.chaser.mass=0.9"]), STABLE) > 0.0
    with pytest.raises(InputError, match=r"port chaser holds 1\.048 kg, too much for its body of 0\.9582 kg"):
        longest_step(NetSystem(file, [*heavy, PULL, "bodies.chaser.mass=0.9"]), STABLE)


@pytest.mark.ci_for("20.0")
@pytest.mark.slow
@pytest.mark.parametrize(("mass", "doubted"), [(2.0, False), (20.0, True)])
def test_the_report_doubts_a_coupling_whose_case_has_another_mass(
    file: Path, mass: float, doubted: bool
) -> None:
    """A body of 2 kg; with the 20 kg of the case, the step may be 3 times as long as is stable."""
    alone = BodiesHost.of_ports(NetSystem(file))
    net = NetSystem(file, [f"bodies.chaser.mass={mass}"])
    both = Cosimulation(net, alone, step=0.4)
    assert both.longest == pytest.approx(MARGIN * 0.1803 * math.sqrt(mass / 2.0), rel=0.01)
    both.advance_to(8.0)
    port = both.books.ports["chaser"]
    assert bool(both.books.doubts) == doubted == (abs(port.residual) > 0.1 * port.passed)
    words = "WARNING: port chaser: the coupling has added"
    assert (words in str(both.books)) == doubted


@pytest.mark.slow
def test_steps_beyond_it_are_cut_and_energy_stays(file: Path) -> None:
    """Cut to half of what the whole tether would allow, with which this run gained 4 J, and then diverged."""
    net = NetSystem(file)
    host = BodiesHost.of_ports(net)
    begin, both = energy_of(net, host), Cosimulation(net, host, step=0.35)
    assert "macro steps of 0.35 s cut to 0.1712 s" in str(both.books)
    both.advance_to(14.0)
    assert abs(energy_of(net, host) - begin) < 1e-3 * begin
