"""The times at which a run stores its state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.case.scene import Time


def stored_times(time: Time) -> NDArray[np.float64]:
    """(n_times,) stored times [s]: 0, those asked for, and the end."""
    if time.output_times is not None:
        inner = np.array([t for t in time.output_times if 0.0 < t < time.end])
    else:
        step = time.output_step or time.end
        number = int(np.floor(time.end / step * (1 + 1e-12)))
        inner = step * np.arange(1, number + 1)
        inner = inner[inner < time.end * (1 - 1e-12)]
    return np.concatenate([[0.0], inner, [time.end]])
