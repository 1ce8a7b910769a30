"""How the launch speed changes the opening: python examples/parameter_study.py [CASE] [END]

Each run is one number of a chaotic net; `exunet.run_ensemble` gives the spread of many starts.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import exunet

SPEEDS = (2.0, 2.5, 3.0)  # m/s


def main(
    case: str = "cases/planar_deployment.toml", end: str = "2.0", speeds: Sequence[float] = SPEEDS
) -> list[exunet.Deployment]:
    """Prints and returns the measures of deployment at each launch speed [m/s] until `end` [s]."""
    found = []
    for speed in speeds:
        changes = [f"launch.radial_speed={speed}", f"time.end={end}", "engine.loop=compiled"]
        measures = exunet.deployment(exunet.run(exunet.load(case, changes)))
        assert measures is not None  # the net has a mouth
        print(
            f"{speed:g} m/s: largest area {measures.largest_area:.2f} m2, "
            f"{measures.relative_area:.0%} of the achievable, at {measures.time_of_largest:.3f} s"
        )
        found.append(measures)
    return found


if __name__ == "__main__":
    main(*sys.argv[1:3])
