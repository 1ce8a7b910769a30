"""Starts for tests of the backends: small nets, effects by name, states that try every branch."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exunet.integrators.exudyn.build import build
from exunet.integrators.exudyn.model import Model
from exunet.kernels.kernel import ForceTable, Kernel, Takes
from exunet.scene.casefile import load
from exunet.simulation.preparation import Start, prepare

Floats = NDArray[np.float64]
CASES = Path(__file__).parents[1] / "cases"

# Strong enough to show at once beside the elastic forces; together they use every kind of term.
_ORBIT = "mean_motion = 0.3, radial = [0.0, 0.6, 0.8], along_track = [1.0, 0.0, 0.0]"
EFFECTS = {
    "rayleigh_damping": "{alpha = 0.2, beta = 1e-6}",
    "mass_damping": "{alpha = 0.7}",
    "material_damping": "{relaxation_time = 1e-4}",
    "gravity": "{acceleration = [1.0, 2.0, -9.0]}",
    "linear orbit": f'{{{_ORBIT}, model = "linear"}}',
    "two-body orbit": f'{{{_ORBIT}, model = "two_body"}}',
    "thermal_strain": "{temperature_change = -100.0, expansion_coefficient = 5e-5}",
}


def effects(names: Iterable[str]) -> list[str]:
    """Overrides that switch these effects on."""
    keys = {name: "orbit" if "orbit" in name else name for name in names}
    return [f"effects.{key}={EFFECTS[name]}" for name, key in keys.items()]


def text_of(kernel: Kernel) -> str:
    """Of all that is compiled for a kernel."""
    return "\n".join((kernel.source, *kernel.sources))


def no_table(takes: Takes = Takes.NOTHING) -> ForceTable:
    """Of steps whose forces a test gives in another way."""
    return ForceTable((), takes, (), np.zeros(0), {})


def planar(*overrides: str, on: Iterable[str] = ()) -> Start:
    """The paper's net (40 nodes, 64 elements), undamped, with the effects `on`."""
    return prepare(load(CASES / "planar_undamped.toml", [*overrides, *effects(on)]).scene)


def model(start: Start) -> Model:
    """The engine's model of a start."""
    return build(start.system, start.state, start.plan)


def states(start: Start, seed: int = 3) -> dict[str, tuple[Floats, Floats]]:
    """Position and velocity (n_nodes, 3) of a net that is packed, mixed, overstretched, or a point."""
    random = np.random.default_rng(seed)
    reference, shape = start.net.reference_position, start.position.shape

    def moved(scale: float, noise: float) -> tuple[Floats, Floats]:
        return scale * reference + noise * random.normal(size=shape), random.normal(size=shape)

    return {
        "packed": moved(0.1, 0.0),
        "mixed": moved(1.0, 1e-2),
        "overstretched": moved(1.2, 1e-2),
        "coincident": moved(0.0, 0.0),
    }
