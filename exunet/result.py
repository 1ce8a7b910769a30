"""The result of a run: arrays over the stored times, provenance, and the HDF5 file that keeps them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.net.arrays import Net

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Result:
    """States and energies of a net over the stored times.

    net              : the net in its reference configuration
    time             : (n_times,) [s]
    position         : (n_times, n_nodes, 3) [m]
    velocity         : (n_times, n_nodes, 3) [m/s]
    strain           : (n_times, n_elements) Green-Lagrange strain E11, eq. (6); negative when slack
    tension          : (n_times, n_elements) axial force [N], zero when slack
    kinetic          : (n_times,) [J], eq. (18)
    elastic          : (n_times,) [J], eq. (19)
    potential        : (n_times,) [J], of constant loads such as gravity
    dissipated       : (n_times,) [J], work done by damping since t = 0
    momentum         : (n_times, 3) [kg m/s]
    angular_momentum : (n_times, 3) [kg m2/s], about the origin
    complete         : False if the run stopped before its end
    verdict          : "ok", or why it stopped
    provenance       : case text, versions, method, counts, wall times (JSON-like)
    """

    net: Net
    time: Floats
    position: Floats
    velocity: Floats
    strain: Floats
    tension: Floats
    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats
    momentum: Floats
    angular_momentum: Floats
    complete: bool
    verdict: str
    provenance: dict[str, Any] = field(default_factory=dict)
