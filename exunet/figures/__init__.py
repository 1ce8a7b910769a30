"""Figures of a result: the paper's Figs. 3 to 6, the opened area, and the agreement of two codes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from exunet.base.files import cannot_write, replacing
from exunet.results.agreement import Agreement
from exunet.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(result: Result, agreement: Agreement | None = None) -> dict[str, Figure]:
    """The figures of a result that has what they show, by name.

    Always there  : reference_net, snapshots, energies
    With bullets  : bullet_speeds
    With openings : area (a mouth or mesh openings that have an area in the reference configuration)
    With a body   : rotation (a rigid one)
    If given      : agreement; the reference's speeds are then drawn in bullet_speeds too
    """
    from exunet.figures import curves, nets
    from exunet.figures.style import drawing

    with drawing():
        drawn = {
            "reference_net": nets.reference_net(result),
            "snapshots": nets.snapshots(result),
            "bullet_speeds": curves.bullet_speeds(result, agreement),
            "energies": curves.energies(result),
            "area": curves.area(result),
            "rotation": curves.rotation(result),
            "agreement": curves.agreement(result, agreement) if agreement is not None else None,
        }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def save_figures(result: Result, folder: str | Path, agreement: Agreement | None = None) -> list[Path]:
    """Write each figure as NAME.png in `folder`, which is made if it is not there; the paths of the files.

    Each file appears whole or not at all. Raises InputError if the folder or a file cannot be written.
    """
    from exunet.figures.style import drawing

    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise cannot_write(folder, error) from error
    paths = []
    for name, figure in figures(result, agreement).items():
        path = folder / f"{name}.png"
        with replacing(path) as part, drawing():
            figure.savefig(part, format="png")
        paths.append(path)
    return paths
