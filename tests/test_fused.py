"""The fused net: the same run as the connectors, open nodes, the exact Jacobian, refusal without Numba."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from starts import CASES, model, planar, states

from exunet.backends.exudyn.applied_kernel import AppliedKernel
from exunet.backends.exudyn.model import Model
from exunet.backends.exudyn.probe import Probe
from exunet.base.errors import MissingExtra
from exunet.case.casefile import load
from exunet.codegen import compile as compiling
from exunet.codegen.kernel import net_kernel
from exunet.codegen.linearised import Linearised
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate

# Before the first strings snap taut round-off is all that can differ; this much later it has not grown.
TAUT = ("initial.packing = 1.0005", "time.end = 0.002", "time.output_step = 0.001")


def both(*overrides: str, on: tuple[str, ...] = ()) -> list[Any]:
    """Results of the connectors and of the fused net."""
    return [simulate(planar(*overrides, f'engine.net = "{form}"', on=on)) for form in ("connectors", "fused")]


@pytest.mark.parametrize("method", ["RK44", "VelocityVerlet", "ExplicitMidpoint"])
def test_equal_steps_give_equal_runs(method: str) -> None:
    a, b = both(*TAUT, f'solver = {{method = "{method}", step = 5e-6}}', on=("rayleigh_damping", "gravity"))
    assert a.provenance["steps"] == b.provenance["steps"] == 400
    assert np.abs(a.velocity - b.velocity).max() < 1e-12 * np.abs(a.velocity).max()
    assert np.abs(a.position - b.position).max() < 1e-12
    assert np.abs(a.velocity[-1] - a.velocity[0]).max() > 0.1


@pytest.mark.parametrize("method", ["GeneralizedAlpha", "TrapezoidalIndex2"])
def test_implicit_methods_agree(method: str) -> None:
    """To Newton's tolerance: the connectors' Jacobian is numerical, the fused one exact."""
    a, b = both(*TAUT, f'solver = {{method = "{method}", step = 2e-5}}', on=("material_damping",))
    assert np.abs(a.velocity - b.velocity).max() < 1e-6 * np.abs(a.velocity).max()
    assert b.provenance["newton_iterations"] <= a.provenance["newton_iterations"] + 1


@pytest.mark.parametrize("on", [(), ("rayleigh_damping",), ("material_damping",), ("linear orbit",)])
def test_the_jacobian_is_the_derivative_of_the_forces(on: tuple[str, ...]) -> None:
    """Central differences along random directions, in states away from the kinks of the law."""
    start = planar(on=on)
    forces = start.system.forces
    kernel, linearised = net_kernel(forces), Linearised(start.system.blocks, forces)
    random = np.random.default_rng(2)
    for name in ("packed", "overstretched"):
        position, velocity = states(start)[name]
        for a, b in ((1.0, 0.0), (0.0, 1.0)):
            push = 1e-6 * random.normal(size=position.shape)
            ahead, behind = (
                kernel.forces(0.0, position + sign * a * push, velocity + sign * b * push)
                for sign in (1.0, -1.0)
            )
            matrix = linearised(0.0, position.ravel(), velocity.ravel(), a, b)
            expected = -(ahead - behind).ravel() / 2.0
            round_off = 1e-15 * np.abs(kernel.forces(0.0, position, velocity)).max()
            error = np.abs(matrix @ push.ravel() - expected).max()
            assert error <= 2e-7 * np.abs(expected).max() + round_off


def test_the_engine_gets_that_jacobian() -> None:
    start = planar(
        'engine.net = "fused"',
        'solver = {method = "GeneralizedAlpha", step = 1e-4}',
        on=("material_damping",),
    )
    probe, linearised = Probe(model(start)), Linearised(start.system.blocks, start.system.forces)
    position, velocity = states(start)["overstretched"]
    for got, a, b in ((probe.stiffness, 1.0, 0.0), (probe.damping, 0.0, 1.0)):
        matrix = linearised(0.0, position.ravel(), velocity.ravel(), a, b).toarray()
        assert np.abs(got(position, velocity) - matrix).max() <= 1e-12 * np.abs(matrix).max()


def test_fixed_nodes_stay_and_hold() -> None:
    """A hanging case with a held node: the same accelerations, none of the held one, in both forms."""
    path = CASES / "verification" / "hanging.toml"
    found = []
    for form in ("connectors", "fused"):
        start = prepare(load(path, [f'engine.net = "{form}"']).scene)
        assert len(start.net.fixed_nodes)
        found.append(Probe(model(start)).accelerations(*states(start)["overstretched"]))
        assert (found[-1][start.net.fixed_nodes] == 0.0).all()
    # The state moves fixed nodes too, which the engine ignores: they stay where the case holds them.
    assert np.abs(found[0] - found[1]).max() <= 1e-12 * np.abs(found[0]).max()
    assert np.abs(found[0]).max() > 1.0


def test_nodes_stay_open_to_loads_of_the_engine() -> None:
    """A force on a marker of a fused node accelerates that node by F / m and no other."""
    start = planar()
    plain, loaded = _fused_by_hand(start, None), _fused_by_hand(start, 7)
    position, velocity = states(start)["mixed"]
    change = loaded.accelerations(position, velocity) - plain.accelerations(position, velocity)
    expected = np.zeros_like(change)
    expected[7] = np.array([1.0, 2.0, 3.0]) / start.net.mass[7]
    scale = np.abs(plain.accelerations(position, velocity)).max()
    assert np.abs(change - expected).max() < 1e-12 * scale + 1e-9


def _fused_by_hand(start: Start, node: int | None) -> Probe:
    from exudyn.itemInterface import Force

    fused, net = Model(), start.net
    for k in range(net.n_nodes):
        fused.node(net.reference_position[k], start.position[k], start.velocity[k])
    applied = AppliedKernel(
        fused, net_kernel(start.system.forces), start.state.memory, start.system, bodies=False, halfway=False
    )
    fused.applied_forces(applied.evaluate, mass=net.mass)
    if node is not None:
        marker = fused._markers[node]  # what a scene with bodies will be given a verb for
        fused.system.AddLoad(Force(markerNumber=marker, loadVector=[1.0, 2.0, 3.0]))
    fused.assemble()
    return Probe(fused)


def test_without_numba_the_fused_net_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    start = planar('engine.net = "fused"')
    monkeypatch.setattr(compiling, "numba_installed", lambda: False)
    with pytest.raises(MissingExtra, match="Numba"):
        model(start)


def test_without_numba_kernel_terms_are_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the connector form, with the same forces."""
    start = planar('engine.net = "connectors"', on=("two-body orbit",))
    state = states(start)["mixed"]
    compiled = Probe(model(start)).accelerations(*state)
    from exunet.codegen import kernel as kernels

    kernels.term_kernel.cache_clear()
    monkeypatch.setattr(kernels, "numba_installed", lambda: False)
    interpreted = Probe(model(start)).accelerations(*state)
    kernels.term_kernel.cache_clear()
    assert np.abs(interpreted - compiled).max() <= 1e-13 * np.abs(compiled).max()
