"""Bodies that touch each other: impacts, friction, momentum and energy, ports, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scenes import (
    BACKENDS,
    BALLS,
    FRICTION,
    ODD,
    TWO_BODIES,
    bounces,
    case_file,
    continue_alike,
    momenta_of_bodies,
    of_text,
    refused,
    simulation,
    taken_by_contact,
)

import exunet
from exunet import BodiesHost, Coupler, NetSystem, RunStopped
from exunet.forces.contact.status import ContactStatus, status_of
from exunet.results.summary import summarise
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation

MASSES = (2.0, 3.0)  # kg, of the balls
GRAVITY = 9.81  # m/s2
MU, SLIP = 0.3, 1e-3
# A box on a fixed plate, whose upper face is the plane z = 0.
ON_A_PLATE = (
    f"effects.gravity.acceleration=[0.0,0.0,{-GRAVITY}]",
    'bodies.other={shape="box",size=[4.0,2.0,0.4],edge_radius=0.05,mass=1.0,motion="fixed",'
    "position=[0.0,0.0,-0.2]}",
    'bodies.one={shape="box",size=[0.4,0.3,0.1],edge_radius=0.03,mass=2.0,position=[-1.0,0.05,0.05],'
    "velocity=[1.0,0.0,0.0]}",
    "effects.contact.damping=2.0",
    f"effects.contact.friction.coefficient={MU}",
    'effects.contact.friction.law="regularised"',
    f"effects.contact.friction.slip_speed={SLIP}",
)


STILL = "bodies.one.velocity=[0.0,0.0,0.0]"
SLOPE = "effects.gravity.acceleration=[1.4715,0.0,-9.81]"  # of 0.15


def status(sim: Simulation, presses: str = "one", touched: str = "other") -> ContactStatus:
    """Of what one body presses into another."""
    return status_of(sim.view.discrete[f"contact/body_{presses}/{touched}"])


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.2])
def test_restitution_is_what_was_stated(restitution: float, tmp_path: Path) -> None:
    sim = simulation(tmp_path, TWO_BODIES, *BALLS, *bounces(restitution), "solver.step=2e-5")
    sim.advance_to(0.3)
    one, other = (sim.bodies[name].velocity for name in ("one", "other"))
    assert other[0] - one[0] == pytest.approx(restitution, abs=1e-6)
    assert MASSES[0] * one[0] + MASSES[1] * other[0] == pytest.approx(-0.5, abs=1e-14)


@pytest.mark.slow
def test_an_elastic_collision_exchanges_what_it_must(tmp_path: Path) -> None:
    """Twice the velocity of the common centre, -0.1 m/s, less each body's own."""
    sim = simulation(tmp_path, TWO_BODIES, *BALLS, "solver.step=2e-5")
    before = sim.energy.total
    sim.advance_to(0.3)
    assert sim.bodies["one"].velocity == pytest.approx([-0.7, 0.0, 0.0], abs=1e-6)
    assert sim.bodies["other"].velocity == pytest.approx([0.3, 0.0, 0.0], abs=1e-6)
    assert sim.energy.total == pytest.approx(before, rel=1e-6)
    assert status(sim).depth == pytest.approx(math.sqrt(1.2 / 1e4), rel=1e-5)  # v sqrt(m / k), m = 6/5 kg


@pytest.mark.ci_for("rubbing1")
@pytest.mark.slow
@pytest.mark.parametrize("rubbing", [(), (*FRICTION, "effects.contact.damping=0.3")])
def test_an_oblique_collision_keeps_both_momenta_and_the_energy(
    rubbing: tuple[str, ...], tmp_path: Path
) -> None:
    sim = simulation(tmp_path, TWO_BODIES, *ODD, *rubbing, "solver.step=5e-5")
    before, energy = momenta_of_bodies(sim), sim.energy.total
    sim.advance_to(0.6)
    stored = status(sim, "other", "one").stored + status(sim, "one", "other").stored
    assert stored == pytest.approx(sim.energy.potential, rel=1e-9)
    assert stored > 1e-2 or rubbing  # with friction they part before
    sim.advance_to(0.7)
    after = momenta_of_bodies(sim)
    assert status(sim, "other", "one").most >= (1.0 if rubbing else 3.0)
    assert np.abs(after[0] - before[0]).max() < 1e-13 * 2.0  # kg m/s, of the box
    assert np.abs(after[1] - before[1]).max() < 1e-10
    assert sim.energy.total == pytest.approx(energy, rel=1e-6)
    taken = np.array(taken_by_contact(sim))
    assert (taken.min() > 1e-4) if rubbing else (np.abs(taken).max() == 0.0)


@pytest.mark.slow
def test_a_box_that_slides_stops_where_friction_says(tmp_path: Path) -> None:
    """v^2 / (2 mu g), but for the slip speed s: (v sqrt(v^2 + s^2) + s^2 asinh(v / s)) / (2 mu g)."""
    sim = simulation(tmp_path, TWO_BODIES, *ON_A_PLATE)
    sim.advance_to(1.0)
    known = math.sqrt(1.0 + SLIP**2) + SLIP**2 * math.asinh(1.0 / SLIP)
    way = sim.bodies["one"].position[0] + 1.0
    assert known / (2.0 * MU * GRAVITY) == pytest.approx(1.0 / (2.0 * MU * GRAVITY), rel=1e-5)
    # it tips as it stops, by 1e-4 m
    assert way == pytest.approx(known / (2.0 * MU * GRAVITY), rel=2e-4)
    assert abs(sim.bodies["one"].velocity[0]) < 1e-6
    assert way * MU * GRAVITY * 2.0 == pytest.approx(taken_by_contact(sim)[1], rel=1e-3)


@pytest.mark.slow
def test_a_box_at_rest_on_a_face_stays_where_it_is(tmp_path: Path) -> None:
    """It neither creeps nor turns in 10 s; its depth is where k p of all corners and edges is its weight."""
    sim = simulation(tmp_path, TWO_BODIES, *ON_A_PLATE, STILL)
    sim.advance_to(4.0)
    begin = sim.bodies["one"]
    sim.advance_to(14.0)
    end = sim.bodies["one"]
    assert np.abs(end.position - begin.position).max() < 1e-12
    assert end.attitude is not None
    assert begin.attitude is not None
    assert np.abs(end.attitude - begin.attitude).max() < 1e-12
    stiffness = 1e4 * (4.0 + 2.0 * (0.34 + 0.24) / 0.08)
    assert 0.05 - end.position[2] == pytest.approx(2.0 * GRAVITY / stiffness, rel=1e-3)


@pytest.mark.slow
def test_what_is_held_on_a_slope_creeps_as_the_law_says(tmp_path: Path) -> None:
    """mu N w / sqrt(w^2 + v_s^2) = N tan of the slope: w = v_s tan / sqrt(mu^2 - tan^2)."""
    sim = simulation(tmp_path, TWO_BODIES, *ON_A_PLATE, STILL, SLOPE)
    sim.advance_to(3.0)
    known = SLIP * 0.15 / math.sqrt(MU**2 - 0.15**2)
    assert sim.bodies["one"].velocity == pytest.approx([known, 0.0, 0.0], rel=1e-6, abs=1e-12)


def sticking(*changes: str) -> list[str]:
    """Overrides with friction that has a discrete state in place of what is smooth in the speed."""
    found = [change for change in changes if "slip_speed" not in change]
    return [item.replace("regularised", "sticking") for item in found]


@pytest.mark.slow
def test_what_is_held_on_a_slope_with_memory_does_not_creep(tmp_path: Path) -> None:
    sim = simulation(tmp_path, TWO_BODIES, *sticking(*ON_A_PLATE, STILL, SLOPE))
    sim.advance_to(4.0)
    begin = sim.bodies["one"].position
    sim.advance_to(14.0)
    assert np.abs(sim.bodies["one"].position - begin).max() < 1e-9
    assert begin[0] + 1.0 < 1e-3


@pytest.mark.slow
def test_a_ball_that_slides_comes_to_roll(tmp_path: Path) -> None:
    """Sliding friction slows it to 5/7 of its speed, whatever mu is; from then on it rolls without a loss.

    5/7 of a lever of the whole radius; at the lever l, half of the depth inside, m l^2 / (I + m l^2).
    """
    ball = 'bodies.one={shape="sphere",radius=0.1,mass=2.0,position=[-1.0,0.05,0.1],velocity=[1.0,0.0,0.0]}'
    sim = simulation(tmp_path, TWO_BODIES, *sticking(*ON_A_PLATE, ball))
    sim.advance_to(1.0)
    one = sim.bodies["one"]
    lever = 0.1 - 0.5 * 2.0 * GRAVITY / 1e4
    assert one.velocity[0] == pytest.approx(1.0 / (1.0 + 0.4 * (0.1 / lever) ** 2), rel=1e-3)
    assert one.angular_velocity is not None
    assert one.velocity[0] == pytest.approx(lever * np.linalg.norm(one.angular_velocity), rel=1e-3)
    sim.advance_to(1.5)
    assert sim.bodies["one"].velocity[0] == pytest.approx(one.velocity[0], rel=1e-5)


@pytest.mark.slow
def test_both_back_ends_give_the_same_motion(tmp_path: Path) -> None:
    """And a restart in mid contact is bitwise identical."""
    found = []
    for backend in BACKENDS.values():
        changes = *ODD, *sticking(*FRICTION), "effects.contact.damping=0.3", backend
        one, other = (simulation(tmp_path, TWO_BODIES, *changes) for _ in range(2))
        while not status(one, "other", "one").touching:
            one.advance(0.002)
        continue_alike(one, other, 0.4, tmp_path)
        found.append((one.state.bodies.position, one.state.bodies.attitude, one.view.first_order.copy()))
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() < 1e-10


@pytest.mark.slow
def test_metrics_of_a_run(tmp_path: Path) -> None:
    """With an impact that the law allows, and without an overlap."""
    changes = (*BALLS, *bounces(0.5), "time={end=0.3,output_step=0.01}")
    summary = summarise(exunet.run(of_text(TWO_BODIES, *changes)))
    assert summary["overlaps"] == []
    metrics = {name: entry["value"] for name, entry in summary["metrics"].items()}
    assert metrics["bodies_one+other_first_contact_s"] == pytest.approx(0.1, abs=2e-4)
    assert metrics["bodies_one+other_deepest_m"] == pytest.approx(7.973e-3, rel=1e-3)
    assert metrics["bodies_one+other_largest_force_N"] > 10.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "change", ["effects.contact.body_stiffness=10.0", "bodies.one.velocity=[3e4,0.0,0.0]"]
)
def test_bodies_too_deep_or_too_fast_stop_the_run(change: str, tmp_path: Path) -> None:
    sim = simulation(tmp_path, TWO_BODIES, *BALLS, change, "solver={method='RK44',step=1e-4,retry=0}")
    with pytest.raises(RunStopped, match=r"deeper than 0\.25 m in other|may move by more than 0\.2 m"):
        sim.advance_to(1.0)


@pytest.mark.slow
def test_a_port_that_a_body_touches_does_as_in_one_system(tmp_path: Path) -> None:
    """The ball of 3 kg is its host's; macro steps are cut to what contact puts on it."""
    changes = [*BALLS, *bounces(0.5)]
    whole = simulation(tmp_path, TWO_BODIES, *changes)
    changes[1] = changes[1].replace("mass=3.0", 'motion="port",mass=3.0')
    net = NetSystem(case_file(tmp_path, TWO_BODIES), changes)
    host = BodiesHost.of_ports(net)
    both = Coupler(net, host, step=0.02)
    assert both.longest < 0.02
    for time in (0.15, 0.3):
        whole.advance_to(time)
        both.advance_to(time)
        for name in ("one", "other"):
            found = net.simulation.bodies[name].velocity
            assert found == pytest.approx(whole.bodies[name].velocity, abs=2e-3)


MORE = (
    "bodies.one={shape='sphere', radius=0.3, mass=1.0}",
    "bodies.other={shape='box', size=[0.4, 0.4, 0.4], edge_radius=0.05, mass=1.0, position=[1.0, 0.0, 0.0]}",
    "bodies.tank={shape='cylinder', radius=0.2, length=1.0, edge_radius=0.05, mass=1.0, position=[5, 0, 0]}",
    "bodies.sharp={shape='box', size=[0.4, 0.4, 0.4], mass=1.0, position=[9.0, 0.0, 0.0]}",
)
CONTACT = "effects.contact."


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("bodies=[['one', 'otter']]", "bodies[0][1]"),
        ("bodies=[['one', 'one']]", "bodies[0]"),
        ("bodies=[['one', 'other'], ['other', 'one']]", "bodies[1]"),
        ("bodies=[['one', 'other', 'tank']]", "bodies[0]"),
        ("bodies=[['one', 'sharp']]", "bodies[0][1]"),
        ("bodies=[['tank', 'other']]", "bodies[0]"),  # a cylinder touches spheres only
        ("body_stiffness=", "body_stiffness"),
        ("law='hertz'", "body_stiffness"),
        ("friction={law='regularised', coefficient=0.3}", "friction.slip_speed"),
    ],
)
def test_wrong_keys_are_refused(change: str, key: str) -> None:
    assert f"{CONTACT}{key}".removesuffix(".") in refused(TWO_BODIES, *MORE, CONTACT + change)
    prepare_case(of_text(TWO_BODIES, *MORE, CONTACT + "bodies=[['one', 'tank'], ['other', 'one']]"))


def test_bodies_that_overlap_at_the_start_are_refused() -> None:
    assert refused(TWO_BODIES, *MORE, "bodies.other.position=[0.4, 0.0, 0.0]") == ["bodies.other.position"]
