"""What the reference takes, beside a run of DOPRI5 to the same time: right-hand sides, and seconds of each.

    python benchmarks/reference_rate.py [--budget S]

The constants of the estimate of a check (exunet/simulation/expected_cost.py) are from these numbers. Writes
benchmarks/reference_rate.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import process_time

import reference_impl as reference
from exunet.case.casefile import Case, load
from exunet.methods.method import METHODS, Kind
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation
from exunet.simulation.trial import by_adaptive_steps, in_the_compiled_loop
from exunet.system.initial import places_of_fold

HERE = Path(__file__).parent
CASES = HERE.parent / "cases"
NAMES = (
    "planar_deployment",
    "hard/divided_by_10",
    "hard/heavy_bullets",
    "hard/folded",
    "hard/mesh_1x20",
    "hard/one_element",
    "nets/cut",
    "nets/accordion",
    "hard/mesh_50x50",
    "effects/air_drag",
    "effects/bending",
    "effects/thermal_strain",
    "hard/long_undamped",
    "hard/odd_times",
    "bodies/snap",
    "bodies/dumbbell",
    "bodies/launch",
    "bodies/frame",
    "bodies/ejection",
    "bodies/tow",
    "missions/closed_box",
    "capture/miss",
    "capture/free_sphere",
    "hard/starts_in_contact",
    "verification/contact/nodes",
    "verification/contact/threads",
)


def by_the_reference(case: Case, budget: float) -> tuple[float, int, float]:
    """Time reached [s], right-hand sides, processor time of one [s]; budget : processor time [s]."""
    read = reference.read(case.path, {})
    if places := places_of_fold(case.scene):
        read = reference.with_places(read, reference_position=places[0], place=places[1])
    scene, reached, began = reference.prepare(read), 0.0, process_time()

    def look(time: float, _end: float) -> None:
        nonlocal reached
        reached = time
        if process_time() - began > budget:
            raise KeyboardInterrupt

    try:
        found = scene.integrate(progress=look)
    except reference.Interrupted as stop:
        found = stop.trajectory
    return reached, found.n_rhs, (process_time() - began) / found.n_rhs


def by_the_loop(case: Case, until: float) -> int:
    """Right-hand sides of DOPRI5 in the compiled loop until a time [s]."""
    start = prepare_case(case)
    there = in_the_compiled_loop if METHODS[start.plan.method].kind == Kind.ADAPTIVE else by_adaptive_steps
    simulation = Simulation(there(start))
    for time in case.scene.time.stored_times[1:]:
        while simulation.time < time <= until * (1.0 + 1e-12):
            simulation.attempt(float(time))
    return simulation.counts.right_hand_sides


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--budget", type=float, default=12.0, help="processor time of the reference on a case"
    )
    budget = parser.parse_args().budget
    lines = []
    for name in NAMES:
        case = load(CASES / f"{name}.toml")
        start = prepare_case(case)
        until, number, each = by_the_reference(case, budget)
        ours = by_the_loop(case, until)
        cells = (name, start.net.n_elements, len(start.system.bodies), f"{until:.4g}", number, ours)
        rates = f"{number / ours:.2g}", f"{1e3 * each:.2g}"
        lines.append("| " + " | ".join(map(str, (*cells, *rates))) + " |")
        print(lines[-1], flush=True)  # noqa: T201
    (HERE / "reference_rate.md").write_text("\n".join([*HEAD, *lines]) + "\n", encoding="utf-8")


HEAD = (
    "# What the reference takes",
    "",
    "`python benchmarks/reference_rate.py`: right-hand sides (RHS) of the reference (DOP853, its own",
    "tolerances) until a time t, of a run of DOPRI5 in the compiled loop until then (accuracy 1e-4), and",
    "processor time of one of the reference on a machine on which other programs ran too.",
    "",
    "| case | elements | bodies | t [s] | RHS | RHS of DOPRI5 | ratio | ms each |",
    "|---|---|---|---|---|---|---|---|",
)

if __name__ == "__main__":
    main()
