"""What the module of any effect may declare of bodies, reels and edges: no other module names the effect."""

from __future__ import annotations

from pathlib import Path

import pytest

import exunet
from exunet.base.errors import CaseError
from exunet.forces.effects import EFFECTS
from exunet.simulation.preparation import prepare_case

CASES = Path(__file__).parent.parent / "cases"
ON = "effects.gravity.acceleration=[0.0, 0.0, -1.0]"
BALL = 'bodies.ball={shape="sphere", radius=0.1, mass=1.0, position=[0.0, 0.0, 5.0]}'
FREE = CASES / "verification" / "free_net.toml"


def test_an_effect_that_presses_on_a_body_has_its_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only bodies that the effect contact named had one, whatever another effect declared."""
    case = exunet.load(FREE, [ON, BALL])
    assert dict(prepare_case(case).system.blocks.surfaces) == {}
    for name, value in (("touched_bodies", ("ball",)), ("touching_pairs", ()), ("largest_radius", 0.01)):
        monkeypatch.setattr(EFFECTS["gravity"], name, lambda *_, found=value: found, raising=False)
    assert list(prepare_case(case).system.blocks.surfaces) == ["ball"]


@pytest.mark.parametrize(
    ("case", "declares", "words"),
    [
        ("bodies/tow.toml", "not_with_reels", r"effects\.gravity:"),
        (
            "verification/closing/perimeter.toml",
            "not_with_perimeter",
            r"effects\.gravity:",
        ),
    ],
)
def test_an_effect_says_what_cannot_have_it(
    monkeypatch: pytest.MonkeyPatch, case: str, declares: str, words: str
) -> None:
    """Three effects stood in tables of another module, where one of a reader's own had no place."""
    exunet.load(CASES / case, [ON])
    monkeypatch.setattr(EFFECTS["gravity"], declares, lambda keys: "for a test", raising=False)
    with pytest.raises(CaseError, match=words):
        exunet.load(CASES / case, [ON])
