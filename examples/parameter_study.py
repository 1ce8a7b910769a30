"""How the launch speed changes the opening: python examples/parameter_study.py [CASE] [END]

A launched net is chaotic: the result of one run is one value of a distribution. Here each speed has 16 runs,
perturbed by up to 1e-9 m, and the range of their results.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import exunet

CASE = str(Path(__file__).parents[1] / "cases" / "planar_deployment.toml")
SPEEDS = (2.0, 2.5, 3.0)  # m/s
RUNS = 16


def main(case: str = CASE, end: str = "2.0", speeds: Sequence[float] = SPEEDS) -> list[exunet.Ensemble]:
    """Print the largest area of the mouth at each launch speed [m/s] until `end` [s]; return the runs."""
    ensembles = []
    for speed in speeds:
        changes = [f"launch.radial_speed={speed}", f"time.end={end}"]
        runs = exunet.ensemble(exunet.load(case, changes), runs=RUNS)
        least, median, largest = runs.quantile("largest_area_m2", [0.0, 0.5, 1.0])
        print(
            f"{speed:g} m/s: largest area of median {median:.2f} m2, {least:.2f} to {largest:.2f} m2 "
            f"in {runs.runs} runs"
        )
        ensembles.append(runs)
    return ensembles


if __name__ == "__main__":
    main(*sys.argv[1:3])
