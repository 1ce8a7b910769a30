"""How long macro steps may be for light nodes beside a port: by the linear map, and in runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coupled import energy_of, spring
from macro_maps import growth_with_node

import exunet
from exunet.coupling.stability import (
    CONTRACTING,
    GROWTH,
    MARGIN,
    STABLE,
    PortModes,
    longest_step,
)

METHODS = {
    "once": STABLE,
    "repeats": CONTRACTING,
}


def allowed(method: str, k: float, node: float, beyond: float, tau: float) -> bool:
    """True if a step of 1 is, by the node and by the spring."""
    bound = METHODS[method]
    modes = PortModes(np.array([(1.0 + beyond) * k / node]), np.array([k * k / node]), tau)
    springs = k * (1.0 + bound.damper * tau) <= MARGIN**2 * bound.spring
    return springs and modes.longest(bound.modes, k / bound.spring, 1.0) >= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_no_amplitude_grows_by_more_than_is_stated(method: str, damped: bool) -> None:
    """400 nodes from far lighter than the body to 30 times heavier, slow and fast, in steps that are allowed.

    Of those that springs alone would allow and modes do not, some grow by more: the bound is needed.
    """
    bound, rng = METHODS[method], np.random.default_rng(13)
    grown, refused = [], []
    for _ in range(400):
        k, fast = 0.9 * bound.spring * 10.0 ** rng.uniform(-5.0, 0.0), 10.0 ** rng.uniform(-1.0, 1.5)
        beyond, tau = 10.0 ** rng.uniform(-3.0, 1.5), 10.0 ** rng.uniform(-5.0, 1.0) if damped else 0.0
        node = (1.0 + beyond) * k / fast**2
        if node > 30.0 or k * (1.0 + bound.damper * tau) > MARGIN**2 * bound.spring:
            continue
        found = growth_with_node(method, k, node, beyond, tau)
        (grown if allowed(method, k, node, beyond, tau) else refused).append(found)
    assert len(grown) > 100
    assert max(grown) < 1.1 * GROWTH
    assert damped or max(refused) > 2.0 * GROWTH


@pytest.mark.parametrize(
    ("strength", "relaxation", "longest"),
    [
        (2e4, 0.0, (0.04 / 1.8 + 0.5) ** -0.5),  # not fed: slow
        (2e-4, 0.0, (2e-3 / (0.11 * 8e-6)) ** 0.25),  # fed by 2e-3: faint
        (
            2e-4,
            0.11,
            (0.125 * 0.11 * 0.04 / (0.11 * 8e-6)) ** (1.0 / 3.0),
        ),  # which relaxation takes
        (2e-4, 1e6, np.inf),  # at every step: beyond, the gain falls faster
        (1e-6, 0.0, np.inf),  # never fed by 2e-3
    ],
)
def test_the_longest_step_of_a_mode(strength: float, relaxation: float, longest: float) -> None:
    """As the module writes it: w^2 = 0.2 / s^2 at rest, and 0.2 times that at the required slope."""
    modes = PortModes(np.array([0.2]), np.array([strength]), relaxation)
    found = modes.longest(STABLE.modes, 0.5, 0.2)
    assert found == pytest.approx(longest, rel=1e-12)
    both = PortModes(np.array([0.2, 0.2]), np.array([strength, 2e4]), relaxation)
    assert both.longest(STABLE.modes, 0.5, 0.2) <= found


@pytest.mark.parametrize("method", METHODS)
def test_the_first_step_that_feeds_an_undamped_node_is_near_to_the_bound(method: str) -> None:
    """A tenth of the body's mass: within a quarter of the step from which on its amplitudes grow by 1e-5."""
    ways = np.arange(0.5, 3.3, 0.02)
    fed = [w for w in ways if growth_with_node(method, 0.05 * w * w, 0.1, 1.0) > 1e-5]
    taken = [w for w in ways if allowed(method, 0.05 * w * w, 0.1, 1.0, 0.0)]
    assert 0.75 * min(fed) < max(taken) < min(fed)


def with_light_nodes(folder: Path, mass: float, damping: float = 0.0) -> exunet.NetSystem:
    """`spring` with a node of a mass [kg] in the middle of each cable, and a relaxation time [s]."""
    spring(folder)
    material = f"effects.material_damping.relaxation_time = {damping}\n" if damping else ""
    file = folder / "spring.toml"
    text = file.read_text()
    for old, new in (
        ("net.nodes = [[0.0, 0.0, 0.0], [1.0,", "net.nodes = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0,"),
        (", [2.0, 0.0, 0.0]]\nnet.fixed = [0, 2]", ", [1.5, 0.0, 0.0], [2.0, 0.0, 0.0]]\nnet.fixed = [0, 4]"),
        ("[[0, 1], [1, 2]]", "[[0, 1], [1, 2], [2, 3], [3, 4]]"),
        ("[0.0, 1e-3, 0.0]", f"[0.0, {mass}, 1e-6, {mass}, 0.0]"),
        ("positions = [[0.0, 0.0, 0.0], ", "positions = [[0.0, 0.0, 0.0], [0.505, 0.0, 0.0], "),
        (", [2.02, 0.0, 0.0]]", f", [1.515, 0.0, 0.0], [2.02, 0.0, 0.0]]\n{material}"),
        ("node = 1", "node = 2"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    file.write_text(text)
    return exunet.NetSystem(file)


def gained(net: exunet.NetSystem, step: float, iterations: int = 1, steps: int = 150) -> float:
    """Energy after some macro steps since the start, in parts of the body's kinetic energy there."""
    host = exunet.BodiesHost.of_ports(net)
    both = exunet.Coupler(net, host, step=step, iterations=iterations, longest=step)
    before = energy_of(net, host)
    both.advance_to(steps * step)
    return (energy_of(net, host) - before) / (0.5 * 0.05 * 0.01**2)


@pytest.mark.ci_for("0.001-0.0-1")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("mass", "damping", "iterations"),
    [
        (1e-3, 0.0, 1), (3e-3, 0.0, 1), (3e-4, 0.0, 1), (1e-3, 1e-4, 1), (1e-3, 1e-3, 1),
        (1e-3, 0.0, 20), (1e-4, 0.0, 20), (5e-3, 0.0, 20),
    ],
)  # fmt: skip
def test_within_the_bound_nothing_is_gained(
    tmp_path: Path, mass: float, damping: float, iterations: int
) -> None:
    """Nodes of 0.006 to 0.1 of the body's mass, undamped and damped; at 0.5 and 1 of the longest step."""
    bound = STABLE if iterations == 1 else CONTRACTING
    longest = longest_step(with_light_nodes(tmp_path, mass, damping), bound)
    for part in (0.5, 1.0):
        assert gained(exunet.NetSystem(tmp_path / "spring.toml"), part * longest, iterations) < 0.01
