"""Compile and cache the text of kernels with Numba, and report the progress.

Numba compiles a function when it is first called, and takes it from its cache where an earlier run has left
it there; only the former is reported.

Numba keeps machine code only for functions that stand in a file, so the text goes into the user's cache
directory, under a name made of its own hash: a changed ingredient is another file.
"""

from __future__ import annotations

import gc
import hashlib
import importlib.util
import os
import pickle
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from exunet.base.errors import MissingExtra
from exunet.base.machine import installed_version

KERNELS = "exunet_kernel_"  # begins the names of the modules that are compiled

_reports: list[Callable[[str], None]] = []  # of the open blocks in which nothing was compiled so far
_listening: list[Any] = []


@contextmanager
def reported_compilation(report: Callable[[str], None]) -> Iterator[None]:
    """Report the first compilation of a block, when it begins."""
    _reports.append(report)
    try:
        yield
    finally:
        if report in _reports:
            _reports.remove(report)


def listen() -> None:
    """Receive Numba's events from now on; called before kernels are made, as it imports Numba."""
    if _listening:
        return
    from numba.core import event

    class Listener(event.Listener):
        depth = 0  # functions that are being compiled, one inside the other
        collected = False  # Python's collector of cycles ran before

        def on_start(self, event: Any) -> None:
            if not self.depth:
                self.collected = gc.isenabled()
                gc.disable()  # it takes a fifth of the time, and finds little
            self.depth += 1
            if str(event.data["dispatcher"].py_func.__module__).startswith(KERNELS):
                while _reports:
                    _reports.pop()("compiling the forces of this scene, once on this machine: some seconds")

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if not self.depth and self.collected:
                gc.enable()

    _listening.append(Listener())
    event.register("numba:compile", _listening[0])


WIDTH = 8  # runs that go side by side (see `lanes`): doubles of one register of AVX-512, two of AVX2

CALLED = "@called"  # stands before a function that is called from Python
BY_ADDRESS = "@by_address"  # before one that another module calls
SELDOM = "@seldom"  # before one that another module calls a few times a second at most
INSIDE = "@inside"  # before one that is called in the module only

_DECORATORS = """\
import functools

from numba import njit

from exunet.kernels.pipeline import Inner, Outer, Seldom
from exunet.kernels.pointers import HeldTuple, borrowed
from exunet.kernels.pointers import call_add, call_event, call_place, call_potential, call_power
from exunet.kernels.pointers import call_remember, call_reporting, call_shorten, call_verlet_work, call_work
from exunet.kernels.pointers import whole, zero_of

options = {{"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}}
called = functools.partial(njit, **options, cache={cache}, pipeline_class=Outer)
by_address = functools.partial(called, no_cpython_wrapper=True)
seldom = functools.partial(by_address, pipeline_class=Seldom)
inside = functools.partial(njit, **options, no_cpython_wrapper=True, pipeline_class=Inner)
in_any_order = functools.partial(inside, fastmath={{"reassoc"}})
"""


def numba_installed() -> bool:
    """True if kernels can be compiled."""
    return importlib.util.find_spec("numba") is not None and not _compiles_nothing()


def _compiles_nothing() -> bool:
    """True if the environment makes Numba interpret what it should compile."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0").strip() not in ("", "0")


def numba_version() -> str | None:
    """Version of the installed Numba; None without it."""
    return installed_version("numba") if numba_installed() else None


def require_numba(purpose: str) -> None:
    """Raise MissingExtra, naming what needs it, if Numba is not installed."""
    if _compiles_nothing():
        raise MissingExtra(
            f"{purpose} needs compiled kernels: unset the environment variable NUMBA_DISABLE_JIT"
        )
    if not numba_installed():
        raise MissingExtra(
            f"{purpose} needs Numba, which is not installed: pip install numba "
            '(or use engine.backend = "exudyn")'
        )


def compiled_module(source: str) -> ModuleType:
    """The module of this text with its functions compiled when first called; needs Numba."""
    name = _name(source)
    if name in sys.modules:
        return sys.modules[name]
    listen()
    path = _kept(name, _with_decorators(source, cache=True))
    if path is None:
        module = ModuleType(name)
        exec(_with_decorators(source, cache=False), module.__dict__)
    else:
        _remove_unreadable(path)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    sys.modules[name] = module
    return module


def _name(source: str) -> str:
    own = version_of("pointers") + version_of("pipeline")
    versions = f"{numba_version()} {platform.python_version()} {platform.machine()} {own}"
    return KERNELS + hashlib.sha256((versions + source).encode()).hexdigest()[:20]


def _called(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


def _work(f: Any, h: Any, x0: Any, v0: Any, x1: Any, v1: Any, data: Any) -> Any:
    return f(h, (x0, v0), (x1, v1), data)


_INTERPRETED = {
    "in_any_order": lambda function: function,
    "borrowed": lambda value: value,
    "HeldTuple": lambda value: SimpleNamespace(value=value),
    "zero_of": lambda array: 0.0,
    "call_work": _work,
}


def interpreted_module(source: str) -> ModuleType:
    """The same module as plain Python: correct, but some hundred times slower."""
    from exunet.forces.terms import ARGUMENTS  # imports NumPy, which commands that compute nothing do not

    module = ModuleType("exunet_kernel_interpreted")
    module.__dict__.update(dict.fromkeys((f"call_{name}" for name in (*ARGUMENTS, "reporting")), _called))
    module.__dict__.update(_INTERPRETED)
    exec(source.replace(f"{CALLED}\n", "").replace(f"{INSIDE}\n", ""), module.__dict__)
    return module


def _with_decorators(source: str, *, cache: bool) -> str:
    marker = "import numpy as np\n"
    head, rest = source.split(marker, 1)
    return head + marker + _DECORATORS.format(cache=cache) + rest


def _kept(name: str, text: str) -> Path | None:
    """The file that holds `text`, written if need be; None if no directory can be written."""
    for folder in _folders():
        path = folder / f"{name}.py"
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not _own(folder):
                continue
            if not (path.is_file() and path.read_text(encoding="utf-8", errors="replace") == text):
                with tempfile.NamedTemporaryFile(
                    "w", dir=folder, suffix=".part", delete=False, encoding="utf-8"
                ) as part:
                    part.write(text)
                os.replace(part.name, path)  # whole or not at all, whatever other processes do
            (folder / "__pycache__").mkdir(exist_ok=True)
            if os.access(folder / "__pycache__", os.W_OK):
                return path
        except OSError:
            continue
    return None


def _remove_unreadable(path: Path) -> None:
    """Remove indices of compiled code that name classes which this version of exunet does not have.

    Numba's index pickles the types of the arguments; an index of another version would end in ImportError.
    """
    for index in (path.parent / "__pycache__").glob(f"{path.stem}.*.nbi"):
        with suppress(OSError):
            try:
                with index.open("rb") as file:
                    pickle.load(file)
                    pickle.loads(file.read())
            except (ImportError, AttributeError, EOFError, pickle.UnpicklingError):
                index.unlink()


def _folders() -> list[Path]:
    """Where kernels may be kept, best first."""
    folders = []
    if cache := os.environ.get("XDG_CACHE_HOME"):
        folders.append(Path(cache))
    else:
        with suppress(RuntimeError):  # no home directory
            folders.append(Path.home() / ".cache")
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return [folder / "exunet" for folder in folders] + [Path(tempfile.gettempdir()) / f"exunet-{user}"]


def _own(folder: Path) -> bool:
    """False for a directory that another user could have filled: its code must not be run."""
    if not hasattr(os, "getuid"):
        return True
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


def version_of(name: str) -> str:
    """Return the hash of a module here that compiled code uses; kept code of another hash is not reused."""
    return hashlib.sha256(Path(__file__).with_name(f"{name}.py").read_bytes()).hexdigest()[:16]


def kept_before(source: str) -> bool:
    """True if functions of this text were compiled before and kept; needs Numba."""
    name = _name(source)
    if name in sys.modules:
        return True
    for folder in _folders():
        with suppress(OSError):  # a folder that this user may not search
            if next((folder / "__pycache__").glob(f"{name}.*.nbi"), None):
                return True
    return False
