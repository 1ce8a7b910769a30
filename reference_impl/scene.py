"""A case made ready to run, for programs that call this one in their own process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.bodies import BodyStates, collect
from reference_impl.case import Case
from reference_impl.integration import Progress, Trajectory, integrate
from reference_impl.jumps import begun
from reference_impl.net import Net
from reference_impl.read import read
from reference_impl.start import initial_bodies, initial_state
from reference_impl.system import System, assemble
from reference_impl.weave import weave


@dataclass(frozen=True, eq=False)
class Scene:
    """A case with its net, what acts on it, and its start x0, v0 (n, 3) [m, m/s]; bodies0 (b, ...)."""

    case: Case
    net: Net
    system: System
    x0: Floats
    v0: Floats
    bodies0: BodyStates

    def integrate(
        self,
        times: Sequence[float] | Floats | None = None,
        *,
        method: str = "DOP853",
        rtol: float | None = None,
        atol: float | None = None,
        step: float | None = None,
        progress: Progress | None = None,
        x0: Floats | None = None,
        v0: Floats | None = None,
        bodies0: BodyStates | None = None,
    ) -> Trajectory:
        """See `integrate`, `Scheme`; stored times and start are those of the case where none are given."""
        return integrate(
            self.system,
            self.x0 if x0 is None else x0,
            self.v0 if v0 is None else v0,
            self.case.times if times is None else times,
            method=method,
            rtol=rtol,
            atol=atol,
            step=step,
            bodies=self.bodies0 if bodies0 is None else bodies0,
            progress=progress,
        )


def prepare(case: Case, symmetric: bool = False, assembled: bool = False) -> Scene:
    """The scene of a case; the arithmetic is one of plain, `symmetric`, `assembled` (README.md)."""
    net = weave(case)
    system, (_, bodies0) = assemble(case, net, symmetric, assembled), collect(initial_bodies(case, net))
    system = replace(system, begun=begun(case, system))
    x0, v0 = initial_state(case, net)
    return Scene(case, net, system, x0, v0, bodies0)


def load(
    path: str | Path,
    overrides: Mapping[str, Any] | None = None,
    symmetric: bool = False,
    assembled: bool = False,
) -> Scene:
    """The scene of the case file at `path`; raises Refused with all faults, see `read` and `prepare`."""
    return prepare(read(path, overrides), symmetric, assembled)


def perturbed(scene: Scene, size: float, seed: int) -> Floats:
    """x0 (n, 3) with normal deviates of standard deviation `size` [m] added to all coordinates not fixed."""
    change = size * np.random.default_rng(seed).standard_normal(scene.x0.shape)
    change[scene.net.fixed_nodes] = 0.0
    return np.asarray(scene.x0 + change)
