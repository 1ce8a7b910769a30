"""Loads Exudyn quietly, and without a user's own configuration file changing results."""

from __future__ import annotations

import os
from typing import Any

from exunet.base.version import installed_version


def exudyn(*, quiet: bool = True) -> Any:
    """The engine's module, with its shipped settings (a user's ~/.exudyn is not read).

    quiet : it prints nothing; not for a system of the user's own, who may want to read it
    """
    os.environ.setdefault("EXUDYN_NO_USER_SETTINGS", "1")
    import exudyn as engine

    if quiet:
        engine.config.printToConsole = False
        engine.config.suppressWarnings = True
    return engine


def exudyn_items() -> Any:
    """The engine's module with the constructors of its items."""
    import exudyn.itemInterface as items  # noqa: N813 - a module of the engine

    return items


def exudyn_version() -> str:
    """Version of the installed engine."""
    return installed_version("exudyn")
