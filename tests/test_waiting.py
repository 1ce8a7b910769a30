"""What is shown on a terminal while something lasts."""

from __future__ import annotations

import sys

import pytest
import rich.console

from exunet.interfaces.commands.waiting import waiting


class Sign:
    """Stands for the moving sign of a terminal, and keeps what it has said."""

    def __init__(self, words: str) -> None:
        self.status = words
        self.said = [words]

    def __enter__(self) -> Sign:
        return self

    def __exit__(self, *_: object) -> None:
        self.said.append("")

    def update(self, words: str) -> None:
        self.status = words
        self.said.append(words)


def test_what_lasts_within_what_lasts_has_the_same_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """`exunet check` of a large net had two signs, which took turns on one line ten times a second."""
    signs: list[Sign] = []

    def status(_: rich.console.Console, words: str) -> Sign:
        signs.append(Sign(words))
        return signs[-1]

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(rich.console.Console, "status", status)
    with waiting("building"), waiting("quietly", quiet=True), waiting("trying"):
        pass
    with pytest.raises(ZeroDivisionError), waiting("more"), waiting("still more"):
        raise ZeroDivisionError
    with waiting("once more"):
        pass
    assert [sign.said for sign in signs] == [
        ["building", "trying", "building", ""],
        ["more", "still more", "more", ""],
        ["once more", ""],
    ]
