"""Compilation is told when it happens, once, with how long it took, and only that of kernels."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import event

import exunet
from exunet.codegen.compilation import KERNELS, listen, told_compilation
from exunet.simulation.preparation import prepare_case
from exunet.system.system import System

PLANAR = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"


def begun_system() -> System:
    return prepare_case(exunet.load(PLANAR)).system


def compile_one(module: str, inside: int = 0) -> None:
    """The events of a function that compiles others that it calls."""
    data = {"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__=module))}
    with event.trigger_event("numba:compile", data=data):
        if inside:
            compile_one(module, inside - 1)


def test_it_is_told_once() -> None:
    listen()
    listen()  # does not hear twice
    lines: list[str] = []
    with told_compilation(lines.append):
        compile_one(KERNELS + "one", inside=2)
        compile_one(KERNELS + "two")
        assert lines == ["compiling this scene's forces, once"]
    assert len(lines) == 2
    assert lines[1].startswith("compiled this scene's forces in 0.0 s")


def test_nothing_is_told_without_it_or_of_other_code() -> None:
    listen()
    lines: list[str] = []
    with told_compilation(lines.append):
        compile_one("numpy.linalg")
    compile_one(KERNELS + "after")
    assert lines == []


def test_threads_compile_side_by_side() -> None:
    listen()
    lines: list[str] = []
    with told_compilation(lines.append):
        threads = [threading.Thread(target=compile_one, args=(KERNELS + "one", 3)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(lines) == 2


def test_an_error_inside_leaves_nobody_told() -> None:
    listen()
    lines: list[str] = []
    with pytest.raises(ValueError, match="inside"), told_compilation(lines.append):
        raise ValueError("inside")
    compile_one(KERNELS + "after")
    assert lines == []
