"""The version of exunet, where every package can read it, and those of what it needs."""

from functools import cache

VERSION = "0.1.0"


@cache  # finding it takes a millisecond, which each new simulation would spend
def installed_version(package: str) -> str:
    """Of an installed package."""
    from importlib.metadata import version

    return version(package)
