"""For all tests: the same random examples each time, and no working directory to lean on."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# The examples follow from the test's own code alone; none is kept from run to run, none depends on the clock.
settings.register_profile("exunet", derandomize=True, database=None, deadline=None)
settings.load_profile("exunet")

# A shell starts background jobs with Ctrl-C ignored, which every process that a test starts would inherit.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def outside_of_the_project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run in an empty folder, whatever the tests were started from, and leave nothing in it.

    A test that finds its files only from the project's root, or writes into the working directory, fails.
    """
    folder = tmp_path_factory.mktemp("working_directory")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield
    assert list(folder.iterdir()) == []


# The same physics in the compiled loop, by file, or by file and test: slow tests. The quick ones try it in
# Exudyn.
COMPILED_TOO = (
    "test_bounce.py", "test_forces_on_bodies.py", "test_guides.py", "test_inputs_and_states.py",
    "test_sleeping.py", "test_thrust.py", "test_attachments.py", "test_effects_on_bodies.py",
    "test_tethers.py", "test_reels.py", "test_reel_instants.py", "test_barrels.py", "test_ejection.py",
    "closing/test_closing_line.py", "test_corner_units.py",
    "test_effects.py::test_a_snap_that_breaks", "test_simulation.py::test_a_body_is_read",
    "test_simulation.py::test_a_force_on_a_node_that_is_held", "test_simulation.py::test_reset_forgets",
    "test_simulation.py::test_a_force_changes", "test_simulation.py::test_forces_on_several_points",
)  # fmt: skip

# What takes a second and more, and the slow tests that .ci/run runs, one of each group: beginnings of names.
SLOW, FOR_CI = (
    tuple((Path(__file__).parent / f"{name}.txt").read_text(encoding="utf-8").split("\n")[:-1])
    for name in ("slow_tests", "ci_tests")
)


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        name = item.nodeid.removeprefix("tests/")
        form = name.partition("[")[2]
        if ("compiled" in form and name.startswith(COMPILED_TOO)) or name.startswith(SLOW):
            item.add_marker(pytest.mark.slow)
        if name.startswith(FOR_CI):
            item.add_marker(pytest.mark.ci)
