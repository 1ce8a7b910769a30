"""Loads Exudyn quietly, and without a user's own configuration file changing results."""

from __future__ import annotations

import os
from typing import Any


def exudyn() -> Any:
    """The engine's module, silent, with its shipped settings (a user's ~/.exudyn is not read)."""
    os.environ.setdefault("EXUDYN_NO_USER_SETTINGS", "1")
    import exudyn as engine

    engine.config.printToConsole = False
    engine.config.suppressWarnings = True
    return engine


def exudyn_items() -> Any:
    """The engine's module with the constructors of its items."""
    import exudyn.itemInterface as items  # noqa: N813 - a module of the engine

    return items


def exudyn_version() -> str:
    """Version of the installed engine."""
    from importlib.metadata import version

    return version("exudyn")
