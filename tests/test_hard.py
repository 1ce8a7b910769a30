"""The gallery of hard cases (cases/hard), in each form of the engine and in the reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from exunet.verify import hard
from exunet.verify.check import Check
from exunet.verify.gallery import GALLERY, ITEMS, Hard

CASES = Path(__file__).parent.parent / "cases" / "hard"
SLOW_IN_LOOP = {"long_undamped", "mesh_50x50", "every_step", "odd_times"}
IDS = {"ids": lambda value: value.case if isinstance(value, Hard) else str(value)}
QUICK = [one for one in GALLERY if one.case not in SLOW_IN_LOOP]


def hold(checks: list[Check]) -> None:
    assert checks
    failed = [f"{c.subject}: {c.name}: {c.measured:.3g} {c.verdict} {c.worst}" for c in checks if not c.holds]
    assert failed == []


def test_every_file_of_the_gallery_is_in_its_table_and_every_item_has_one():
    assert {path.stem for path in CASES.glob("*.toml")} == {one.case for one in GALLERY} | {"implicit"}
    assert {one.item for one in GALLERY} | {5} == set(ITEMS)


@pytest.mark.parametrize("one", QUICK, **IDS)
def test_in_the_compiled_loop(one):
    hold(list(hard.of_form(one, "compiled")))


@pytest.mark.slow
@pytest.mark.parametrize("one", [one for one in GALLERY if one not in QUICK], **IDS)
def test_in_the_compiled_loop_at_length(one):
    hold(list(hard.of_form(one, "compiled")))


@pytest.mark.slow
@pytest.mark.parametrize("form", ["connectors", "fused"])
@pytest.mark.parametrize("one", GALLERY, **IDS)
def test_in_the_engine(one, form):
    hold(list(hard.of_form(one, form)))


@pytest.mark.slow
@pytest.mark.ci
def test_shorter_cases_in_both_forms_of_the_engine():
    short = {"all_in_one_point", "folded", "slack", "overstretched", "soft_threads", "one_element", "tether"}
    for one in GALLERY:
        if one.case in short:
            for form in ("connectors", "fused"):
                hold(list(hard.of_form(one, form)))


@pytest.mark.slow
@pytest.mark.parametrize("one", GALLERY, **IDS)
def test_in_the_reference(one):
    checks = list(hard.of_reference(one))
    assert checks or isinstance(one.reference, str)
    hold(checks or list(hard.of_form(one, "compiled")))


@pytest.mark.parametrize("form", list(hard.FORMS))
def test_a_step_above_the_stable_one_is_refused_or_caught(form):
    checks = list(hard.above(form))
    hold(checks)
    assert [check.name.split(": ")[1] for check in checks] == ["refused", "stopped"]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["connectors", "fused"])
def test_implicit_methods_keep_their_bound_or_are_stopped(form):
    """The names of the checks tell which: at these steps, and on these snaps, the guards stop them all."""
    checks = list(hard.implicit(form))
    hold(checks)
    assert len(checks) == 8
    words = {check.name: check.worst for check in checks}
    assert all("stopped: diverged" in text or text == "ran to the end" for text in words.values())


def test_the_energy_momentum_method_is_exact_at_any_step():
    hold(list(hard.energy_momentum()))


def test_a_bound_that_is_broken_is_told():
    """7e-8 of the energy is what one snap costs at this tolerance."""
    from dataclasses import replace

    from exunet.verify.tolerances import HARD_FIXED

    one = next(one for one in GALLERY if one.case == "one_element")
    tight = replace(HARD_FIXED, value=1e-12)
    failed = [check.name for check in hard.of_form(replace(one, energy=tight), "compiled") if not check.holds]
    assert failed == ["energy balance"]
