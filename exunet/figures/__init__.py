"""The figures of a result, of an ensemble, and moving pictures."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from exunet.base.arguments import takes
from exunet.base.errors import InputError
from exunet.base.files import cannot_write, path_of, replacing
from exunet.results.agreement import Agreement
from exunet.results.ensemble_result import EnsembleResult, load_ensemble
from exunet.results.result import Result


def _import_matplotlib() -> None:
    """Import Matplotlib also where MPLBACKEND names a backend that this Python does not have.

    A notebook sets the variable for the programs that it starts. Figures here are drawn by Agg in any case.
    """
    chosen = os.environ.pop("MPLBACKEND")
    try:
        import matplotlib
    finally:
        os.environ["MPLBACKEND"] = chosen
    with suppress(ValueError):
        matplotlib.rcParams["backend"] = chosen


if "MPLBACKEND" in os.environ and "matplotlib" not in sys.modules:
    _import_matplotlib()

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from exunet.figures.page import Page

Size = tuple[float, float]

# What each shows, and of which results it can be made.
FIGURES = {
    "reference_net": "the net in its reference configuration, node numbers, dimensions; needs elements",
    "snapshots": "up to six configurations from the first stored time to the last, as the size has room",
    "bullet_speeds": "speed of each bullet over time; needs bullets",
    "energies": "changes of the energies and the dissipated work over time; error of their balance",
    "area": "mouth area and mesh area over time; needs a mouth or mesh openings",
    "tensions": "largest tension of each element over all steps, on the reference net; needs elements",
    "tethers": "largest tension over all steps along each tether; needs tethers",
    "largest_tension": "largest tension of all elements over time; needs elements",
    "momentum": "changes of momentum and angular momentum of all parts, impulses from outside; needs a body",
    "loads": "forces and torques of threads on bodies at the nodes that are fixed to them; needs such nodes",
    "distances": "distance of each two bodies with shapes, surface to surface, over time; needs two of them",
    "rotation": "angular velocity of rigid bodies over time, in body axes; needs a rigid body",
    "contacts": "what touches bodies, how many of each kind, and their forces, over time; needs contacts",
    "closing": "tension and length of a closing line, or the part left of an edge, mouth; needs [closing]",
    "capture": "what is enclosed, capture indices, relative speed, mouth over time; needs [capture]",
    "control": "mean thrust of each corner unit between stored times; needs [control]",
    "agreement": "differences between two codes over time; needs an `agreement`",
}
LEAST, MOST = 40.0, 1000.0  # mm, sides of a figure
_TALLER = 5  # mm, steps in which a height is sought that leaves room


@takes(result=Result, name=str, agreement=Agreement, spread=EnsembleResult, title=bool)
def figure(
    result: Result,
    name: str,
    *,
    agreement: Agreement | None = None,
    spread: EnsembleResult | None = None,
    size: Size | None = None,
    title: bool = False,
) -> Figure:
    """One figure of a result, as a Matplotlib figure that belongs to the caller.

    name      : one of `FIGURES`
    agreement : with another run, from `compare`; adds the other run's speeds to "bullet_speeds"
    spread    : of moved starts, from `load_ensemble` or `ensemble`; None: that beside the file that the
                result was read from, if any. It adds bands, least to largest of its runs, to "area",
                "bullet_speeds", "energies", "largest_tension", "capture", "contacts", "closing", "control",
                "rotation", "momentum" and "loads", and the numbers: without it no figure names a largest or
                least value, which one run of a chaotic net does not tell
    size      : (width, height) [mm], 40 to 1000, and enough for texts and legend; None: 170 mm wide (the nets
                less), as high as it needs
    title     : with a title above it
    Raises InputError for a name that is not known, a size out of range or too small for the figure's texts,
    or a result that has not what the figure shows.
    """
    if name not in FIGURES:
        raise InputError(f"figure: {name!r} is not one of {', '.join(FIGURES)}")
    made = _drawn((name,), result, agreement, spread, size, title)
    if name not in made:
        raise InputError(f"figure: this result cannot have {name!r}: {FIGURES[name]}")
    return made[name]


def figures(
    result: Result,
    agreement: Agreement | None = None,
    spread: EnsembleResult | None = None,
    *,
    size: Size | None = None,
    title: bool = False,
) -> dict[str, Figure]:
    """All figures that a result can have, by name; arguments and errors as of `figure`."""
    return _drawn(tuple(FIGURES), result, agreement, spread, size, title)


@takes(result=Result, agreement=Agreement, spread=EnsembleResult, format=str, title=bool, overwrite=bool)
def save_figures(
    result: Result,
    folder: str | Path,
    agreement: Agreement | None = None,
    spread: EnsembleResult | None = None,
    *,
    format: str = "png",  # noqa: A002 - as Matplotlib calls it
    size: Size | None = None,
    title: bool = False,
    overwrite: bool = False,
) -> list[Path]:
    """Write each figure as NAME.FORMAT in `folder`, which is made if it is not there; the paths of the files.

    format : "png" (300 dots per inch), "pdf" or "svg" (text stays text)
    agreement, spread, size, title : as of `figure`
    overwrite : replace files of these names, which stay as they are until the new ones are whole

    The files appear whole when all are drawn, or not at all. The same result gives the same bytes. Raises
    InputError, and writes nothing, if there is a file of a figure's name in the folder, of whatever result,
    and `overwrite` is False; for a format that is not known, a size that is out of range or leaves a figure
    no room beside its texts, or if the folder or a file cannot be written.
    """
    from exunet.figures.page import FORMATS, write

    if format not in FORMATS:
        raise InputError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    folder, size = path_of(folder, "save_figures"), None if size is None else _checked(size)
    names = [] if overwrite else [f"{name}.{format}" for name in FIGURES]
    if there := [name for name in names if os.path.lexists(folder / name)]:
        words = f"{folder}: there are figures in this folder, such as {there[0]}"
        raise InputError(f"{words}: give another, or overwrite=True")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise cannot_write(folder, error) from error
    paths = []
    with ExitStack() as parts:  # whose files all get their names at the end, or none does
        for name in FIGURES:  # one after the other: each keeps its pixels, 9 MB, as long as it lives
            for one in _drawn((name,), result, agreement, spread, size, title).values():
                path = folder / f"{name}.{format}"
                write(one, parts.enter_context(replacing(path)), format)
                paths.append(path)
    return paths


def _drawn(
    names: tuple[str, ...],
    result: Result,
    agreement: Agreement | None,
    spread: EnsembleResult | None,
    size: Size | None,
    title: bool,
) -> dict[str, Figure]:
    from exunet.figures.events import mark_events
    from exunet.figures.labels import fit_labels
    from exunet.figures.page import Page
    from exunet.figures.style import drawing

    size = None if size is None else _checked(size)
    if spread is None and result.spread_file is not None:
        spread = load_ensemble(result.spread_file)
    drawers = _drawers(agreement, spread)

    def drawn(name: str, size: Size | None) -> Figure | None:
        with drawing(), warnings.catch_warnings():
            if size is not None:  # `_is_legible` tells it in words
                warnings.filterwarnings("ignore", "constrained_layout not applied")
            made = drawers[name](result, Page(size, title))
            if made is not None and size is not None:  # its own size has room for its labels
                fit_labels(made)
            if made is not None:
                mark_events(made, result)
            return made

    made = {name: drawn(name, size) for name in names}
    for name, one in made.items():
        if size is not None and one is not None and not _is_legible(one):
            taller = ((size[0], size[1] + more) for more in range(_TALLER, int(MOST - size[1]), _TALLER))
            enough = (f"{w:g} mm x {h:g} mm" for w, h in taller if _is_legible(_there(drawn(name, (w, h)))))
            words = f"{size[0]:g} mm x {size[1]:g} mm leave {name} no room beside its texts"
            raise InputError(f"size: {words}: give {next(enough, 'more')} or more")
    return {name: one for name, one in made.items() if one is not None}


def _is_legible(figure: Figure) -> bool:
    from exunet.figures.labels import labels_overlap
    from exunet.figures.page import has_room

    return has_room(figure) and not labels_overlap(figure)


def _there(figure: Figure | None) -> Figure:
    assert figure is not None
    return figure


def _checked(size: Size) -> Size:
    try:
        width, height = (float(side) for side in size)
    except (TypeError, ValueError):
        raise InputError(f"size: must be (width, height) in millimetres, got {size!r}") from None
    if not (LEAST <= width <= MOST and LEAST <= height <= MOST):
        words = f"must be from {LEAST:g} mm to {MOST:g} mm, got {width:g} mm x {height:g} mm"
        raise InputError(f"size: width and height {words}")
    return width, height


def _drawers(
    agreement: Agreement | None, spread: EnsembleResult | None
) -> dict[str, Callable[[Result, Page], Figure | None]]:
    """What makes each figure; it returns None for a result that has not what it shows."""
    from exunet.figures import captures, closing, curves, energies, momenta, nets, tensions

    return {
        "reference_net": nets.reference_net,
        "snapshots": nets.snapshots,
        "bullet_speeds": lambda result, page: curves.bullet_speeds(result, page, agreement, spread),
        "energies": lambda result, page: energies.energies(result, page, spread),
        "area": lambda result, page: curves.area(result, page, spread),
        "tensions": lambda result, page: tensions.tensions(result, page, spread),
        "tethers": lambda result, page: tensions.tethers(result, page, spread),
        "largest_tension": lambda result, page: curves.largest_tension(result, page, spread),
        "momentum": lambda result, page: momenta.momentum(result, page, spread),
        "loads": lambda result, page: curves.loads_on_bodies(result, page, spread),
        "distances": lambda result, page: curves.distances(result, page, spread),
        "rotation": lambda result, page: curves.rotation(result, page, spread),
        "contacts": lambda result, page: captures.contacts(result, page, spread),
        "closing": lambda result, page: closing.closing(result, page, spread),
        "capture": lambda result, page: captures.capture(result, page, spread),
        "control": lambda result, page: curves.control(result, page, spread),
        "agreement": lambda result, page: (
            None if agreement is None else curves.agreement(result, page, agreement)
        ),
    }
