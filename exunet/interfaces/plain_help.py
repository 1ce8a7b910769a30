"""Help that names what a command takes, and not the types in Python that read it."""

from __future__ import annotations

import re
from typing import Any

from typer.core import TyperCommand


class PlainCommand(TyperCommand):
    """A command whose help has no "<bool>" and the like; some versions of Typer print them."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words after the command in its usage, without the braces round an argument."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments and options, each with what its help says."""
        for heading, kind in (("Arguments", "argument"), ("Options", "option")):
            params = [param for param in self.get_params(ctx) if param.param_type_name == kind]
            records = [record for param in params if (record := param.get_help_record(ctx))]
            if records:
                with formatter.section(heading):
                    formatter.write_dl([(re.sub(r" <[^>]*>", "", name), words) for name, words in records])
