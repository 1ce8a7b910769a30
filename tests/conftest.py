"""For all tests: the same random examples each time, and no working directory to lean on."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings

# The examples follow from the test's own code alone; none is kept from run to run, none depends on the clock.
settings.register_profile("exunet", derandomize=True, database=None, deadline=None)
settings.load_profile("exunet")

# Rewriting the assertions of all tests takes each worker several seconds: the result is kept, also where the
# environment disables bytecode.
sys.dont_write_bytecode = False

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


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the parametrisations that ``slow_for`` and ``ci_for`` name."""
    for item in items:
        parametrisation = f"-{item.nodeid.partition('[')[2].removesuffix(']')}-"
        for mark in ("slow", "ci"):
            words = (word for marker in item.iter_markers(f"{mark}_for") for word in marker.args)
            if any(f"-{word}-" in parametrisation for word in words):
                item.add_marker(mark)
