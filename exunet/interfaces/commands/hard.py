"""`exunet verify --hard`: the gallery of hard cases, told check by check."""

from __future__ import annotations

from pathlib import Path

from exunet.interfaces.commands.verify import FAILED, INTERRUPTED, plain_console, show
from exunet.verification.check import Check
from exunet.verification.gallery import ITEMS
from exunet.verification.hard import checks
from exunet.verification.hard_report import NAME, write_report
from exunet.verification.report import make_folder, verdict


def verify_hard(folder: Path, *, quick: bool) -> int:
    """Run the gallery, write hard.md into a folder; returns the exit code.

    0 if all checks hold, 1 if one fails, 130 if interrupted (what was done is in the report). Raises
    InputError before anything runs if the folder cannot be written.
    """
    make_folder(folder, NAME)
    done: list[Check] = []
    console = plain_console()
    interrupted = False
    try:
        for check in checks(quick=quick):
            if not done or done[-1].rung != check.rung:
                console.print(f"\n{check.rung}. {ITEMS[check.rung]}")
                console.print(
                    f"{'case':28s} {'check':52s} {'measured':>10s} {'allowed':>8s}  verdict    unit"
                )
            done.append(check)
            show(check, console, width=28)
    except KeyboardInterrupt:
        interrupted = True
    report = write_report(folder, done, quick=quick, interrupted=interrupted)
    console.print(f"{verdict(done, interrupted=interrupted)} Report: {report}")
    if interrupted:
        return INTERRUPTED
    return 0 if all(check.holds for check in done) else FAILED
