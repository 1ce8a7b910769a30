"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table, an empty one last."""
    escaped = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    return [*(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *escaped)), ""]
