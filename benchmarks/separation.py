"""When the bullet curves of the paper's nets separate, by tolerance of DOPRI5; prints a table.

    python benchmarks/separation.py

The net, its start and the equations have the mirror symmetries of the square: an error of an integrator is
the same for mirrored nodes. Only round-off, which depends on the order of additions, breaks the symmetry.
The instants are those of many starts moved by a few last bits: medians [s], and Kendall's tau of time and
tightness with its probability by chance. Takes some minutes; needs Numba.
"""

from __future__ import annotations

import multiprocessing

import numpy as np
from scipy.stats import kendalltau

from exunet.base.files import markdown_table
from exunet.methods.method import Backend
from exunet.studies.both_codes import BothCodes, read_both
from exunet.studies.ensemble import PAPER_SIZE
from exunet.verification.check import shipped
from exunet.verification.horizon import nearby, with_tolerance

NETS = ("planar_deployment", "planar_undamped", "planar_deployment_006")
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)  # [m, m/s]
DRAWS, FIRST_SEED = 20, 3000
NUDGE = 1e-15 / PAPER_SIZE  # of the size: a few units in the last place of the coordinates
SEPARATE = 0.01  # of the launch speed: two curves that far apart are seen as two
NEVER = 1e9  # [s], in place of infinity, which a rank statistic does not take


def separated(case: BothCodes, tolerance: float) -> float:
    """Time [s] at which two bullet speeds first differ by 1 % of the launch speed; infinite if never."""
    times = np.linspace(0.0, case.start.scene.time.end, 401)
    motion = case.run_exunet(times, with_tolerance(case, "DOPRI5", tolerance))
    speed = np.linalg.norm(motion.velocity[:, case.start.net.bullet_nodes], axis=-1)
    apart = np.flatnonzero(np.ptp(speed, axis=1) > SEPARATE * case.speed)
    return float(times[apart[0]]) if len(apart) else float("inf")


def row(name: str) -> list[str]:
    """Net, median time of separation at each tolerance, tau and probability."""
    case, tolerances = read_both(shipped()[name]).on_backend(Backend.COMPILED), np.repeat(TOLERANCES, DRAWS)
    jobs = [(nearby(case, NUDGE, FIRST_SEED + k), float(t)) for k, t in enumerate(tolerances)]
    with multiprocessing.get_context("spawn").Pool() as pool:
        times = np.array(pool.starmap(separated, jobs))
    tau, chance = kendalltau(-tolerances, np.minimum(times, NEVER))
    medians = np.median(times.reshape(-1, DRAWS), axis=1)
    return [name, *(f"{median:.3f}" for median in medians), f"{tau:+.2f}", f"{chance:.2g}"]


if __name__ == "__main__":
    head = ["net", *(f"{tolerance:.0e}" for tolerance in TOLERANCES), "tau", "p"]
    print("\n".join(markdown_table(head, map(row, NETS))))  # noqa: T201
