"""Kernels of force terms: forces and derivatives, what they share, where they are kept, items of Exudyn."""

from __future__ import annotations

import math
import os
import pickle
import sys
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import CASES, model, planar, states, text_of

from exunet.forces.loops import Index
from exunet.forces.terms import KernelCall, KernelTerm, Switch
from exunet.integrators.exudyn.build import Linearised, expected_items
from exunet.integrators.exudyn.probe import Probe
from exunet.kernels import compile as compiling
from exunet.kernels import kernel as kernels
from exunet.kernels.compile import compiled_module
from exunet.kernels.kernel import Kernel, compiled_rows
from exunet.kernels.source import EngineCoordinates
from exunet.model.energy import elastic
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare

SOURCE = '"""A module."""\n\nimport numpy as np\n\n\n@called\ndef twice(x):\n    return {factor} * x\n'


def test_the_forces_are_those_of_the_secant_stiffness() -> None:
    """Eqs. (3), (6) and (8), assembled element by element with a dense matrix."""
    start = planar()
    net = start.net
    position, velocity = states(start)["mixed"]
    expected = np.zeros((net.n_nodes, 3))
    for (i, j), length, stiffness in zip(
        net.element_nodes, net.reference_length, net.axial_stiffness, strict=True
    ):
        span = position[j] - position[i]
        strain = 0.5 * (span @ span - length**2) / length**2
        pull = stiffness * max(strain, 0.0) / length * span
        expected[i] += pull
        expected[j] -= pull
    forces = Kernel(start.system.forces).forces(0.0, position, velocity)
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("on", [(), ("material_damping",), ("thermal_strain", "gravity")])
def test_the_forces_tell_the_elastic_energy(on: tuple[str, ...]) -> None:
    """Eq. (19): half EA L0 E11^2 of each taut element, with the law's length and stiffness."""
    start = planar(on=on)
    kernel = Kernel(start.system.forces)
    for position, velocity in states(start).values():
        x, v, force = position.ravel().copy(), velocity.ravel().copy(), np.zeros(position.size)
        held, _ = kernel.module.forces(0.0, x, v, kernel.table().rows, force)
        expected = float(elastic(start.system.forces, position))
        assert held == pytest.approx(expected, rel=1e-11, abs=1e-300)


@pytest.mark.ci
@pytest.mark.slow
def test_the_same_bits_each_time_and_whatever_came_before() -> None:
    """Of the state alone: not of what is left of other states in the work space or in the data."""
    start = planar(on=("rayleigh_damping", "material_damping"))
    kernel, tried = Kernel(start.system.forces), states(start)
    first = {name: kernel.forces(0.0, *state) for name, state in tried.items()}
    assert len({forces.tobytes() for forces in first.values()}) == len(tried)  # different states
    table, before = kernel.table(), kernel.table().data
    for name in reversed(tried):
        x, v = (part.ravel().copy() for part in tried[name])
        added, every = np.zeros(x.size), np.arange(x.size, dtype=Index)
        kernel.module.forces(0.0, x, v, table.rows, added)
        out = np.full(x.size, np.nan)
        room = {name: np.full(x.size, np.nan) for name in ("x", "v", "force")}
        room |= {name: np.zeros(x.size) for name in ("external", "reference")}  # none, and at the origin
        none, asked = np.zeros(0, dtype=Index), np.full(1 + 2 * x.size, np.nan)
        place = EngineCoordinates(
            np.stack([every, every]), none, 0, 0, x.size, none, asked, np.zeros(2), False, **room
        )
        kernel.module.engine_forces(0.0, x, v, np.zeros(0), kernel.module.hold((table.rows, place)), out)
        for found in (added, out):
            assert found.reshape(-1, 3).tobytes() == first[name].tobytes()
        assert x.tobytes() == tried[name][0].tobytes()
        assert v.tobytes() == tried[name][1].tobytes()
    for first_value, value in zip(chain(*before), chain(*table.data), strict=True):
        np.testing.assert_array_equal(first_value, value)


@pytest.fixture
def no_module_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget modules made from SOURCE."""
    for name in [name for name in sys.modules if name.startswith("exunet_kernel_")]:
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.usefixtures("no_module_yet")
def test_scenes_that_differ_in_numbers_share_one_compiled_kernel() -> None:
    """Numbers of a term are data, not text: other nets, moduli, thrusts and knots compile nothing new."""
    push = "effects.thrust={bullets=[%s],time=[%s],force=[%s]}"
    scenes = [
        planar(push % ("0", "0.1,0.2", "[0,0,1.0],[0,0,2.0]")),
        planar(
            push % ("1,3", "0.0,0.5,0.7", "[1.0,0,0],[0,0,0],[0,1.0,0]"),
            "net.size=2.0",
            "net.cable.diameter=0.001",
        ),
        planar(push % ("2", "0.3,0.4", "[0,0,1],[0,0,5]"), "net.size=4.0", "net.cable.youngs_modulus=1e9"),
    ]
    kernels = [Kernel(start.system.forces) for start in scenes]
    assert len({text_of(kernel) for kernel in kernels}) == 1
    for kernel, start in zip(kernels, scenes, strict=True):
        kernel.forces(0.0, start.position, start.velocity)
    compiled = kernels[0].module.forces
    assert all(kernel.module.forces is compiled for kernel in kernels)
    assert len(compiled.signatures) == 1
    assert len({kernel.table().rows["add"].tobytes() for kernel in kernels}) == 1


def add_push(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
    for c in range(force.size):
        force[c] += 1.0


add_one = add_push


def add_push(t: float, x: Any, v: Any, data: Any, force: Any) -> None:  # type: ignore[no-redef]
    for c in range(force.size):
        force[c] += 2.0


def test_forces_of_one_name_do_not_disturb_each_other() -> None:
    start = planar()
    both = Kernel((KernelTerm("nodes", add_one), KernelTerm("nodes", add_push)))
    push = both.forces(0.0, start.position, start.velocity)
    np.testing.assert_array_equal(push.ravel(), np.full(push.size, 3.0))


@pytest.mark.parametrize("value", [True, "a"])
def test_data_that_compiled_code_cannot_take_are_refused(value: object) -> None:
    class Data(NamedTuple):
        value: Any

    def add(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
        """Nothing."""

    with pytest.raises(TypeError):
        compiled_rows([KernelCall(add, Data(value))], [""], [Data(value)], lanes=False)


def test_kernels_are_kept_in_the_cache_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled_module(SOURCE.format(factor=2)).twice(3.0) == 6.0
    assert compiled_module(SOURCE.format(factor=5)).twice(3.0) == 15.0
    kept = sorted((tmp_path / "exunet").glob("exunet_kernel_*.py"))
    assert len(kept) == 2
    assert len(list((tmp_path / "exunet" / "__pycache__").glob("*.nbc"))) == 2
    written = [path.stat().st_mtime_ns for path in kept]
    sys.modules.pop(kept[0].stem)
    sys.modules.pop(kept[1].stem)
    module = compiled_module(SOURCE.format(factor=2))
    assert module.twice(3.0) == 6.0
    assert sum(module.twice.stats.cache_hits.values()) == 1
    assert [path.stat().st_mtime_ns for path in kept] == written


@pytest.mark.usefixtures("no_module_yet")
@pytest.mark.parametrize("damaged", ["exunet_kernel_*.py", "__pycache__/*.nbi"])
def test_damaged_files_are_written_again(
    damaged: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The text, or Numba's index, which pickles argument types by module: a missing one is an ImportError."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled_module(SOURCE.format(factor=2)).twice(3.0) == 6.0
    for path in (tmp_path / "exunet").glob(damaged):
        path.write_bytes(pickle.dumps("0") + b"cexunet.no_such_module\nName\n.")
    (kept,) = (tmp_path / "exunet").glob("exunet_kernel_*.py")
    sys.modules.pop(kept.stem)
    assert compiled_module(SOURCE.format(factor=2)).twice(3.0) == 6.0


def test_without_a_place_to_keep_it_a_kernel_is_compiled_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "not a folder"
    file.touch()
    monkeypatch.setattr(compiling, "_folders", lambda: [file / "exunet"])
    assert compiled_module(SOURCE.format(factor=2)).twice(3.0) == 6.0


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_code_that_others_could_have_written_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    theirs.mkdir()
    theirs.chmod(0o777)
    monkeypatch.setattr(compiling, "_folders", lambda: [theirs, mine])
    assert compiled_module(SOURCE.format(factor=7)).twice(1.0) == 7.0
    assert list(theirs.iterdir()) == []
    assert any(mine.glob("exunet_kernel_*.py"))


TWICE = 2.0


def test_functions_that_cannot_be_compiled_are_refused_before() -> None:
    """Other arguments than a potential has; names of its module, without which a text is compiled."""

    def add(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
        force[0] += math.sqrt(x[0]) * np.float64(len(x))

    def potential(t: float, x: Any, data: Any) -> float: ...

    def doubled(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
        force[0] += TWICE * x[0]

    def calls(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
        force[0] += smooth_step(x[0])

    KernelCall(add)
    for wrong, others in ((add, {"potential": potential}), (doubled, {}), (calls, {})):
        with pytest.raises(TypeError):
            KernelCall(wrong, **others)
    assert KernelCall(calls, helpers=(smooth_step,)).helpers == (smooth_step,)

    class InSteps(Switch):
        def in_steps(self, discrete: np.ndarray) -> bool:
            return True

    with pytest.raises(TypeError):
        KernelTerm("nodes", add, switch=InSteps())


def smooth_step(x: float) -> float:
    """A helper."""
    return x * x * (3.0 - 2.0 * x)


def test_the_jacobian_is_the_derivative_of_the_kernel_terms() -> None:
    """Central differences along random directions."""
    start = planar(on=("two-body orbit",))
    forces = start.system.forces
    kernel, linearised = kernels.term_kernel(forces.kernels), Linearised(start.system.blocks, forces)
    random, (position, velocity) = np.random.default_rng(2), states(start)["mixed"]
    push = 1e-3 * random.normal(size=position.shape)
    ahead, behind = (kernel.forces(0.0, position + sign * push, velocity) for sign in (1.0, -1.0))
    matrix = linearised(0.0, position.ravel(), velocity.ravel(), 1.0, 0.0)
    expected = -(ahead - behind).ravel() / 2.0
    assert np.abs(expected).max() > 0.0
    assert np.abs(matrix @ push.ravel() - expected).max() <= 1e-6 * np.abs(expected).max()


def test_without_numba_kernel_terms_are_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    start = planar(on=("two-body orbit",))
    state = states(start)["mixed"]
    compiled = Probe(model(start)).accelerations(*state)
    kernels.term_kernel.cache_clear()
    monkeypatch.setattr(kernels, "numba_installed", lambda: False)
    interpreted = Probe(model(start)).accelerations(*state)
    kernels.term_kernel.cache_clear()
    assert np.abs(interpreted - compiled).max() <= 1e-13 * np.abs(compiled).max()


def test_forces_and_rates_of_one_state_come_of_one_evaluation() -> None:
    """Rates are looked up where forces and states are the same; a number put there shows it."""
    start = prepare(load(CASES / "capture" / "free_sphere.toml", ["engine.backend=exudyn"]).scene)
    made = model(start)
    applied, blocks, (q, v, _) = made.applied, start.system.blocks, made.coordinates()
    place, out = applied.place, np.zeros(made.n_coordinates)
    rates = slice(blocks.n_v, blocks.n_force)

    def evaluated_anew(time: float, speed: Any) -> bool:
        place.force[rates] = 7.0
        return not (applied.rates(time, q, speed) == 7.0).all()

    assert blocks.n_states > 0
    applied.evaluate(0.5, q, v, out)
    assert not evaluated_anew(0.5, v)
    assert evaluated_anew(0.5, v + 1e-9)
    assert not evaluated_anew(0.5, v + 1e-9)
    assert evaluated_anew(0.6, v)
    applied.set_external_force(np.ones((blocks.n_points, 3)))
    assert evaluated_anew(0.6, v)
    applied.accepted(0.6, q, v)
    assert evaluated_anew(0.6, v)
    applied.remember(start.state.discrete)
    assert evaluated_anew(0.6, v)


@pytest.mark.parametrize("name", ["planar_deployment", "effects/launch_force", "verification/hanging"])
def test_the_expected_items_are_those_that_are_built(name: str) -> None:
    """What `exunet check` reports that Exudyn would hold."""
    body = "bodies.target={mass=7.0, inertia=[2.0, 3.0, 4.0]}"
    start = prepare(load(CASES / f"{name}.toml", [body]).scene)
    assert expected_items(start.system) == model(start).items()
