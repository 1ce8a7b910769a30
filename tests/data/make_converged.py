"""Converged bullet speeds of tests/physics/test_methods.py; python tests/data/make_converged.py [NAME ...]

Each file in tests/data/auto/ holds a case with changes, an end time, the speeds there, how certain they are,
and how they were computed: exunet's compiled Dormand-Prince loop and the reference's DOP853, each at two
tolerances.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import exunet
from exunet.studies.both_codes import both_of
from exunet.studies.cost.runs import Subject
from exunet.studies.cost.study import converge

HERE = Path(__file__).parent
CASES = HERE.parent.parent / "cases"
UNDAMPED, DAMPED = "planar_undamped.toml", "planar_deployment.toml"
# name: (case, changes, end [s])
# Ends are late enough for the speeds to depend on what was changed.
SCENES = {
    "mesh_4": (UNDAMPED, ["net.mesh=1.25"], 1.3),
    "mesh_7": (UNDAMPED, ["net.size=7.0"], 2.1),
    "packing_0.15": (UNDAMPED, ["initial.packing=0.15"], 1.2),
    "packing_0.05": (DAMPED, ["initial.packing=0.05"], 1.2),
    "packing_0.6": (UNDAMPED, ["initial.packing=0.6"], 0.65),
    "packing_0.85": (UNDAMPED, ["initial.packing=0.85"], 0.3),
    "packing_0.88": (UNDAMPED, ["initial.packing=0.88"], 0.2),
    "packing_0.98": (UNDAMPED, ["initial.packing=0.98"], 0.23),
    "slow": (UNDAMPED, ["launch.radial_speed=1.0"], 3.3),
    "fast": (UNDAMPED, ["launch.radial_speed=6.0"], 0.6),
    "out_of_plane": (UNDAMPED, ["launch.axial_speed=2.0", "initial.spin=[0.3, 0.1, 0.5]"], 0.8),
    "damped": (DAMPED, ["effects.rayleigh_damping.alpha=0.5", "effects.rayleigh_damping.beta=1e-6"], 1.6),
    "material_damping": (UNDAMPED, ["effects.material_damping.relaxation_time=1e-5"], 1.0),
    "stiff_strings": (UNDAMPED, ["net.strings.youngs_modulus=1e12"], 1.5),
    "divided": (UNDAMPED, ["net.divisions=3"], 0.7),
    "rectangular": (
        UNDAMPED,
        [
            'net.topology="rectangular"',
            "net.size=[4.0, 6.0]",
            "net.mesh=[1.0, 1.0]",
            "launch.axial_speed=1.0",
        ],
        0.9,
    ),
}


def main(names: list[str]) -> None:
    for name in names or SCENES:
        file, changes, end = SCENES[name]
        case = exunet.load(CASES / file, changes)
        subject = Subject.of(case, (0.0, end), both_of(case))
        found = converge(subject)
        text = [
            "# Written by tests/data/make_converged.py; errors relative to the launch speed.",
            *(f"# {words}" for words in found.notes),
            f'case = "{file}"',
            f"changes = {json.dumps(changes)}",
            f"end = {end!r}  # s",
            f"launch_speed = {subject.speed!r}  # m/s",
            f"uncertainty = {found.uncertainty:.2e}",
            f"speeds = {found.speeds.tolist()!r}  # m/s, of the bullets",
        ]
        (HERE / "auto" / f"{name}.toml").write_text("\n".join(text) + "\n", encoding="utf-8")
        sys.stdout.write(
            f"{name}: {found.uncertainty:.1e}, sensitivity {found.sensitivity:.1e}, {found.speeds}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
