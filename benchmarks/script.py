"""What a script, a closing line and four controllers add to a step of the compiled loop, 20 x 20 meshes.

    python benchmarks/script.py [--repeats 40]

A net is thrown at a box that it does not reach, with RK44 steps of 0.1 ms; conditions that never hold are
looked at all the time. Bullets fly outwards, so that waves go through threads that are taut here and there,
as in any capture; or the net flies as a whole, and no thread ever is. A step of the latter takes two thirds
of the time, so that shares are larger. Lines and thrusters pull so little that nearly the same threads are
taut with them and without, each of which costs. Runs go through the same window of time again and again, with
and without by turns; processor time, so that other programs disturb less. Writes benchmarks/script.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import time
from pathlib import Path

from exunet.case.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

HERE = Path(__file__).parent
CASES = HERE.parent / "cases" / "missions"
SCENE = (
    "engine.loop=compiled",
    'solver={method="RK44", step=1e-4}',
    "net.size=5.0",
    "net.mesh=0.25",
    "bodies.box.position=[0.0, 0.0, 50.0]",
)
OPENS = ("initial.velocity=[0.0, 0.0, 0.0]", "launch={radial_speed=2.0, axial_speed=2.0}")
LINE = ("closing.linear_density=1e-9", "closing.winch.shortest=2.0", "closing.winch.commands=[]")
SLACK = (*LINE, "closing.length=21.0")
TAUT = (*LINE, "closing.length=18.9", "closing.stiffness=1e-8")  # by 4 % along the edge, 19.6 m at the start
THRUSTERS = (
    "bullets=[0, 1, 2, 3]",
    'kind="point"',
    'body="box"',
    "offset=[0.0, 0.0, 0.45]",
    "stiffness=1.0",
    "damping=0.3",
    "largest_thrust=1e-10",
    "minimum_impulse=1e-14",
    "specific_impulse=60.0",
    "noise={position=0.005, velocity=0.005, seed=7}",
)
PERIOD = 0.02  # [s] of cases/missions/drift_controlled.toml
BEGIN, END = 0.12, 0.18  # [s] between which steps are timed
OPEN = ("time > 99", "first_contact", "touching > 1000", "mouth_diameter < 0.1", "largest_area")
OPEN += ("range < 0.1", "relative_speed > 1e3")
MISSION = ("first_contact", "mouth_diameter < 0.1", "closing_tension > 1e6")

Ready = tuple[Simulation, Snapshot]


def ready(
    *conditions: str, opens: bool = True, line: tuple[str, ...] = (), period: float | None = None
) -> Ready:
    """A scene at the begin of the window.

    conditions : that a script waits for; line : keys of a closing line; period : of four controllers [s]
    """
    tables = [f'{{name="e{k}", when="{one}", do="note"}}' for k, one in enumerate(conditions)]
    tables = [one.replace("do=", "fall=0.9, do=") if "largest_area" in one else one for one in tables]
    case = CASES / ("closed_box.toml" if line else "open_box.toml")
    overrides = [*SCENE, *(OPENS if opens else ()), *line, f"script=[{', '.join(tables)}]"]
    if period is not None:
        overrides.append(f"control={{{', '.join(THRUSTERS)}, period={period}}}")
    simulation = Simulation(prepare(load(case, overrides).scene))
    simulation.advance_to(BEGIN)
    return simulation, simulation.snapshot()


def of_step(scene: Ready) -> float:
    """Processor time of a step in the window [us]."""
    simulation, begin = scene
    simulation.restore(begin)
    before, began = simulation.counts.steps, time.process_time()
    simulation.advance_to(END)
    return 1e6 * (time.process_time() - began) / (simulation.counts.steps - before)


def rows() -> dict[str, tuple[Ready, Ready]]:
    """What is measured: scenes without and with it."""
    opening, flying, closed = ready(), ready(opens=False), ready(line=TAUT)
    found = {f"`{one}`": (opening, ready(one)) for one in OPEN}
    found["`closing_tension > 1e6`, over a line"] = closed, ready("closing_tension > 1e6", line=TAUT)
    for period in (0.1, PERIOD):
        found[f"four controllers, every {period:g} s"] = opening, ready(period=period)
    words = "a script of " + ", ".join(f"`{one}`" for one in MISSION)
    together = f"taut line, {words}, four controllers every {PERIOD:g} s: together"
    for bare, opens, where in ((opening, True, ""), (flying, False, " (no thread taut)")):
        found[f"a line that is slack{where}"] = bare, ready(opens=opens, line=SLACK)
        found[f"a line that is taut{where}"] = bare, ready(opens=opens, line=TAUT)
        found[f"{together}{where}"] = bare, ready(*MISSION, opens=opens, line=TAUT, period=PERIOD)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=40)
    asked = parser.parse_args()
    scenes, load_before = rows(), os.getloadavg()[0]
    table = []
    for name, pair in scenes.items():
        of_step(pair[0]), of_step(pair[1])  # fills the caches
        rounds = []
        for turn in range(asked.repeats):
            both = [of_step(one) for one in (pair[::-1] if turn % 2 else pair)]
            rounds.append(both[::-1] if turn % 2 else both)
        bare, more = (min(part) for part in zip(*rounds, strict=True))
        low, share, high = statistics.quantiles([one[1] / one[0] - 1.0 for one in rounds], n=4)
        least = more / bare - 1.0
        table.append(
            f"| {name} | {bare:.1f} | {more:.1f} | {least:+.1%} | {share:+.1%} | {low:+.1%} to {high:+.1%} |"
        )
        sys.stdout.write(table[-1] + "\n")
        sys.stdout.flush()
    words = (
        "# What a script, a closing line and controllers add to a step",
        "",
        f"`python benchmarks/script.py --repeats {asked.repeats}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}, load average "
        f"{load_before:.1f} before and {os.getloadavg()[0]:.1f} after. Processor time of RK44 steps of the "
        f"compiled loop between {BEGIN} and {END} s, in a net of 20 x 20 meshes with contact and material "
        "damping, with something and without it by turns; scripts wait for what never comes. The bullets fly "
        "outwards at 2 m/s, and some threads are taut; or none ever is, where so told. Shares: of the least "
        "times, and the median of the ratios of neighbours, each less 1; less than 15 % is meant for a "
        "script, a line and four controllers together.",
        "",
        "| it has | without, least [us] | with, least [us] | share of least | median share | quartiles |",
        "|---|---|---|---|---|---|",
        *table,
    )
    (HERE / "script.md").write_text("\n".join(words) + "\n")


if __name__ == "__main__":
    main()
