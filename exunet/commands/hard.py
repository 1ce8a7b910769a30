"""`exunet verify --hard`: the gallery of hard cases, told check by check."""

from __future__ import annotations

from exunet.commands.verify import FAILED, INTERRUPTED, plain_console, show
from exunet.verify.check import Check
from exunet.verify.gallery import ITEMS
from exunet.verify.hard import checks
from exunet.verify.report import verdict


def verify_hard(*, quick: bool) -> int:
    """Run the gallery; returns the exit code: 0 if all checks hold, 1 if one fails, 130 if interrupted."""
    done: list[Check] = []
    console = plain_console()
    interrupted = False
    try:
        for check in checks(quick=quick):
            if not done or done[-1].rung != check.rung:
                console.print(f"\n{check.rung}. {ITEMS[check.rung]}")
                console.print(f"{'case':28s} {'check':52s} {'measured':>10s} {'allowed':>8s}  verdict")
            done.append(check)
            show(check, console, width=28)
    except KeyboardInterrupt:
        interrupted = True
    console.print(verdict(done, interrupted=interrupted))
    if interrupted:
        return INTERRUPTED
    return 0 if all(check.holds for check in done) else FAILED
