"""Whether the outcome of each shipped capture stays: other steps, stiffnesses of contact, perturbed runs.

    python benchmarks/verdicts.py [--only NAME] [--runs 20]

Each case with its step, half and a quarter of it; with contact twice as stiff (half of the step, since its
damping bounds the step by its rate) and half as stiff (the same step, since the net bounds it too); and from
perturbed runs: by up to 1e-9 m in the captures, by up to 1e-6 m in those whose mouth is closed. Of the
perturbed runs one in four has half of the step. A marginal scene stands beside the closed box: its line is
pulled 0.1 s later. All in the compiled loop, on all cores; an hour and more. Writes verdicts.md, row by row,
so that what is done survives Ctrl-C; `--only` writes nothing.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Sequence
from pathlib import Path

import exunet
from exunet.results.observables import Observables
from exunet.results.outcome import outcome
from exunet.scene.casefile import Case, load
from exunet.studies.cost.settings import step_factor, stiffer

HERE = Path(__file__).parent
CASES = HERE.parent / "cases"
LATER = "closing.winch.commands=[{at=0.3,mode='tension',force=2.5},{at=1.5,mode='lock'}]"
SCENES: dict[str, tuple[str, tuple[str, ...], float]] = {
    **{path.stem: (f"capture/{path.name}", (), 1e-9) for path in sorted((CASES / "capture").glob("*.toml"))},
    "closed_box": ("missions/closed_box.toml", (), 1e-6),
    "closed_box, 0.1 s later": ("missions/closed_box.toml", (LATER,), 1e-6),
    "open_box": ("missions/open_box.toml", (), 1e-6),
    "throw_close_tow": ("missions/throw_close_tow.toml", (), 1e-6),
}  # name: file, what is set otherwise, by how much starts are moved [m]
HEAD = (
    "| case | as it is | step / 2 | step / 4 | stiffness x 2 | stiffness / 2 | moved by [m] | outcomes |\n"
    "|---|---|---|---|---|---|---|---|"
)


def with_stiffness(case: Case, factor: float) -> list[str]:
    """What makes contact stiffer by a factor, the step following."""
    assert case.scene.solver.step is not None
    return [*stiffer(case, factor), f"solver.step={case.scene.solver.step * step_factor(factor)!r}"]


def one(path: Path, settings: Sequence[str]) -> str:
    """What comes of a case with these settings; a run that stops says so."""
    try:
        found = outcome(Observables(exunet.run(load(path, list(settings)))))
    except exunet.RunStopped as stop:
        return f"stopped: {stop}".split("\n")[0][:60]
    return "no rule" if found is None else found.outcome.value


def row(name: str, runs: int) -> str:
    """A row of the table."""
    file, settings, move = SCENES[name]
    path, common = CASES / file, [*settings, "engine.backend=compiled"]
    case = load(path, common)
    step = case.scene.solver.step
    assert step is not None
    singles = [
        one(path, [*common, *changed])
        for changed in (
            (),
            (f"solver.step={step / 2!r}",),
            (f"solver.step={step / 4!r}",),
            with_stiffness(case, 2.0),
            with_stiffness(case, 0.5),
        )
    ]
    counts = exunet.ensemble(case, runs, move).run.outcomes
    ended = ", ".join(f"{key} {count}" for key, count in counts.items())
    return "| " + " | ".join([name, *singles, f"{move:g}", f"{ended} of {runs}"]) + " |"


def main() -> None:
    """Run the cases of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=SCENES)
    parser.add_argument("--runs", type=int, default=20)
    options = parser.parse_args()
    lines = []
    for name in [options.only] if options.only else SCENES:
        lines.append(row(name, options.runs))
        print(lines[-1], flush=True)  # noqa: T201
        if not options.only:
            about = f"{platform.platform()}, {os.cpu_count()} cores, exunet {exunet.__version__}"
            text = [
                "# Whether outcomes of captures stay",
                "",
                f"`python benchmarks/verdicts.py`, {about}",
                "",
            ]
            (HERE / "verdicts.md").write_text("\n".join([*text, HEAD, *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
