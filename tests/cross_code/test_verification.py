"""The checks of `exunet verify` and of the hard cases, one test an item."""

from __future__ import annotations

import pytest

from exunet.base.cases import CASES, shipped
from exunet.verification import hard
from exunet.verification.check import Check
from exunet.verification.suite import AT_STATES, BEYOND, KNOWN, NETS, ORDERS, RUNS, Item, suite

STATES = 2  # random states of each kind: the quick tests find an error in the force of any effect


def holds(item: Item) -> None:
    checks = [finding for finding in item.run() if isinstance(finding, Check)]
    assert checks
    if all(check.skipped for check in checks):
        pytest.skip(checks[0].where)
    failed = [f"{c.name}: {c.error:.3g} {c.where} {c.value!r} {c.expected!r}" for c in checks if not c.holds]
    assert failed == []


def parameters(items: list[Item]) -> list[object]:
    """One parameter an item; those of `suite` that are slow run in .ci/run by `exunet verify`."""
    return [
        pytest.param(
            item,
            id=f"{item.section.split(',')[0]}: {item.subject}",
            marks=[] if item.quick else [pytest.mark.slow],
        )
        for item in items
    ]


@pytest.mark.parametrize("item", parameters(suite(states=STATES, compiled=False)))
def test_both_codes_and_known_answers(item: Item) -> None:
    holds(item)


@pytest.mark.parametrize(
    "item", parameters([item for item in suite(states=STATES) if item.section == AT_STATES])
)
def test_the_compiled_loop_at_states(item: Item) -> None:
    holds(item)


@pytest.mark.parametrize("name", ["capture/cubesat", "capture/fixed_sphere", "missions/closed_box"])
def test_a_connected_net_in_contact_at_states(name: str) -> None:
    """Threads that share nodes are within the depth that the law allows, on one and on many solids."""
    path = CASES / f"{name}.toml"
    (item,) = (item for item in suite([path], states=1, compiled=False) if item.section == AT_STATES)
    holds(item)


@pytest.mark.parametrize("item", parameters(hard.items()))
def test_hard_case(item: Item) -> None:
    holds(item)


def test_every_shipped_case_of_the_suite_has_its_items() -> None:
    """All sections are there; each case of cases/verification has a known answer or a comparison."""
    items = suite(states=STATES)
    assert {item.section for item in items} >= {NETS, AT_STATES, RUNS, BEYOND, KNOWN, ORDERS}
    known = {item.subject.partition(":")[0] for item in items if item.section in (KNOWN, ORDERS)}
    assert set(shipped("verification")) <= known
    assert {f"bodies/{name}" for name in shipped("verification/bodies")} <= known
    assert set(shipped("hard")) == {entry.case for entry in hard.GALLERY} | {"implicit"}
