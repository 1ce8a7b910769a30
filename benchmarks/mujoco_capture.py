"""The capture of captures.py in MuJoCo, for that page: threads as tendons, knots as spheres, a free box."""

from __future__ import annotations

import os
import time

import exunet

HEAD = "## MuJoCo"
WINDOW, WINDOWS = 0.05, 6  # s


def mujoco(sim: exunet.Simulation) -> list[str]:
    """Microseconds a step of both, window by window, from the start of a capture by the compiled loop."""
    import mujoco as engine

    net, law, state = sim.start.net, sim.start.system.forces.cable.law, sim.state
    step = sim.plan.step
    nodes = []
    for k, (mass, place) in enumerate(zip(net.mass, state.position, strict=True)):
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        where = " ".join(repr(float(c)) for c in place)
        nodes.append(
            f'<body pos="{where}">{slides}<inertial pos="0 0 0" mass="{float(mass)!r}" diaginertia="1 1 1"/>'
            f'<site name="s{k}"/><geom size="0.0205" contype="1" conaffinity="2" condim="3" '
            'friction="0.3 0 0"/></body>'
        )
    tendons = [
        f'<spatial springlength="0 {float(length)!r}" stiffness="{float(ea / length)!r}" '
        f'damping="{float(1e-6 * ea / length)!r}"><site site="s{i}"/><site site="s{j}"/></spatial>'
        for (i, j), length, ea in zip(net.element_nodes, law.natural_length, law.stiffness, strict=True)
    ]
    box = (
        '<body pos="0.1 0.1 1"><freejoint/><geom type="box" size="0.48 0.48 0.48" mass="100" contype="2" '
        'conaffinity="1" friction="0.3 0 0"/></body>'
    )
    model = engine.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" timestep="{step!r}"/><worldbody>{"".join(nodes)}{box}</worldbody>'
        f"<tendon>{''.join(tendons)}</tendon></mujoco>"
    )
    data = engine.MjData(model)
    data.qvel[: 3 * net.n_nodes] = state.velocity.ravel()
    data.qvel[-3:] = [0.3, 0.4, 0.2]
    rows, steps = [], round(WINDOW / (step or 1.0))
    sim.advance(1e-3)  # what is compiled is compiled, or loaded
    sim.reset()
    for k in range(WINDOWS):
        began = time.perf_counter()
        engine.mj_step(model, data, steps)
        spent, began = time.perf_counter() - began, time.perf_counter()
        sim.advance(WINDOW)
        own = time.perf_counter() - began
        ended = abs(data.time - (k + 1) * steps * (step or 1.0)) < 1e-9
        note = "" if ended else ", reset to its start"
        times = f"{1e6 * spent / steps:.0f} | {1e6 * own / steps:.1f}"
        rows.append(f"| {(k + 1) * WINDOW:.2f} | {times} | {data.ncon}{note} |")
    return [
        HEAD,
        "",
        f"MuJoCo {engine.__version__}, and the compiled loop by turns in one process; "
        f"load of the machine before: {os.getloadavg()[0]:.1f}.",
        "",
        "| until [s] | a step of MuJoCo [µs] | of the compiled loop [µs] | contacts of MuJoCo |",
        "|---|---|---|---|",
        *rows,
        "",
    ]
