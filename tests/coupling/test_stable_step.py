"""Longest stable macro step: the linear map from step to step, springs, dampers, reels, contact, in runs.

Masses on springs and dampers, a net between the port and something heavy; `macro_maps` has the map.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from coupled import POSITION, VELOCITY, ExudynBody, energy_of, spring, stiffness
from macro_maps import growth
from scenes import CASES

import exunet
from exunet import BodiesHost, Coupler, InputError, NetSystem
from exunet.bodies.port import frames_of, rows_of
from exunet.coupling.rollback import Predictor
from exunet.coupling.stability import CONTRACTING, MARGIN, STABLE, longest_step, ratios_of


@pytest.mark.parametrize("damping", [0.0, 0.1, 1.0, 10.0])
def test_amplitudes_do_not_grow_below_the_bound(damping: float) -> None:
    """k (1 + 2 tau) below the bound, tau the relaxation time in macro steps."""
    for part in (1e-4, 1e-2, 0.1, 0.3, 0.6, 0.99):
        k = part * STABLE.spring / (1.0 + STABLE.damper * damping)
        assert growth(k, damping) < 1e-12, (part, k)


def test_where_amplitudes_grow() -> None:
    """Within a hundredth above the bound; masters that step host and net in parallel (Jacobi) lag by a step.

    That is a negative damping: amplitudes grow by H^2 k / (2 m) a step, however short the step is.
    """
    assert growth(1.01 * STABLE.spring) > 0.0
    for k in (1e-3, 1e-2):
        assert growth(k, parallel=True) == pytest.approx(0.5 * k, rel=0.05)
    assert growth(0.5, parallel=True) > 0.1


@pytest.mark.slow
def test_springs_and_dampers(tmp_path: Path) -> None:
    """sqrt(m / k), sqrt(6 m / k) with repeats; H^2 k / m + 2 H tau k / m = 1 and + 3 H tau k / m = 6."""
    net, host = spring(tmp_path)
    ratio = (0.05 + net.carried_mass("b")) / stiffness()
    known = MARGIN * np.sqrt(ratio)
    assert longest_step(net, STABLE) == pytest.approx(known, rel=1e-9)
    assert longest_step(net, CONTRACTING) == pytest.approx(np.sqrt(6.0) * known, rel=1e-9)
    coupler = Coupler(net, host, step=1.0)
    assert f"1 s cut to {known:.4g} s" in coupler.ledger.note
    assert coupler.longest == longest_step(net, STABLE)
    coupler.advance_to(10 * coupler.longest)
    assert coupler.ledger.longest <= coupler.longest * (1.0 + 1e-9)
    tau = 0.02
    damped = NetSystem(tmp_path / "spring.toml", [f"effects.material_damping.relaxation_time={tau}"])
    for bound, damper, limit in ((STABLE, 2.0, 1.0), (CONTRACTING, 3.0, 6.0)):
        step = longest_step(damped, bound) / MARGIN
        assert step**2 + damper * step * tau == pytest.approx(limit * ratio, rel=1e-12)


def grown(folder: Path, step: float, stretch: float, steps: int) -> float:
    """Energy [J] that explicit steps of net and host add; the host starts at 1 cm/s."""
    net, host = spring(folder, stretch)
    begin, predictor = energy_of(net, host), Predictor()
    for k in range(steps):
        now, until = rows_of(host.frames().values()), (k + 1) * step
        target = predictor.ahead(k * step, until, now)
        host.step(until, net.step(until, frames_of(net.ports, target)))
        predictor.keep(k * step, now, recoils=False)
    return energy_of(net, host) - begin


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [1.001, 1.1, 1.2])
def test_the_longest_step_falls_with_the_stretch(tmp_path: Path, stretch: float) -> None:
    """As the law's tangent grows: predicted, and measured within 3 %; amplitudes of 1e-5 m."""
    net, _ = spring(tmp_path, stretch)
    limit = np.sqrt((0.05 + net.carried_mass("b")) / stiffness(stretch))
    assert longest_step(net, STABLE) == pytest.approx(MARGIN * limit, rel=1e-9)
    assert grown(tmp_path, 0.97 * limit, stretch, steps=200) < 0.0
    assert grown(tmp_path, 1.03 * limit, stretch, steps=200) > 0.0


@pytest.mark.ci_for("RK44")
@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK44", "TrapezoidalIndex2", "GeneralizedAlpha"])
def test_amplitudes_of_exudyn_hosts(tmp_path: Path, method: str) -> None:
    """At a third of where they begin to gain: by the map, within a tenth, and the residual shows it.

    A fifth beyond that energy grows.
    """

    def gained(part: float, number: int) -> tuple[float, float]:
        """Energy and residual, relative to the oscillation's at the start: m (1 cm/s)^2 / 2."""
        net, _ = spring(tmp_path)
        mass = 0.05 + net.carried_mass("b")
        body = ExudynBody(mass, [1.0] * 3 + [0.0] * 3, [1.01, 0, 0, 0, 0, 0], [0.01, 0, 0, 0, 0, 0])
        step, scale = part * longest_step(net, STABLE) / MARGIN, 0.5 * mass * 1e-4
        host = exunet.ExudynHost(body.mbs, {"b": body.marker}, step=1e-4, method=method)
        begin, coupler = energy_of(net) + scale, Coupler(net, host, step=step, longest=step)
        coupler.advance_to(number * step)
        speed = body.at_centre(VELOCITY)
        energy = energy_of(net) + 0.5 * mass * float(speed @ speed) - begin
        return energy / scale, coupler.ledger.residual / scale

    part, number = 1.0 / 3.0, 100
    predicted = (1.0 + growth(part**2)) ** (2 * number) - 1.0
    assert -0.9 < predicted < -0.1  # a loss that can be measured
    energy, residual = gained(part, number)
    assert energy == pytest.approx(predicted, abs=0.1)
    assert residual == pytest.approx(energy, rel=0.2)
    assert gained(1.2, 16)[0] > 0.0


# A body of 2 kg and one of 800 kg on a tether of 19 m, of which 5 m are outside: 100 J at 0.5 m/s.
REEL = """
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
QUARTER = 19.0 / 4.0  # m; of an element, if there is one
PULL = "tethers.tow.reel.commands=[{at=3.0, mode='rate', rate=0.1}]"
BRAKE = "tethers.tow.reel.commands=[{at=3.0, mode='brake', force=1.0}]"
FAR_END = ["bodies.chaser.motion=free", "bodies.target.motion=port"]


def written(folder: Path, text: str) -> Path:
    file = folder / "case.toml"
    file.write_text(text)
    return file


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
def test_the_smallest_length_of_a_reels_outlet_counts(
    tmp_path: Path, overrides: list[str], mass: float, shortest: float
) -> None:
    """Springs only: sqrt(m L / EA), m with the node at the port, L the smallest that the outlet may have."""
    net = NetSystem(written(tmp_path, REEL), overrides)
    stiffness = 1e8 * math.pi * 0.001**2  # EA [N]
    known = MARGIN * math.sqrt((mass + net.carried_mass(net.ports[0])) * shortest / stiffness)
    for bound, times in ((STABLE, 1.0), (CONTRACTING, math.sqrt(6.0))):
        nothing_is_fed = bound._replace(modes=bound.modes._replace(most=0.0))
        assert longest_step(net, nothing_is_fed) == pytest.approx(times * known, rel=1e-9)


@pytest.mark.slow
def test_what_may_come_onto_the_drum_counts_as_held(tmp_path: Path) -> None:
    """Nine inner nodes of 0.116 kg; a drum that never winds holds none of them."""
    file = written(tmp_path, REEL)
    heavy = ["tethers.tow.divisions=10", "tethers.tow.density=19500.0", "tethers.tow.reel.paid_out=19.0"]
    assert longest_step(NetSystem(file, [*heavy, BRAKE, "bodies.chaser.mass=0.9"]), STABLE) > 0.0
    with pytest.raises(InputError, match=r"port chaser holds 1\.048 kg, .* 0\.9582 kg"):
        longest_step(NetSystem(file, [*heavy, PULL, "bodies.chaser.mass=0.9"]), STABLE)


@pytest.mark.ci_for("20.0")
@pytest.mark.slow
@pytest.mark.parametrize(("mass", "doubtful"), [(2.0, False), (20.0, True)])
def test_a_reel_at_a_body_of_another_mass(tmp_path: Path, mass: float, doubtful: bool) -> None:
    """A body of 2 kg; with the 20 kg of the case, the step may be 3 times as long as is stable.

    With its own mass steps are cut, to half of what the whole tether would allow, with which this run gained
    4 J, and then diverged.
    """
    file = written(tmp_path, REEL)
    host = BodiesHost.of_ports(NetSystem(file))
    net = NetSystem(file, [f"bodies.chaser.mass={mass}"])
    begin, coupler = energy_of(net, host), Coupler(net, host, step=0.4)
    assert coupler.longest == pytest.approx(MARGIN * 0.1803 * math.sqrt(mass / 2.0), rel=0.01)
    coupler.advance_to(8.0)
    port = coupler.ledger.ports["chaser"]
    assert bool(coupler.ledger.warnings) == doubtful == (abs(port.residual) > 0.1 * port.exchanged)
    if not doubtful:
        coupler.advance_to(14.0)
        assert abs(energy_of(net, host) - begin) < 1e-3 * begin


BALL = """
format = 1
title = "A ball on a trampoline"
time = { end = 2.0, output_step = 0.1 }
solver = { method = "RK44", step = 1e-4 }
engine.backend = "compiled"
initial.packing = 1.0
effects.gravity.acceleration = [0.0, 0.0, -9.81]
effects.material_damping.relaxation_time = 1e-4

[net]
topology = "explicit"
nodes = [[-0.5, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.5, 0.0, 0.0]]
elements = [[0, 2], [1, 2], [2, 3], [2, 4]]
fixed = [0, 1, 3, 4]
node_masses = [0.1, 0.1, 0.1, 0.1, 0.1]
cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e8 }

[bodies.ball]
shape = "sphere"
radius = 0.25
mass = 0.2
position = [0.0, 0.0, 0.252]
motion = "port"

[effects.contact]
threads = ["ball"]
law = "linear"
stiffness = 1e4
restitution = 0.5
impact_speed = 0.5
"""
# A box that lies on a thread of 1 m between two fixed nodes: a mass on the spring K L, of K 1e4 N/m2.
MASS, STIFFNESS, GRAVITY = 2.0, 1e4, 9.81
RADIUS = 0.001  # [m] of the thread
REST = 0.1 + RADIUS - MASS * GRAVITY / STIFFNESS  # height [m]
BOX = f"""
format = 1
title = "A box on a thread"
time = {{ end = 9.0, output_step = 1.0 }}
solver = {{ method = "RK44", step = 2e-4 }}
engine.backend = "compiled"
initial.packing = 1.0
effects.gravity.acceleration = [0.0, 0.0, -{GRAVITY}]

[net]
topology = "explicit"
nodes = [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, -5.0]]
elements = [[0, 1]]
fixed = [0, 1]
node_masses = [0.1, 0.1, 0.1]
cable = {{ diameter = {2.0 * RADIUS}, density = 1390.0, youngs_modulus = 1e8 }}

[bodies.box]
shape = "box"
size = [1.2, 0.2, 0.2]
edge_radius = 0.02
mass = {MASS}
inertia = [1e9, 1e9, 1e9]
position = [0.0, 0.0, {REST}]
velocity = [0.0, 0.0, 0.01]
motion = "port"

[effects.contact]
threads = ["box"]
law = "linear"
stiffness = {STIFFNESS}
restitution = 1.0
impact_speed = 0.1
"""


@pytest.mark.slow
def test_a_ball_that_falls_onto_a_net_as_in_one_system(tmp_path: Path) -> None:
    """Instead of steps of 20 ms, which threw the ball up at 1.2 m/s, it takes shorter ones."""
    file = written(tmp_path, BALL)
    whole, net = exunet.Simulation(file, ["bodies.ball.motion=free"]), NetSystem(file)
    host = BodiesHost.of_ports(net)
    coupler = Coupler(net, host, step=0.02)
    assert coupler.longest < 2e-3
    assert "0.02 s cut to" in coupler.ledger.note
    for time in (0.2, 0.4):  # on the net, and thrown up by it
        whole.advance_to(time)
        coupler.advance_to(time)
        known, found = whole.bodies["ball"], host.frames()["ball"]
        np.testing.assert_allclose(found.position, known.position, atol=2e-6)
        np.testing.assert_allclose(found.velocity, known.velocity, atol=2e-5)


def damping_of(restitution: float, speed: float) -> float:
    """a: d (1 + e) = ln((1 + d) / (1 - e d)) with d = a v, by bisection."""
    low, high = 1e-6, 1.0 / restitution - 1e-12
    for _ in range(200):
        d = 0.5 * (low + high)
        if d * (1.0 + restitution) > math.log((1.0 + d) / (1.0 - restitution * d)):
            low = d
        else:
            high = d
    return 0.5 * (low + high) / speed


@pytest.mark.ci
@pytest.mark.slow
def test_what_of_contact_counts(tmp_path: Path) -> None:
    """By hand: K L of all threads at the mobility of the surface, damping by the depth of an impact.

    Threads and bullets of a capture: 7 + 7 threads of 1.5 m, and 4 bullets, on a sphere of 2 kg.
    """
    file, contact = written(tmp_path, BALL), "effects.contact"
    mobility = 1.0 / 0.2 + 0.25**2 / (0.4 * 0.2 * 0.25**2)
    k = 1e4 * 2.0 * mobility
    undamped, friction = [f"{contact}.restitution=1.0"], f"{contact}.friction"
    assert ratios_of(NetSystem(file, undamped), "ball")[:2] == pytest.approx((k, 0.0), rel=1e-12)
    assert longest_step(NetSystem(file, undamped), CONTRACTING) == pytest.approx(MARGIN * math.sqrt(6.0 / k))
    # the body at 0.5 m/s on that spring gets v / omega deep, with the force k v / omega = m omega v
    impact = math.sqrt(k) * 0.5
    smooth = [f"{friction}.coefficient=0.3", f"{friction}.slip_speed=0.01", f"{friction}.law=regularised"]
    found = ratios_of(NetSystem(file, undamped + smooth), "ball")[:2]
    assert found == pytest.approx((k, impact * 0.3 / 0.01), rel=1e-12)
    # k_t theta = 2 zeta sqrt(m k_t) of each of four threads of 0.5 m and 2 mm, with k_t = K L / 2, zeta = 0.1
    thread = 1390.0 * math.pi * 0.001**2 * 0.5
    rubbing = 4.0 * 2.0 * 0.1 * math.sqrt(thread * 0.5 * 1e4 * 0.5) * mobility
    sticking = [f"{friction}.coefficient=0.3", f"{friction}.law=sticking"]
    found = ratios_of(NetSystem(file, undamped + sticking), "ball")[:2]
    assert found == pytest.approx((k, rubbing), rel=1e-12)
    damped = ratios_of(NetSystem(file), "ball").damper
    assert damped == pytest.approx(impact * damping_of(0.5, 0.5), rel=1e-9)
    case = CASES / "capture" / "free_sphere.toml"
    net = NetSystem(case, ["engine.backend=compiled", "bodies.ball.motion=port"])
    mobility = (1.0 + 1.0 / 0.4) / 2.0  # at its radius, whatever that is
    known = (1e3 * 14 * 1.5 + 5e3 * 4) * mobility
    assert ratios_of(net, "ball").spring == pytest.approx(known, rel=1e-12)


def swing(file: Path, step: float, number: int) -> float:
    """Largest distance of the box from where it rests in the last quarter of all steps, in amplitudes."""
    moves = [0, 0, 0.01, 0, 0, 0]
    body = ExudynBody(MASS, [1e9] * 3 + [0.0] * 3, [0, 0, REST, 0, 0, 0], moves, gravity=GRAVITY)
    host, places = exunet.ExudynHost(body.mbs, {"box": body.marker}, step=step), []
    coupler = Coupler(NetSystem(file), host, step=step, longest=step)
    for k in range(number):
        places.append(body.at_centre(POSITION)[2])
        coupler.advance_to((k + 1) * step)
    off = np.abs(np.array(places) - REST)
    return float(off[-number // 4 :].max() / (0.01 * math.sqrt(MASS / STIFFNESS)))


@pytest.mark.ci
@pytest.mark.slow
def test_where_the_box_on_a_thread_begins_to_swing_up(tmp_path: Path) -> None:
    """Predicted and measured: sqrt(m / K L), 14.1 ms. It dies out below and grows above."""
    file = written(tmp_path, BOX)
    bound = longest_step(NetSystem(file), STABLE) / MARGIN
    assert bound == pytest.approx(math.sqrt(MASS / STIFFNESS), rel=1e-6)
    assert swing(file, 0.94 * bound, 60) < 0.5
    assert swing(file, 1.05 * bound, 60) > 1.5
