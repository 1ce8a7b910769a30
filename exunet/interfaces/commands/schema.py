"""`exunet schema`: the case format as a commented template and as a JSON Schema."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import typer

from exunet.base.errors import InputError
from exunet.case import schema
from exunet.interfaces.commands.lines import HANG, folded, width_of


def print_format(*, as_json: bool, template: bool) -> None:
    """Print one of both, or without a choice both, the JSON Schema in comments; not both choices."""
    if as_json and template:
        raise InputError("--json, --template: give one of them, or neither for both")
    if not as_json:
        typer.echo(schema.template().rstrip())
    if not (as_json or template):
        typer.echo("\n# JSON Schema of this format (exunet schema --json prints it alone):")
    if not template:
        text = json.dumps(schema.json_schema(), indent=2)
        typer.echo(text if as_json else "\n".join(_comments(text)))


def _comments(text: str) -> Iterator[str]:
    """Lines that a text has as TOML comments, folded to where they are read."""
    width = width_of(sys.stdout) - len("# ")
    for line in text.splitlines():
        indent = len(line) - len(line.lstrip())
        yield from (f"# {part}" for part in folded(line, width, indent + HANG))
