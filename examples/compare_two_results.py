"""Run a case twice and print until when the two agree: python examples/compare_two_results.py [CASE] [END]

The second run has a tighter tolerance. Files work in the same way: exunet.compare("a.h5", "b.h5").
"""

from __future__ import annotations

import sys
from pathlib import Path

import exunet

CASE = str(Path(__file__).parents[1] / "cases" / "planar_deployment.toml")


def main(case: str = CASE, end: str = "2.0") -> exunet.Agreement:
    """Print and return the differences of the two runs until `end` [s]."""
    changes = [f"time.end={end}", "engine.backend=compiled", "solver.method=DOPRI5"]
    coarse, fine = (
        exunet.run(exunet.load(case, [*changes, f"solver.tolerance={tolerance}"]))
        for tolerance in (1e-7, 1e-9)
    )
    agreement = exunet.compare(coarse, fine)
    until = "the end" if agreement.agrees_until is None else f"{agreement.agrees_until:.3f} s"
    print(f"the runs agree until {until}")
    print(f"at the end their positions differ by {agreement.position_difference[-1]:.1e} m at most")
    return agreement


if __name__ == "__main__":
    main(*sys.argv[1:3])
