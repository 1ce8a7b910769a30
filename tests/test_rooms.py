"""Names in the package: one name means one thing."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import exunet

PACKAGE = Path(exunet.__file__).parent
CLASS = re.compile(r"^ *class ([A-Za-z]\w*)[:(\[]", re.MULTILINE)  # a public one


def test_each_public_class_has_a_name_of_its_own() -> None:
    """A reader who looks for a class by its name finds one.

    Two studies had a Study and a Setting each, three modules a Control, and only the imports told which was
    meant.
    """
    places = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in CLASS.findall(path.read_text(encoding="utf-8")):
            places[name].append(str(path.relative_to(PACKAGE)))
    assert len(places) > 300  # it has seen the package
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
