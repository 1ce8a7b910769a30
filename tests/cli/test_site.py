"""The built documentation, from its files: requests, links of scripts and pictures, search."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import NEEDS_CHROMIUM, PATIENCE, Page, chromium

SITE = Path(__file__).parents[2] / "docs" / "_build" / "html"
PAGES = sorted(SITE.rglob("*.html"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PAGES, reason="the site is not built: python docs/build_site.py --quick"),
]
LOADED = "document.readyState === 'complete'"
NETWORK = re.compile(r"""(?:\ssrc=|<link\s[^>]*href=|@import\s|url\()\s*["']?(?:https?:)?//[^"')\s]*""")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium(tmp_path_factory.mktemp("chromium")) as opened:
        yield opened


def test_no_file_names_one_of_a_network() -> None:
    for file in (*PAGES, *SITE.rglob("*.css")):
        assert not NETWORK.findall(file.read_text(encoding="utf-8")), file


@NEEDS_CHROMIUM
def test_pages_open_without_an_error_a_missing_file_or_a_request_to_a_network(page: Page) -> None:
    for file in PAGES:
        page.open(file, ready=LOADED)
        assert not page.problems, file
    assert not [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))]


@NEEDS_CHROMIUM
@pytest.mark.parametrize(
    ("words", "known"),
    [
        ("material damping", "reference/keys/effects.html"),
        ("escaped", "how_to/failed_capture.html"),
        ("initial.frame", "reference/keys/initial.html"),
    ],
)
def test_search_has_the_right_page_among_the_first_three(page: Page, words: str, known: str) -> None:
    found = "[...document.querySelectorAll('#search-results li a')].map(a => a.getAttribute('href'))"
    query, ready = words.replace(" ", "+"), "document.querySelectorAll('#search-results li').length > 2"
    page.open(SITE / "search.html", query=f"?q={query}", ready=ready)
    assert known in [link.partition("?")[0].partition("#")[0] for link in page.evaluate(found)[:3]]


@NEEDS_CHROMIUM
def test_cards_of_the_gallery_have_their_pictures(page: Page) -> None:
    page.open(SITE / "gallery" / "index.html", ready=LOADED)
    widths = page.evaluate("[...document.querySelectorAll('.run img')].map(image => image.naturalWidth)")
    assert len(widths) >= 6
    assert min(widths) > 0


@NEEDS_CHROMIUM
@pytest.mark.parametrize("name", ["index", "gallery/capture/box"])
def test_the_3d_view_of_a_page_turns(page: Page, name: str) -> None:
    """Pixels change when the pointer is drawn over the frame, and only then."""
    page.open(SITE / f"{name}.html", ready=LOADED)
    left, top = page.evaluate(
        "(view => { view.scrollIntoView({behavior: 'instant'}); const box = view.getBoundingClientRect();"
        " return [box.left + 0.3 * box.width, box.top + 0.25 * box.height]; })"
        "(document.querySelector('iframe.view'))"
    )
    end = time.monotonic() + PATIENCE
    while page.evaluate_in_frame("document.documentElement.dataset.ready") != "true":
        assert time.monotonic() < end
        time.sleep(0.1)
    before = page.picture()
    assert page.picture() == before
    for kind, x in (("mousePressed", left), ("mouseMoved", left + 60), ("mouseReleased", left + 60)):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=top, button="left", buttons=1, clickCount=1)
    assert page.picture() != before
