"""Figures for a paper, of one column and of two: python examples/figures_for_a_paper.py RESULT FOLDER

RESULT is a folder of `exunet run`, or its result.h5. Figures of the same names in FOLDER are replaced, so
that the script can run again after each change: let FOLDER be one that holds nothing else.
"""

from __future__ import annotations

import sys
from pathlib import Path

import exunet


def main(result: str, folder: str) -> list[Path]:
    """Write the figures; return their paths."""
    run = exunet.load_result(result)
    # All figures for a column of 85 mm; without a title, which belongs in the caption.
    written = exunet.save_figures(run, folder, format="pdf", width=85, overwrite=True)
    # One figure across two columns, with an axis of its own.
    figure = exunet.figure(run, "largest_tension", width=170)
    figure.axes[0].set_xlim(0.0, run.time[-1])
    wide = Path(folder) / "largest_tension_wide.svg"
    figure.savefig(wide)
    print(*written, wide, sep="\n")
    return [*written, wide]


if __name__ == "__main__":
    main(*sys.argv[1:3])
