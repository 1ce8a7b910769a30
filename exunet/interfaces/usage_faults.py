"""Faults of arguments and options in our own words, which those of the library that reads them are not."""

from __future__ import annotations

import re
from typing import Any

# What a value must be, by a part of what the library says of one that is not.
_WANTED = (
    ("integer", "must be a whole number"),
    ("number", "must be a number"),
    ("float", "must be a number"),
)


def usage_fault(error: Any) -> str:
    """One line: the option or argument, and what is wrong with it; error: as the library raises it."""
    said = " ".join(str(error.format_message()).split())
    kind, name = type(error).__name__, _name(error)
    if kind == "NoSuchOption":
        close = getattr(error, "possibilities", None) or []
        return f"{error.option_name}: no such option" + (f"; did you mean {close[0]}?" if close else "")
    if kind == "BadOptionUsage":
        takes_none = "does not take" in said
        return f"{error.option_name}: {'takes no value' if takes_none else 'a value is missing after it'}"
    if kind == "MissingParameter":
        return f"{name}: missing; -h tells what the command takes"
    if kind == "BadParameter":
        own = str(error.message)
        return f"{name}: {next((words for part, words in _WANTED if part in own), own)}"
    if found := re.search(r"extra arguments? ?(?:\(s\))? ?\((.*)\)", said):
        return f"{found[1]}: more than the command takes; -h tells what it takes"
    if found := re.match(r"No such command '(.*?)'\.?(?: Did you mean '(.*?)')?", said):
        close_to = f"did you mean {found[2]}?" if found[2] else "exunet -h lists them"
        return f"{found[1]}: no such command; {close_to}"
    return said


def _name(error: Any) -> str:
    """The long name of an option, the word for an argument."""
    param = getattr(error, "param", None)
    if param is None:
        return str(getattr(error, "param_hint", None) or "")
    if param.param_type_name == "option":
        return str(max(param.opts, key=len))
    return str(param.metavar or param.name)
