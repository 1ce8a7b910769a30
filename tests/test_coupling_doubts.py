"""When the books of a coupling doubt it: by energy beside what went through, and what the net has."""

from __future__ import annotations

from pathlib import Path

import pytest

from exunet import BodiesHost, Cosimulation, NetSystem
from exunet.coupling.ledger import DOUBTFUL, NEGLIGIBLE, Books, PortBook

CUT = Path(__file__).parents[1] / "cases" / "missions" / "cut_tether.toml"


@pytest.mark.parametrize(
    ("book", "doubted"),
    [
        (PortBook(residual=2.5e-26, beside=1e-9), False),  # round-off, at a port that nothing moves
        (PortBook(residual=2.0 * NEGLIGIBLE, beside=1.0), True),  # added, and nothing went through
        (PortBook(residual=-2.0 * NEGLIGIBLE, beside=1.0), True),
        (PortBook(residual=0.5 * NEGLIGIBLE, beside=1.0), False),
        (PortBook(residual=1.0, most=0.5 / DOUBTFUL, beside=1.0), True),
        (PortBook(residual=1.0, most=2.0 / DOUBTFUL, beside=1.0), False),
        (PortBook(residual=1.0, most=0.5 / DOUBTFUL, beside=2.0 / NEGLIGIBLE), False),
    ],
)
def test_what_is_small_beside_the_net_is_no_doubt(book: PortBook, doubted: bool) -> None:
    assert bool(Books({"port": book}).doubts) == doubted


@pytest.mark.slow
def test_a_body_at_rest_that_a_tether_pulls_once_is_no_doubt() -> None:
    """1.1e-8 J added, 0 J gone through and 0.3 J in the net: it was "not to be trusted", 4e-9 m off."""
    net = NetSystem(CUT, ["engine.backend=compiled", "bodies.chaser.motion=port"])
    both = Cosimulation(net, BodiesHost.of_ports(net), step=0.005)
    both.advance_to(0.15)  # s; the tether pulls at 0.1 s, and is cut
    book = both.books.ports["chaser"]
    assert book.residual > DOUBTFUL * book.one_way
    assert book.impulse[2] == pytest.approx(1.06e-3, rel=0.01)  # N s
    assert book.residual == pytest.approx(0.5 * book.impulse[2] ** 2 / 50.0, rel=1e-2)  # J: p2 / 2m
    assert book.beside > 0.1  # J
    assert both.books.doubts == ()
