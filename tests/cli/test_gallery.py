"""The generator of the gallery: titles, cases that fail or take too long."""

from __future__ import annotations

import html
import json
from importlib.util import module_from_spec, spec_from_file_location

from commands import CASES
from markdown_it import MarkdownIt

BUILDER = CASES.parent / "docs" / "build_gallery.py"
GALLERY = module_from_spec(SPEC := spec_from_file_location("build_gallery", BUILDER))
SPEC.loader.exec_module(GALLERY)
HOSTILE = '<script>alert("1")</script> & *a* _b_ `c` [d](e) {f}`g` $h$ | ~i~ +++ ::: #'


def test_titles_are_shown_as_text() -> None:
    shown = MarkdownIt().render(GALLERY.escaped(HOSTILE))
    assert html.unescape(shown.removeprefix("<p>").removesuffix("</p>\n")) == HOSTILE
    assert GALLERY.escaped("+++\n") == r"\+\+\+"  # no end of the card


def test_a_case_that_fails_or_takes_too_long_has_a_card_that_states_it(tmp_path, monkeypatch) -> None:
    """And no picture; it is run again by the next build."""
    bad = tmp_path / "bad.toml"
    bad.write_text("format = 1\nnot_a_key = 2\n", encoding="utf-8")
    cards = {"nets/own": GALLERY.card_of("nets/own", bad, tmp_path, "")}
    assert "not_a_key" in cards["nets/own"]["outcome"]
    monkeypatch.setattr(GALLERY, "LIMIT", 0.0)
    cards["nets/cut"] = GALLERY.card_of("nets/cut", CASES / "nets" / "cut.toml", tmp_path, "")
    assert cards["nets/cut"]["outcome"].startswith("stopped")
    GALLERY.write_pages(cards, tmp_path / "gallery")
    index = (tmp_path / "gallery" / "index.md").read_text(encoding="utf-8")
    assert index.count("stopped") == index.count(r"not\_a\_key") == 1
    assert "img-top" not in index
    assert not list(tmp_path.rglob("*.json"))


def test_a_card_is_kept_until_its_case_or_the_package_changes(tmp_path, monkeypatch) -> None:
    case, runs = tmp_path / "case.toml", []

    def run(command, **_):
        runs.append(command)
        return type(
            "Done",
            (),
            {"returncode": 0, "stdout": json.dumps({"title": "", "outcome": str(len(runs)), "time": ""})},
        )

    monkeypatch.setattr(GALLERY.subprocess, "run", run)
    found = []
    for text, version in (("a = 1", "1"), ("a = 1", "1"), ("a = 2", "1"), ("a = 2", "2")):
        case.write_text(text, encoding="utf-8")
        found.append(GALLERY.card_of("case", case, tmp_path, version)["outcome"])
    assert found == ["1", "1", "2", "3"]
