"""The entry of the `exunet` command: what its commands raise becomes words on stderr and an exit code.

Exit codes: 0 done, 1 a check of `verify` failed (or a defect of exunet), 2 bad input (nothing written), 3 a
run that stopped (what was computed is kept), 4 a run that `--check` could not check (its result is written),
130 interrupted, 141 nobody reads what is printed any more.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from io import TextIOWrapper
from typing import Any, NoReturn

import typer

from exunet.base.errors import ExunetError
from exunet.codegen.compilation import told_compilation
from exunet.interfaces.cli import app
from exunet.interfaces.commands.lines import silent, tell, tell_faults
from exunet.interfaces.usage_faults import usage_fault

CLOSED_PIPE = 141  # 128 + 13, the number of SIGPIPE

_UsageError: Any = typer.BadParameter.__base__  # of all faults of arguments and options


def main() -> None:
    """Entry point: errors become one line each on stderr and an exit code, never a traceback."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed before the start, as by >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a title may hold what the terminal cannot show
    say = silent if "--quiet" in sys.argv else tell
    try:
        with told_compilation(say):
            code = app(prog_name="exunet", standalone_mode=False) or 0
        sys.stdout.flush()
        sys.exit(code)
    except ExunetError as error:
        _leave(str(error), error.exit_code)
    except _UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # of `exunet` alone
            typer.echo(error.ctx.get_help(), err=True)
            sys.exit(error.exit_code)
        _leave(usage_fault(error), error.exit_code)
    except KeyboardInterrupt:
        _leave("interrupted", 130)
    except ImportError as error:
        if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise
        _leave("interrupted", 130)  # while a library was loaded, which makes a fault of its own of Ctrl-C
    except SystemExit as done:
        if done.code == 130:  # typer's way to end on Ctrl-C says nothing
            _leave("interrupted", 130)
        if isinstance(done.__context__, BrokenPipeError):  # typer's and rich's way to end then
            _leave_closed_pipe()
        raise
    except BrokenPipeError:
        _leave_closed_pipe()
    except OSError as error:
        reason = error.strerror or error
        if error.filename is not None:
            _leave(f"{error.filename}: {reason}", 2)
        sys.stdout = None  # the terminal or a pipe: nothing more to flush at the interpreter's end
        _leave(f"cannot print: {reason}", 2)


def _leave(words: str, code: int) -> NoReturn:
    tell_faults(words)
    sys.exit(code)


def _leave_closed_pipe() -> NoReturn:
    """End as a program that SIGPIPE ends: nobody reads on, as with `| head`, which is no fault to tell."""
    with suppress(OSError, ValueError):  # what is still to be flushed must not fail at the interpreter's end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(CLOSED_PIPE)
