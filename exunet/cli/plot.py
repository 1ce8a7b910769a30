"""`exunet plot`: draw the figures of a result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exunet.cli.output import as_options, opened, report
from exunet.plots.registry import FIGURES, save_figures
from exunet.results.io import RESULT_FILE, load_result
from exunet.results.run_folder import refuse_replacing, unfinished


def plot(
    path: Path,
    out: Path | None,
    kind: str,
    width: float,
    names: Sequence[str] | None,
    *,
    overwrite: bool,
) -> list[Path]:
    """Draw a result with its perturbed runs; return the paths of the figures.

    Figures in the folder of the result are replaced; in any other folder they may show another result.

    Parameters
    ----------
    path : Path
        The result, or its folder.
    out : Path or None
        Folder of the figures; None: that of the result.
    kind : str
        "png", "pdf" or "svg".
    width : float
        85 or 170 [mm].
    names : sequence of str or None
        Figures to draw; None: all that apply.
    overwrite : bool
        Replace figures in a folder that is not the result's own.

    Raises
    ------
    InputError
        For a result that cannot be read, another kind, width or name, or figures that would be replaced.
    FigureError
        If a figure cannot be drawn; the others are written.
    """
    if any(path.glob("study*.sqlite")):
        return _plot_study(
            path, out or path / "figures", kind, width, names, overwrite=overwrite or out is None
        )
    own = path if path.is_dir() else path.parent
    folder = out or own
    if words := unfinished(path):
        report(words)
    result = load_result(path)
    shows_own = (path.is_dir() or path.name == RESULT_FILE) and folder.resolve() == own.resolve()
    if not (shows_own or overwrite):
        refuse_replacing(folder, [f"{name}.{kind}" for name in names or FIGURES])
    with opened(folder, own=False), as_options("format", "figure", "width"):
        return save_figures(result, folder, names=names, format=kind, width=width, overwrite=True)


def _plot_study(
    path: Path, out: Path, kind: str, width: float, names: Sequence[str] | None, *, overwrite: bool
) -> list[Path]:
    from exunet.studies.report import study_data
    from exunet.studies.study import StudyTable

    data = study_data(StudyTable(path))
    with opened(out, own=False), as_options("format", "figure", "width"):
        return save_figures(data, out, names=names, format=kind, width=width, overwrite=overwrite)
