"""What `[effects.contact]` refuses of bodies that touch each other, with the line of the file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from body_scenes import written

import exunet
import reference_impl
from exunet.simulation.preparation import prepare_case

PAIR = 'bodies = [["one", "other"]]'
MORE = """
[bodies.one]
shape = "sphere"
radius = 0.3
mass = 1.0
[bodies.other]
shape = "box"
size = [0.4, 0.4, 0.4]
edge_radius = 0.05
mass = 1.0
position = [1.0, 0.0, 0.0]
[bodies.tank]
shape = "cylinder"
radius = 0.2
length = 1.0
edge_radius = 0.05
mass = 1.0
position = [5.0, 0.0, 0.0]
[bodies.sharp]
shape = "box"
size = [0.4, 0.4, 0.4]
mass = 1.0
position = [9.0, 0.0, 0.0]
"""


def refused(folder: Path, changes: dict[str, str], *overrides: str) -> str:
    """The message about the scene with parts of its text changed, without the folder; "": there is none."""
    path = written(folder)
    text = path.read_text() + MORE
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    try:
        prepare_case(exunet.load(path, list(overrides)))
    except exunet.CaseError as error:
        return " ".join(str(error).replace(f"{folder}/", "").split())
    return ""


def test_what_is_right_is_read(tmp_path: Path) -> None:
    assert refused(tmp_path, {}) == ""
    assert refused(tmp_path, {PAIR: 'bodies = [["one", "tank"], ["other", "one"]]'}) == ""
    rubs = 'friction = { law = "regularised", coefficient = 0.3, slip_speed = 1e-3 }\nlaw ='
    assert refused(tmp_path, {"law =": rubs}) == ""
    hertz = {'"linear"': '"hertz"', "body_stiffness = 1e4": "modulus = 1e6"}
    assert refused(tmp_path, hertz) == ""


WRONG: dict[str, tuple[dict[str, str], str]] = {
    "unknown": (
        {PAIR: 'bodies = [["one", "otter"]]'},
        r"two\.toml:13: effects\.contact\.bodies\[0\]\[1\]: ",
    ),
    "itself": (
        {PAIR: 'bodies = [["one", "one"]]'},
        r":13: effects\.contact\.bodies\[0\]: ",
    ),
    "twice": (
        {PAIR: 'bodies = [["one", "other"], ["other", "one"]]'},
        r":13: effects\.contact\.bodies\[1\]: ",
    ),
    "three": ({PAIR: 'bodies = [["one", "other", "tank"]]'}, r":13: effects\.contact\.bodies\[0\]"),
    "sharp": (
        {PAIR: 'bodies = [["one", "sharp"]]'},
        r":13: effects\.contact\.bodies\[0\]\[1\]: ",
    ),
    "round sides": (
        {PAIR: 'bodies = [["tank", "other"]]'},
        r":13: effects\.contact\.bodies\[0\]: tank has a cylinder, which touches spheres only, and other is "
        r"no sphere: build both of boxes, spheres and capsules",
    ),
    "no stiffness": ({"body_stiffness = 1e4\n": ""}, r":12: effects\.contact: "),
    "stiffness of hertz": (
        {'"linear"': '"hertz"'},
        r":15: effects\.contact\.body_stiffness: ",
    ),
    "no slip speed": (
        {"law =": 'friction = { law = "regularised", coefficient = 0.3 }\nlaw ='},
        r":14: effects\.contact\.friction\.slip_speed: ",
    ),
    "overlap at the start": (
        {"position = [1.0, 0.0, 0.0]": "position = [0.4, 0.0, 0.0]"},
        r"two\.toml:27: bodies\.other\.position: the body overlaps one at the start",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_with_its_line(name: str, tmp_path: Path) -> None:
    changes, words = WRONG[name]
    assert re.search(words, found := refused(tmp_path, changes)), found


def test_the_reference_tells_that_it_lacks_it(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text() + MORE)
    with pytest.raises(ValueError, match=r"reference_impl does not know effects\.contact\.bodies"):
        reference_impl.load(path)
