"""Compilation of kernels is reported once, when it begins."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
from numba.core import event

from exunet.kernels.compile import KERNELS, listen, reported_compilation


def compile_one(module: str, inside: int = 0) -> None:
    """The events of a function that compiles others that it calls."""
    data = {"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__=module))}
    with event.trigger_event("numba:compile", data=data):
        if inside:
            compile_one(module, inside - 1)


def test_the_first_compilation_of_a_block_is_reported_once() -> None:
    listen()
    listen()  # receives no event twice
    lines: list[str] = []
    with reported_compilation(lines.append):
        threads = [threading.Thread(target=compile_one, args=(KERNELS + "one", 3)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(lines) == 1
    assert lines[0].startswith("compiling")


def test_other_code_and_other_blocks_are_not_reported() -> None:
    listen()
    lines: list[str] = []
    with reported_compilation(lines.append):
        compile_one("numpy.linalg")
    with pytest.raises(ValueError, match="inside"), reported_compilation(lines.append):
        raise ValueError("inside")
    compile_one(KERNELS + "after")
    assert lines == []
