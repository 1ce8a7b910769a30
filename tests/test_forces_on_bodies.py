"""A force on a body: a spring and a damper between a net node and a point off the body's centre."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BACKENDS, BODY, case_file, continue_alike, start_of
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import exunet
from exunet.forces.blocks import Blocks
from exunet.forces.terms import KernelTerm
from exunet.results.result import Result
from exunet.simulation.preparation import Start
from exunet.simulation.run import simulate

Floats = np.ndarray
MASS, INERTIA = 2.0, np.array([0.2, 0.3, 0.4])
POINT, STIFFNESS, LENGTH, DAMPING = np.array([0.1, -0.2, 0.15]), 40.0, 0.3, 0.8
EA = 70e6 * math.pi * 0.0005**2


class Tie(NamedTuple):
    """Node, and body: where their entries begin; point of the body; N/m, m, N s/m; torque on the body [N m].

    All tests use one kernel, in which some of these are zero.
    """

    node: int
    centre: int
    attitude: int
    spin: int
    point: Floats
    stiffness: float
    length: float
    damping: float
    torque: float


def arm(x: Any, tie: Any) -> Any:
    """The point less the centre, in the scene's axes."""
    return turned(x, tie, tie.point[0], tie.point[1], tie.point[2], 1.0)


def turned(x: Any, tie: Any, a: float, b: float, c: float, way: float) -> Any:
    """A vector (a, b, c) from the body's axes to the scene's (way 1), or back (way -1)."""
    k = tie.attitude
    w, p, q, r = x[k], way * x[k + 1], way * x[k + 2], way * x[k + 3]
    s, t, u = q * c - r * b + w * a, r * a - p * c + w * b, p * b - q * a + w * c
    return a + 2.0 * (q * u - r * t), b + 2.0 * (r * s - p * u), c + 2.0 * (p * t - q * s)


def pull(x: Any, tie: Any, size: float, d: Any, force: Any) -> None:
    """A force of that size on the node along d, and its reaction at the point."""
    f = (size * d[0], size * d[1], size * d[2])
    for k in range(3):
        force[tie.node + k] += f[k]
        force[tie.centre + k] -= f[k]
    g = turned(x, tie, -f[0], -f[1], -f[2], -1.0)
    p = tie.point
    force[tie.spin] += p[1] * g[2] - p[2] * g[1]
    force[tie.spin + 1] += p[2] * g[0] - p[0] * g[2]
    force[tie.spin + 2] += p[0] * g[1] - p[1] * g[0]


def apart(x: Any, tie: Any) -> Any:
    """From the point to the node, and how far."""
    r = arm(x, tie)
    a = x[tie.node] - x[tie.centre] - r[0]
    b = x[tie.node + 1] - x[tie.centre + 1] - r[1]
    c = x[tie.node + 2] - x[tie.centre + 2] - r[2]
    far = math.sqrt(a * a + b * b + c * c)
    return (a / far, b / far, c / far), far


def add_tie(t: float, x: Any, v: Any, tie: Any, force: Any) -> None:
    """-k (d - L0) on the node."""
    d, far = apart(x, tie)
    pull(x, tie, -tie.stiffness * (far - tie.length), d, force)


def tie_energy(x: Any, tie: Any) -> float:
    """k (d - L0)^2 / 2."""
    _, far = apart(x, tie)
    return 0.5 * tie.stiffness * (far - tie.length) ** 2


def add_damper(t: float, x: Any, v: Any, tie: Any, force: Any) -> None:
    """-c times the rate of the distance, and the torque."""
    d, _ = apart(x, tie)
    w, p = tie.spin, tie.point
    u = turned(
        x,
        tie,
        v[w + 1] * p[2] - v[w + 2] * p[1],
        v[w + 2] * p[0] - v[w] * p[2],
        v[w] * p[1] - v[w + 1] * p[0],
        1.0,
    )
    rate = 0.0
    for k in range(3):
        rate += d[k] * (v[tie.node + k] - v[tie.centre + k] - u[k])
    pull(x, tie, -tie.damping * rate, d, force)
    force[tie.spin + 1] += tie.torque


def terms(
    blocks: Blocks, stiffness: float = STIFFNESS, damping: float = DAMPING, torque: float = 0.0
) -> Sequence[KernelTerm]:
    """A spring between node and body; a damper between them, with a torque about the body's second axis."""
    on = "target"
    where = (0, blocks.centre(on), blocks.attitude(on), blocks.spin(on))
    data = Tie(*where, POINT, stiffness, LENGTH, damping, torque)
    helpers = (arm, turned, pull, apart)
    spring = KernelTerm("node and body", add_tie, data, tie_energy, (turned, arm, pull, apart), bodies=(on,))
    return spring, KernelTerm("node and body", add_damper, data, helpers=helpers, bodies=(on,))


@cache
def exact(end: float) -> tuple[Floats, float]:
    """x, v at the end as one vector, and the energy taken out: the same motion in other words, by DOP853."""

    def rate(_t: float, y: Floats) -> Floats:
        x, c, q, v, u, w = y[:6].reshape(2, 3), y[6:9], y[9:13], y[13:19].reshape(2, 3), y[19:22], y[22:25]
        turn = Rotation.from_quat(q, scalar_first=True).as_matrix()
        away = x[0] - c - turn @ POINT
        far = np.linalg.norm(away)
        d = away / far
        rate = d @ (v[0] - u - turn @ np.cross(w, POINT))
        f = -(STIFFNESS * (far - LENGTH) + DAMPING * rate) * d
        span = x[1] - x[0]
        tension = 0.5 * EA * max(span @ span - 1.0, 0.0) * span
        torque = np.cross(POINT, turn.T @ -f)
        spin = (torque - np.cross(w, INERTIA * w)) / INERTIA
        turning = 0.5 * np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])
        pull = np.concatenate([(f + tension) / 0.5, -tension / 0.5])
        return np.concatenate([v.ravel(), u, turning, pull, -f / MASS, spin, [DAMPING * rate**2]])

    q = np.array([0.9, 0.1, 0.3, 0.2])
    start = [[0, 0, 0, 1.05, 0, 0, -0.5, 0.2, 0.1], q / np.linalg.norm(q)]
    start += [[-0.5, 0, 0.1, 0.5, 0.1, 0, 0.1, 0, 0.2], [1.0, 2.0, -1.5], [0.0]]
    found = solve_ivp(rate, (0.0, end), np.concatenate(start), method="DOP853", rtol=1e-13, atol=1e-13)
    return found.y[:-1, -1], float(found.y[-1, -1])


def made(folder: Path, form: str, *overrides: str) -> Start:
    return start_of(case_file(folder), [BODY, BACKENDS[form], *overrides], terms)


def error(result: Result) -> float:
    """Largest error of a coordinate or a velocity at the end."""
    body = result.bodies["target"]
    place = (result.position[-1], body.position[-1], body.attitude[-1])
    speed = (result.velocity[-1], body.velocity[-1], body.angular_velocity[-1])
    found = np.concatenate([np.ravel(part) for part in (*place, *speed)])
    known, _ = exact(float(result.time[-1]))
    found[9:13] *= np.sign(found[9:13] @ known[9:13])  # a quaternion and its negative agree
    return float(np.abs(found - known).max())


def balance(result: Result) -> Floats:
    """Largest changes of energy [J], momentum [kg m/s], angular momentum [kg m2/s]."""
    total = result.kinetic + result.elastic + result.potential + result.dissipated
    parts = (total[:, None], result.momentum, result.angular_momentum)
    return np.array([np.abs(part - part[0]).max() for part in parts])


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_energy_and_momenta_are_kept(form: str, tmp_path: Path) -> None:
    """DOPRI5 at 1e-10, some 40 steps."""
    result = simulate(made(tmp_path, form, "solver.tolerance=1e-10"))
    assert error(result) < 1e-8
    assert balance(result).max() < 1e-8
    assert result.dissipated[-1] == pytest.approx(exact(0.15)[1], rel=1e-7)
    assert result.dissipated[-1] > 0.01  # J, of 1 J


ORDERS = {
    "compiled": {"RK44": 4, "VelocityVerlet": 1},
    "exudyn": {"RK44": 4},
}


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize(
    ("form", "method", "order"), [(f, m, o) for f, all_ in ORDERS.items() for m, o in all_.items()]
)
def test_methods_have_their_orders(form: str, method: str, order: int, tmp_path: Path) -> None:
    """Verlet is of order 1 with forces that depend on velocities, as of the net alone."""
    errors = []
    for step in (3e-3, 1.5e-3) if order > 1 else (3e-4, 1.5e-4):
        solver = f"solver={{method='{method}', step={step}, force=true}}"
        errors.append(error(simulate(made(tmp_path, form, solver, "time.output_step=0.15"))))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3), errors


@pytest.mark.slow
def test_without_damping_verlet_is_of_order_2_in_the_compiled_loop(tmp_path: Path) -> None:
    """Against RK44 at a step of 2e-4 s, which is right to 1e-10."""
    results = []
    for method, step in (("RK44", 2e-4), ("VelocityVerlet", 3e-3), ("VelocityVerlet", 1.5e-3)):
        solver = f"solver={{method='{method}', step={step}, force=true}}"
        start = start_of(
            case_file(tmp_path), [BODY, BACKENDS["compiled"], solver], lambda b: terms(b, damping=0.0)
        )
        results.append(simulate(start).bodies["target"])
    off = [np.abs(result.angular_velocity - results[0].angular_velocity).max() for result in results[1:]]
    assert math.log2(off[0] / off[1]) == pytest.approx(2.0, abs=0.2), off


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_constant_torque_turns_a_body_by_t_over_j(form: str, tmp_path: Path) -> None:
    """About the second principal axis: angular velocity T t / J, in body axes."""
    still = BODY.replace("[1.0, 2.0, -1.5]", "[0.0, 0.0, 0.0]")
    start = start_of(
        case_file(tmp_path),
        [still, BACKENDS[form], "solver.method=RK44"],
        lambda b: terms(b, stiffness=0.0, damping=0.0, torque=1.2),
    )
    result = simulate(start)
    speed = 1.2 * result.time / INERTIA[1]
    np.testing.assert_allclose(result.bodies["target"].angular_velocity[:, 1], speed, rtol=1e-12, atol=1e-14)
    work = 0.5 * INERTIA[1] * speed**2
    np.testing.assert_allclose(result.dissipated, -work, rtol=1e-11, atol=1e-14)  # put in


@pytest.mark.parametrize("form", ["exudyn"])
def test_implicit_methods_refuse_forces_on_bodies(form: str, tmp_path: Path) -> None:
    start = made(tmp_path, form, "solver={method='GeneralizedAlpha', step=1e-3}")
    with pytest.raises(exunet.CaseError, match=r"GeneralizedAlpha.*acts on target"):
        exunet.Simulation(start)


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_snapshot_continues_to_the_bit(form: str, tmp_path: Path) -> None:
    one, other = (exunet.Simulation(made(tmp_path, form, "solver.method=DOPRI5")) for _ in range(2))
    one.advance_to(0.06)
    continue_alike(one, other, 0.12, tmp_path)
