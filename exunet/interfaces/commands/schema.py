"""`exunet schema`: the case format as a commented template and as a JSON Schema."""

from __future__ import annotations

import json

import typer

from exunet.base.errors import InputError
from exunet.case import schema


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
        typer.echo(text if as_json else "\n".join(f"# {line}" for line in text.splitlines()))
