"""Numbers of other codes and papers: a swinging element, a folded chain that falls."""

from typing import Any

import numpy as np
import pytest
from scenes import listed

from exunet.results.result import Result
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate


def falls(case: dict[str, Any], times: list[float], **solver: Any) -> Result:
    case |= {"time": {"end": times[-1], "output_times": times[:-1]}, "solver": solver}
    case |= {"effects": {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}}
    return simulate(prepare(Scene.model_validate(case)))


def test_a_swinging_element_as_code_aster_computes_it() -> None:
    """SDNL100 A at T/4 to T, T = 1.6744 s: its mass is in the middle of 1 m, 0.5 m from the hinge [m]."""
    net = {"cable": {"area": 1e-4, "density": 1e4, "youngs_modulus": 1e12}, "fixed": [0]}
    case = listed([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], [[0, 1]], 1.0, net=net)
    result = falls(case, [0.4186, 0.8372, 1.2558, 1.6744], method="DOPRI5", tolerance=1e-10)
    moved = 2.0 * (result.position[1:, 1] - result.position[0, 1])
    np.testing.assert_allclose(moved[:, [0, 2]], [[-1, -1], [-2, 0], [-1, -1], [0, 0]], atol=5e-4)


def test_a_folded_chain_falls_as_calkin_and_march_have_it() -> None:
    """Times to fall y = 0.25 to 0.95 L = 2 m, by v^2 = 2 g y (1 - y / 2 L) / (1 - y / L); fold of 20 mm."""
    side = np.outer(np.arange(100), [0.0, 0.0, -0.01])
    places = np.concatenate([side, [[0.01, 0.0, -0.99]], np.add(side[::-1], [0.02, 0.0, 0.0])])
    cable = {"area": 1e-6, "density": 1e5, "youngs_modulus": 2e10, "law": "hooke"}
    nodes, elements = np.outer(np.arange(201), [0.01, 0.0, 0.0]), [[k, k + 1] for k in range(200)]
    case = listed(nodes.tolist(), elements, 1.0, net={"cable": cable, "fixed": [0]})
    case["initial"]["node_positions"] = places.tolist()
    result = falls(case, np.linspace(0.002, 0.54, 270).tolist(), method="VelocityVerlet", step=1e-5)
    found = np.interp([0.5, 1.0, 1.5, 1.8, 1.9], -result.position[:, -1, 2], result.time)
    assert found == pytest.approx([0.3119, 0.4281, 0.5028, 0.5314, 0.5376], rel=4e-3)  # free: 0.6224 s
