"""All figures by name; drawing one, and writing all that apply to a result."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from exunet.base.arguments import takes
from exunet.base.errors import FigureError, InputError
from exunet.base.files import cannot_write, path_of, replacing
from exunet.plots import balances, captures, curves, ensembles, nets, studies, tensions
from exunet.plots.studies import StudyData
from exunet.plots.style import FORMATS, PRINT, SCREEN, WIDTHS, FigureData, drawing, write
from exunet.results.comparison import Agreement
from exunet.results.ensemble import Ensemble, load_ensemble
from exunet.results.observables import Observables
from exunet.results.result import Result


class Entry(NamedTuple):
    """A figure: the function that draws it, or returns None where it does not apply; what it requires."""

    draw: Callable[..., Figure | None]
    requires: str


FIGURES = {
    "reference_net": Entry(nets.reference_net, "elements"),
    "snapshots": Entry(nets.snapshots, "a stored state"),
    "bullet_speeds": Entry(curves.bullet_speeds, "bullets in motion"),
    "energies": Entry(balances.energies, "energies that change"),
    "area": Entry(curves.area, "a mouth or meshes"),
    "tensions": Entry(tensions.tensions, "taut elements of the net"),
    "tethers": Entry(tensions.tethers, "taut tethers"),
    "largest_tension": Entry(tensions.largest_tension, "taut elements"),
    "loads": Entry(tensions.loads_on_bodies, "threads that pull on bodies"),
    "distances": Entry(curves.distances, "two bodies with shapes"),
    "rotation": Entry(curves.rotation, "a rotating rigid body"),
    "contacts": Entry(captures.contacts, "contact with a body"),
    "closing": Entry(captures.closing, "[closing], and a mouth that closes"),
    "capture": Entry(captures.capture, "[capture]"),
    "control": Entry(curves.control, "[control], and thrust"),
    "agreement": Entry(curves.agreement, "a comparison with the reference"),
}
OF_A_RUN = ("snapshots", "area", "capture", "agreement")
ENSEMBLE_FIGURES = {
    "histograms": Entry(ensembles.histograms, "metrics that differ between runs"),
    "bands": Entry(ensembles.bands, "quantities over time that are not zero"),
}
STUDY_FIGURES = {
    "distributions": Entry(studies.distributions, "a metric in [outputs], of at most 8 designs"),
    "map": Entry(studies.outcome_map, "two inputs that are numbers, and [capture] or a metric in [outputs]"),
    "drivers": Entry(studies.drivers, "20 random runs"),
    "designs": Entry(studies.designs, "designs or a grid, of at most 24 points"),
}


@takes(result=(Result, Ensemble, StudyData), name=str, agreement=Agreement, ensemble=Ensemble)
def figure(
    result: Result | Ensemble | StudyData,
    name: str,
    *,
    agreement: Agreement | None = None,
    ensemble: Ensemble | None = None,
    width: float = 170.0,
) -> Figure:
    """Draw one figure of a result, an ensemble or a study.

    Parameters
    ----------
    result : Result, Ensemble or StudyData
        What the figure shows.
    name : str
        Name of the figure: see the table.
    agreement : Agreement, optional
        Comparison with the reference, from `compare`; adds its speeds to "bullet_speeds".
    ensemble : Ensemble, optional
        Perturbed runs of the same case, from `load_ensemble` or `ensemble`: adds their ranges as bands and
        the numbers of extreme values. Default: that beside the file of the result, if any.
    width : float
        85 or 170 [mm], a column or a page of a journal.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that belongs to the caller, and that a notebook shows.

    Raises
    ------
    InputError
        For an unknown name, another width, or a result to which the figure does not apply.
    """
    table, arguments = _prepare(result, agreement, ensemble, width)
    if name not in table:
        raise InputError(f"figure: {name!r} is not one of {', '.join(table)}")
    with drawing():
        drawn = table[name].draw(*arguments)
    if drawn is None:
        raise InputError(f"figure: {name!r} requires {table[name].requires}")
    return drawn


@takes(
    result=(Result, Ensemble, StudyData),
    agreement=Agreement,
    ensemble=Ensemble,
    format=str,
    names=(list, tuple),
    overwrite=bool,
)
def save_figures(
    result: Result | Ensemble | StudyData,
    folder: str | Path,
    agreement: Agreement | None = None,
    ensemble: Ensemble | None = None,
    *,
    names: Sequence[str] | None = None,
    format: str = "png",  # noqa: A002 - as Matplotlib calls it
    width: float = 170.0,
    overwrite: bool = False,
) -> list[Path]:
    """Write the figures of a result, an ensemble or a study as NAME.FORMAT into a folder.

    The same result gives the same bytes. A figure that cannot be drawn does not prevent the others.

    Parameters
    ----------
    result, agreement, ensemble, width
        See `figure`.
    folder : str or Path
        Made if it does not exist.
    names : sequence of str, optional
        Figures to draw; default: all that apply to the result.
    format : str
        "png" (300 dots per inch), "pdf" or "svg" (text stays text).
    overwrite : bool
        Replace files of these names.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        For an unknown name or format, another width, files of these names without `overwrite` (nothing is
        written), or a folder or file that cannot be written.
    FigureError
        After the other figures are written, if one cannot be drawn, or does not apply but is named.
    """
    folder = path_of(folder, "save_figures")
    table, arguments = _prepare(result, agreement, ensemble, width)
    if format not in FORMATS:
        raise InputError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    if unknown := [name for name in names or () if name not in table]:
        raise InputError(f"figure: {unknown[0]!r} is not one of {', '.join(table)}")
    files = {name: folder / f"{name}.{format}" for name in names or table}
    if not overwrite and (taken := [path.name for path in files.values() if os.path.lexists(path)]):
        raise InputError(f"{folder}: {taken[0]} exists: choose another folder, or overwrite=True")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise cannot_write(folder, error) from error
    return _write(table, arguments, files, format, PRINT, required=names is not None)


def save_run_figures(
    run: Observables, folder: Path, agreement: Agreement | None, ensemble: Ensemble | None
) -> list[Path]:
    """Write the few figures that `exunet run` draws, of those that apply, over files of their names.

    Raises FigureError after the others are written, if one cannot be drawn.
    """
    left_out = "capture" if run.criterion is None else "area"  # "capture" shows the mouth
    files = {name: folder / f"{name}.png" for name in OF_A_RUN if name in FIGURES and name != left_out}
    source = FigureData(run.result, ensemble, agreement, known=run)
    return _write(FIGURES, (source,), files, "png", SCREEN, required=False)


def _write(
    table: dict[str, Entry],
    arguments: tuple[Any, ...],
    files: dict[str, Path],
    form: str,
    dpi: float,
    *,
    required: bool,
) -> list[Path]:
    """Draw figures into files; required : a figure that does not apply is an error."""
    written, failed = [], []
    with drawing(), warnings.catch_warnings():
        warnings.filterwarnings("error", "constrained_layout not applied")
        for name, path in files.items():  # one after the other: each figure keeps its pixels, 9 MB
            try:
                drawn = table[name].draw(*arguments)
                if drawn is not None:
                    with replacing(path) as part:
                        write(drawn, part, form, dpi)
                    written.append(path)
                elif required:
                    failed.append(f"{name} requires {table[name].requires}")
            except (UserWarning, ArithmeticError, LookupError, ValueError) as error:
                failed.append(f"{name}: {error}")
    if failed:
        raise FigureError(f"{len(failed)} of {len(files)} figures not drawn: {'; '.join(failed)}")
    return written


def _prepare(
    result: Result | Ensemble | StudyData,
    agreement: Agreement | None,
    ensemble: Ensemble | None,
    width: float,
) -> tuple[dict[str, Entry], tuple[Any, ...]]:
    """Return the figures of a result, and the arguments of the functions that draw them."""
    if width not in WIDTHS:
        raise InputError(f"width: must be {' or '.join(f'{allowed:g}' for allowed in WIDTHS)}, got {width!r}")
    if isinstance(result, Ensemble):
        return ENSEMBLE_FIGURES, (result, float(width))
    if isinstance(result, StudyData):
        return STUDY_FIGURES, (result, float(width))
    if ensemble is None and result.ensemble_file is not None:
        ensemble = load_ensemble(result.ensemble_file)
    return FIGURES, (FigureData(result, ensemble, agreement, float(width)),)
