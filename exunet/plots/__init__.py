"""Figures of results and of ensembles, and animations."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def _import_matplotlib() -> None:
    """Import Matplotlib also where MPLBACKEND names a backend that this Python does not have.

    A notebook sets the variable for the programs that it starts. Figures here are drawn by Agg in any case.
    """
    chosen = os.environ.pop("MPLBACKEND")
    try:
        import matplotlib
    finally:
        os.environ["MPLBACKEND"] = chosen
    with suppress(ValueError):
        matplotlib.rcParams["backend"] = chosen


if "MPLBACKEND" in os.environ and "matplotlib" not in sys.modules:
    _import_matplotlib()
