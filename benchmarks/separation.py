"""When the four bullet curves of the paper's net separate, by tolerance and start; writes separation.md.

    python benchmarks/separation.py

In mirrored arithmetic they never do (`exunet verify`, rung 7): round-off seeds the separation. This script
measures when it is seen, in three nets: over many starts moved by a few last bits (their median; Kendall's
tau of time and tightness, with its probability by chance), and in the paper's own setting, ode45's pair at
its default tolerances with assembled matrices. Takes some minutes; needs Numba.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

from exunet.base.markdown import markdown_table
from exunet.studies.both_codes import BothCodes, read_both
from exunet.verification.converged import with_tolerance
from exunet.verification.growth import ROUND_OFF, SEEDS, nearby
from exunet.verification.statistics import in_parallel
from exunet.verification.symmetry import NUDGE, SEPARATE, separation

HERE = Path(__file__).parent
NETS = {
    "damped": "planar_deployment",
    "undamped": "planar_undamped",
    "damped, packing 0.06": "planar_deployment_006",
}
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)  # of DOPRI5 [m, m/s]
DRAWS, FIRST_SEED = 20, 3000
DEFAULT = 1e-3  # relative tolerance of ode45 where none is given; the absolute one is a thousandth
TWICE = 0.02  # of the launch speed: curves that a reader of the paper's Fig. 5 certainly sees apart
NEVER = 1e9  # [s], in place of infinity, which a rank statistic does not take


def by_exunet(case: BothCodes, tolerance: float) -> float:
    """Time of separation [s] with DOPRI5; infinite if never."""
    times = np.linspace(0.0, case.start.scene.time.end, 401)
    return separation(case, case.run_exunet(times, with_tolerance(case, "DOPRI5", tolerance)))


def by_reference(case: BothCodes, states: int) -> tuple[float, float]:
    """Times [s] at which the bullets are `SEPARATE` and `TWICE` apart, with ode45's pair as it comes."""
    times = np.linspace(0.0, case.start.scene.time.end, states + 1)
    motion = case.run_reference(times, method="RK45", rtol=DEFAULT, atol=1e-3 * DEFAULT)
    return separation(case, motion), separation(case, motion, TWICE)


def of_moved_starts(cases: dict[str, BothCodes]) -> Iterator[Sequence[str]]:
    """Rows: net, median time of separation at each tolerance, tau and probability."""
    tolerances = np.repeat(TOLERANCES, DRAWS)
    for name, case in cases.items():
        starts = [nearby(case.compiled(), NUDGE, FIRST_SEED + k) for k in range(len(tolerances))]
        times = np.array(in_parallel(by_exunet, list(zip(starts, tolerances.tolist(), strict=True))))
        tau, chance = kendalltau(-tolerances, np.minimum(times, NEVER))
        medians = np.median(times.reshape(-1, DRAWS), axis=1)
        yield name, *map(shown, medians), f"{tau:+.2f}", f"{chance:.2g}"


def as_the_paper(cases: dict[str, BothCodes]) -> Iterator[Sequence[str]]:
    """Rows: net, what differs, times at which the curves are 1 % and 2 % of the launch speed apart."""
    for name, case in cases.items():
        system = replace(case.theirs.system, assembled=True)
        paper = replace(case, theirs=replace(case.theirs, system=system))
        runs = {f"{states} stored states": (paper, states) for states in (400, 2000)}
        for number, seed in enumerate(SEEDS):
            runs[f"last bits of the start moved, {number + 1}"] = (nearby(paper, ROUND_OFF, seed), 400)
        for what, times in zip(runs, in_parallel(by_reference, list(runs.values())), strict=True):
            yield name, what, *map(shown, times)


def shown(time: float) -> str:
    """A time of separation; "-": not before the end."""
    return f"{time:.3f}" if np.isfinite(time) else "-"


def main() -> None:
    cases = {name: read_both(HERE.parent / "cases" / f"{file}.toml") for name, file in NETS.items()}
    tolerances = [f"{tolerance:.0e}" for tolerance in TOLERANCES]
    parts = [
        "# When the bullets of the paper's net separate\n",
        f"Times [s] at which two bullet speeds first differ by {SEPARATE:.0%} of the launch speed (-: not "
        "before the end), by tolerance. Made by `python benchmarks/separation.py`.\n",
        f"## Median over {DRAWS} starts moved by {NUDGE:.0e} of the size (compiled loop)\n",
        *markdown_table(["net", *tolerances, "tau", "p"], of_moved_starts(cases)),
        f"## As the paper calculates: RK45 at {DEFAULT:g}, assembled matrices\n",
        *markdown_table(["net", "run", f"{SEPARATE:.0%} apart", f"{TWICE:.0%} apart"], as_the_paper(cases)),
    ]
    (HERE / "separation.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
