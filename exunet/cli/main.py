"""The `exunet` command: the arguments of its commands, and exit codes for their errors.

Exit codes: 0 done, 1 a check of `verify` failed (or a defect of exunet), 2 wrong input (nothing is written),
3 a run that stopped (its part is kept), 4 a run that `--check` could not check (its result is written),
130 interrupted, 141 the pipe of stdout is closed.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from exunet.base.errors import CaseWarning, ExunetError, InputError
from exunet.base.version import VERSION
from exunet.cli.output import (
    BackendOption,
    CasePath,
    Overrides,
    Overwrite,
    Quiet,
    ResultPath,
    as_case,
    as_options,
    as_path,
    ensemble_option,
    file_option,
    finite,
    on_backend,
    out_option,
    report,
    silent,
)
from exunet.kernels.compile import reported_compilation

CLOSED_PIPE = 141  # 128 + 13, the number of SIGPIPE

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"exunet {VERSION}")
        raise typer.Exit


@app.callback()
def exunet(
    version: Annotated[
        bool,
        typer.Option("--version", help="print the version and exit", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    """Simulate deployable cable nets."""


@app.command("run")
def run_command(
    case: CasePath,
    out: Annotated[Path | None, out_option("results/CASE, or results/CASE-2 ... if that is there")] = None,
    overwrite: Overwrite = False,
    overrides: Overrides = [],  # noqa: B006 - typer reads the default and makes its own list
    backend: BackendOption = None,
    check: Annotated[bool, typer.Option("--check", help="also run reference_impl and compare")] = False,
    estimate: Annotated[
        bool, typer.Option("--estimate-error", help="also estimate the error, from two more runs")
    ] = False,
    checkpoint_every: Annotated[
        float | None,
        typer.Option(
            help="simulated time between two checkpoints [s] (default: one every 30 s of wall time)",
            metavar="S",
        ),
    ] = None,
    ensemble: Annotated[int | None, ensemble_option("32, or 8 of a long run")] = None,
    divisions: Annotated[
        bool | None,
        typer.Option(
            "--divisions/--no-divisions",
            help="also repeat perturbed runs with twice the elements on each thread "
            "(default: where 32 perturbed runs follow)",
            show_default=False,
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Simulate a case.

    Writes result.h5, summary.json and figures, and prints the answer: outcome, loads, what limits trust.
    """
    from exunet.cli.run import RunOptions, run_case
    from exunet.scene.casefile import load

    options = RunOptions(out, overwrite, check, estimate, checkpoint_every, quiet, ensemble, divisions)
    if stopped := run_case(load(case, on_backend(overrides, backend)), options):
        raise stopped


@app.command("ensemble")
def ensemble_command(
    case: CasePath,
    runs: Annotated[int, typer.Option("-n", "--runs", help="number of runs", metavar="N")] = 1000,
    perturb: Annotated[
        float, typer.Option(help="largest perturbation of each initial coordinate [m]", metavar="M")
    ] = 1e-9,
    seed: Annotated[
        int | None,
        typer.Option(help="seed of the perturbations (default: the case's, or 0)", metavar="S"),
    ] = None,
    out: Annotated[Path | None, out_option("results/CASE--ensemble, or the next that is free")] = None,
    overwrite: Overwrite = False,
    overrides: Overrides = [],  # noqa: B006
    quiet: Quiet = False,
) -> None:
    """Run a case many times, each run perturbed a little.

    Writes ensemble.h5 and figures, and prints medians and ranges.
    """
    from exunet.cli.ensemble import EnsembleOptions, run_ensemble_case
    from exunet.scene.casefile import load, located_faults

    loaded = load(case, overrides)
    with located_faults(loaded):
        stopped = run_ensemble_case(loaded, EnsembleOptions(runs, perturb, seed, out, overwrite, quiet))
    if stopped:
        raise stopped


@app.command("study")
def study_command(
    path: Annotated[
        Path, typer.Argument(help="study file (TOML), or a study's folder", metavar="FILE", parser=as_path)
    ],
    out: Annotated[Path | None, out_option("results/FILE; a study that is there goes on")] = None,
    workers: Annotated[
        int | None, typer.Option(help="processes (default: one for each core)", metavar="N", min=1)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="address or file of a Dask scheduler, whose workers compute", metavar="ADDRESS"),
    ] = None,
    shard: Annotated[
        str | None, typer.Option(help="only each Nth row from K on, for arrays of batch jobs", metavar="K/N")
    ] = None,
    runs: Annotated[
        int | None, typer.Option("-n", "--runs", help="number of samples", metavar="N", min=1)
    ] = None,
    dry: Annotated[bool, typer.Option("--dry", help="validate, print the design, run nothing")] = False,
    run: Annotated[
        int | None,
        typer.Option("--run", help="compute the full result of this run of a folder", metavar="K", min=0),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Run a case for many samples of its keys.

    Writes study.sqlite, table.csv, figures and report.html, and prints probabilities, quantiles, drivers and
    what [optimise] has found. The same command goes on with a study that was interrupted.
    """
    from exunet.cli.study import run_of_study, run_study

    if run is None:
        run_study(path, out, workers, scheduler, shard, runs, dry=dry, quiet=quiet)
    elif stopped := run_of_study(path, run, quiet=quiet):
        raise stopped


@app.command("resume")
def resume_command(
    folder: Annotated[
        Path, typer.Argument(help="folder of an unfinished run or study", metavar="FOLDER", parser=as_path)
    ],
    ensemble: Annotated[int | None, ensemble_option("that of the run")] = None,
    quiet: Quiet = False,
) -> None:
    """Continue a run that was killed, from its last checkpoint, or a study from its last row.

    The result is the same to the last bit as without the interruption. The options of the run hold, but for
    --quiet.
    """
    if any(folder.glob("study*.sqlite")):
        from exunet.cli.study import run_study

        run_study(folder, quiet=quiet)
        return
    from exunet.cli.run import resume_run

    if stopped := resume_run(folder, quiet=quiet, runs=ensemble):
        raise stopped


@app.command("cases")
def cases_command() -> None:
    """List the shipped cases, which commands find by these names."""
    from exunet.base.cases import first_lines
    from exunet.cli.output import print_table

    print_table("Shipped cases", list(first_lines()))


@app.command("new")
def new_command(
    kind: Annotated[str, typer.Argument(help="deployment or capture", metavar="KIND")],
    target: Annotated[
        Path | None,
        typer.Argument(
            help="mesh of the target of a capture, STL, OBJ or GLB (default: a box of 1 m)",
            metavar="[TARGET]",
            parser=as_path,
        ),
    ] = None,
    unit: Annotated[str, typer.Option(help="unit of the mesh: m, cm, mm or inch", metavar="UNIT")] = "m",
    out: Annotated[Path | None, file_option("KIND.toml")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a commented case that runs, scaled to its target.

    A capture begins with an open net in front of the target; nothing closes it yet.
    """
    from exunet.cli.new import new_case

    typer.echo(new_case(kind, target, unit, out or Path(f"{kind}.toml"), overwrite=overwrite))


@app.command("check")
def check_command(
    case: CasePath,
    every: Annotated[bool, typer.Option("--all", help="bodies, tethers, script and packing too")] = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Validate a case: what is implausible in it, and what would be simulated at which cost."""
    from exunet.cli.check import check
    from exunet.scene.casefile import load

    check(load(case, overrides), every=every)


@app.command("show")
def show_command(
    result: ResultPath,
    every: Annotated[bool, typer.Option("--all", help="all metrics, masses, counts and notes")] = False,
) -> None:
    """Print the answer of a run or a study again: outcome, loads, what limits trust."""
    if any(result.glob("study*.sqlite")):
        from exunet.cli.study import show_study

        show_study(result)
        return
    from exunet.cli.run import show

    show(result, every=every)


@app.command("effects")
def effects_command(
    case: CasePath,
    accuracy: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            callback=finite,
            metavar="X",
            help="displacement that matters, relative to the size of the net (default: effects.threshold, "
            "or 0.01)",
        ),
    ] = None,
    measure: Annotated[
        bool, typer.Option("--ablate", help="also run the case with each effect switched on or off")
    ] = False,
    every: Annotated[
        bool, typer.Option("--all", help="also effects that hardly matter, and how each is estimated")
    ] = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Print the effects that matter in a case.

    For each: on or off, its size, advice, and its cost.
    """
    from exunet.cli.effects import show_effects
    from exunet.scene.casefile import load, located_faults

    loaded = load(case, overrides)
    with located_faults(loaded):
        show_effects(loaded, asked=accuracy, measure=measure, every=every)


@app.command("schema")
def schema_command(
    as_json: Annotated[bool, typer.Option("--json", help="only the JSON Schema")] = False,
    template: Annotated[bool, typer.Option("--template", help="only the commented template case")] = False,
) -> None:
    """Print the case format.

    A commented template and a JSON Schema.
    """
    from exunet.scene import template as case_format

    if as_json and template:
        raise InputError("--json, --template: give one of them, or neither for both")
    if not as_json:
        typer.echo(case_format.template().rstrip())
    if not (as_json or template):
        typer.echo("\n# JSON Schema of this format (exunet schema --json prints it alone):")
    if not template:
        text = json.dumps(case_format.json_schema(), indent=2)
        typer.echo(text if as_json else "\n".join(f"# {line}" for line in text.splitlines()))


@app.command("verify")
def verify_command(
    cases: Annotated[
        list[Path] | None,
        typer.Argument(help="case files (default: the shipped ones)", metavar="CASE", parser=as_case),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="random states and short answers only")] = False,
    hard: Annotated[
        bool, typer.Option("--hard", help="the hard cases; with --quick in the compiled loop only")
    ] = False,
    processes: Annotated[
        int | None,
        typer.Option(help="processes at the same time (default: one for each core)", metavar="N", min=1),
    ] = None,
    out: Annotated[Path | None, out_option("results/verification, or results/hard")] = None,
) -> None:
    """Compare both codes with each other and with known answers.

    Writes report.html, with figures; with --hard of the hard cases instead.
    """
    if hard:
        from exunet.cli.verify import verify_hard

        if cases:
            raise InputError("--hard does not take cases")
        raise typer.Exit(verify_hard(out or Path("results/hard"), quick=quick, processes=processes))
    from exunet.cli.verify import verify

    raise typer.Exit(
        verify(cases or [], out or Path("results/verification"), quick=quick, processes=processes)
    )


@app.command("cost")
def cost_command(
    case: CasePath,
    until: Annotated[
        float | None, typer.Option(help="end of the runs [s] (default: the case's)", metavar="T")
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(help="wall time of all runs [s] (default: 120; a capture 300)", metavar="S"),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(
            "--runs",
            "-n",
            help="perturbed runs of each setting whose metrics are compared (default: 32)",
            metavar="N",
            min=2,
        ),
    ] = None,
    out: Annotated[Path | None, out_option("results/CASE--cost, or the next that is free")] = None,
    overwrite: Overwrite = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Measure what accuracy costs on a case.

    A deployment varies method, step, tolerance and backend; a capture step, divisions and
    backend. Prints wall times for errors or metrics; writes tables and a figure.
    """
    from exunet.cli.cost import cost
    from exunet.scene.casefile import load, located_faults

    loaded = load(case, overrides)
    with located_faults(loaded):
        code = cost(loaded, out, until, budget, runs, overwrite=overwrite)
    raise typer.Exit(code)


@app.command("compare")
def compare_command(
    a: Annotated[
        Path, typer.Argument(help="result, ensemble or study, or its folder", metavar="A", parser=as_path)
    ],
    b: Annotated[
        Path, typer.Argument(help="result, ensemble or study, or its folder", metavar="B", parser=as_path)
    ],
    every: Annotated[bool, typer.Option("--all", help="all metrics")] = False,
) -> None:
    """Print the differences of two designs: keys of the case, metrics, states.

    States are compared at the times that both store, of runs of the same net. compare.png beside A has areas,
    largest tensions and mouths of both over time.
    """
    if all(any(path.glob("study*.sqlite")) for path in (a, b)):
        from exunet.cli.study import compare_studies

        compare_studies(a, b)
        return
    from exunet.cli.compare import compare_designs

    if path := compare_designs(a, b, every=every):
        typer.echo(path)


@app.command("plot")
def plot_command(
    result: ResultPath,
    out: Annotated[Path | None, out_option("that of the result")] = None,
    kind: Annotated[str, typer.Option("--format", help="png, pdf or svg", metavar="FORMAT")] = "png",
    width: Annotated[float, typer.Option(help="width of each figure [mm]: 85 or 170", metavar="MM")] = 170.0,
    names: Annotated[
        list[str] | None,
        typer.Option("--figure", help="figure to draw; may be repeated (default: all)", metavar="NAME"),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw the figures of a result or a study.

    With ensemble.h5 beside the result, ranges of the perturbed runs too.
    """
    from exunet.cli.plot import plot

    for path in plot(result, out, kind, width, names, overwrite=overwrite):
        typer.echo(path)


@app.command("view")
def view_command(
    result: ResultPath,
    other: Annotated[
        Path | None,
        typer.Argument(help="a second result, shown beside the first", metavar="[B]", parser=as_path),
    ] = None,
    out: Annotated[Path | None, file_option("view.html beside the result")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write an HTML page that shows a result in 3-D.

    It opens in a browser without a network: orbit, time bar, plots, distances.
    """
    from exunet.cli.view import view

    typer.echo(view(result, other, out, overwrite=overwrite))


@app.command("export")
def export_command(
    result: ResultPath,
    kind: Annotated[
        str, typer.Option("--to", help="vtkhdf: states, for ParaView; csv: time series", metavar="FORMAT")
    ],
    out: Annotated[Path | None, file_option("beside the result")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Export a result for other programs."""
    from exunet.cli.export import export_result

    typer.echo(export_result(result, kind, out, overwrite=overwrite))


@app.command("animate")
def animate_command(
    result: ResultPath,
    out: Annotated[Path | None, file_option("animation.mp4 beside the result, .gif without ffmpeg")] = None,
    fps: Annotated[float, typer.Option("--fps", help="frames a second", metavar="N")] = 25.0,
    begin: Annotated[
        float | None, typer.Option("--from", help="first time [s] (default: the first stored)", metavar="T")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--until", help="last time [s] (default: the last stored)", metavar="T")
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Animate a result, as GIF or MP4.

    A frame for each stored time, at most 300, evenly spaced.
    """
    from exunet.cli.animate import animate

    typer.echo(animate(result, out, fps, begin, end, overwrite=overwrite, quiet=quiet))


@app.command("fmu")
def fmu_command(
    case: CasePath,
    out: Annotated[Path | None, file_option("CASE.fmu")] = None,
    fmi: Annotated[int, typer.Option("--fmi", help="version of FMI, 2 or 3", metavar="N")] = 3,
    overwrite: Overwrite = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Export a case as an FMU for co-simulation.

    A host that supports FMI steps the net. Its machine needs a Python with exunet.
    """
    from exunet.coupling.fmu.export import export_fmu
    from exunet.scene.casefile import load

    loaded = load(case, overrides)
    with as_options("fmi"):
        path = export_fmu(loaded, out or Path(f"{loaded.name}.fmu"), fmi=fmi, overwrite=overwrite)
    typer.echo(path)


def main() -> None:
    """Run the command; errors become a line on stderr each and an exit code, never a traceback."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed before the start, as by >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a title may have letters that the terminal lacks
    try:
        say = silent if "--quiet" in sys.argv else report
        with reported_compilation(say), warnings.catch_warnings():
            warnings.simplefilter("always", CaseWarning)
            warnings.showwarning = _shown_by(say, warnings.showwarning)
            app(prog_name="exunet")
    except ExunetError as error:
        _leave(str(error), error.exit_code)
    except KeyboardInterrupt:
        _leave("interrupted", 130)
    except ImportError as error:
        if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise
        _leave("interrupted", 130)  # while a library was loaded, which raises its own error for Ctrl-C
    except SystemExit as done:
        if done.code == 130:  # typer reports nothing on Ctrl-C
            _leave("interrupted", 130)
        if isinstance(done.__context__, BrokenPipeError):  # typer and rich end so then
            _leave_closed_pipe()
        try:
            sys.stdout.flush()
        except BrokenPipeError:
            _leave_closed_pipe()
        raise
    except BrokenPipeError:
        _leave_closed_pipe()
    except OSError as error:
        reason = error.strerror or error
        if error.filename is not None:
            _leave(f"{error.filename}: {reason}", 2)
        sys.stdout = None  # the terminal or a pipe: nothing more to flush when the interpreter ends
        _leave(f"cannot print: {reason}", 2)


def _shown_by(say: Callable[[str], None], other: Callable[..., None]) -> Callable[..., None]:
    """Return what prints warnings of cases in a line, and others as before."""

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, CaseWarning):
            say(f"warning: {message}")
        else:
            other(message, category, *place, **more)

    return show


def _leave(message: str, code: int) -> NoReturn:
    report(message)
    sys.exit(code)


def _leave_closed_pipe() -> NoReturn:
    """End as a program that SIGPIPE ends, as with `| head`: that is no error."""
    with suppress(OSError, ValueError):  # what is still to be flushed must not fail when the interpreter ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(CLOSED_PIPE)
