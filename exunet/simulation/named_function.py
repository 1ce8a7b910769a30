"""A function by its dotted path, which scripts in Python may give; a case file never names one."""

from __future__ import annotations

from importlib import import_module

from exunet.base.errors import InputError
from exunet.forces.thrusters import Function


def function_named(path: str) -> Function:
    """Import "package.module:function" or "package.module.function"; raises InputError for anything else."""
    module, _, name = path.rpartition(":" if ":" in path else ".")
    if not module or not all(part.isidentifier() for part in (*module.split("."), name)):
        words = 'name a function as "package.module:function" or "package.module.function"'
        raise InputError(f"controller: {words}, got {path!r}")
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise InputError(f"controller: {module!r} of {path!r} cannot be imported: {error}") from error
    if not callable(found):
        raise InputError(f"controller: {module!r} has no function {name!r}")
    function: Function = found
    return function
