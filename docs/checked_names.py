"""Sphinx extension: code in a text that names a key, a public name or a command is a link, or an error."""

from __future__ import annotations

import importlib.util
import os
import re
from pathlib import Path
from typing import Any

import build_api
import build_commands
import build_keys
from docutils import nodes
from mdit_py_plugins.anchors.index import slugify
from sphinx.addnodes import download_reference, pending_xref
from sphinx.transforms import SphinxTransform
from sphinx.util import logging

import exunet

LOGGER = logging.getLogger(__name__)
GENERATED = ("reference/keys/", "reference/python/", "reference/commands/")
OTHERS = ("reference/results", "reference/metrics", "how_to/fmu")  # have names of files that look like keys
TABLES = build_keys.Keys().tables()
GROUPS = {name: build_api.file_name(group)[:-3] for group, names in exunet.API.items() for name in names}
PUBLIC = re.compile(r"exunet\.(\w+)")
COMMAND = re.compile(r"exunet ([a-z]+)\b(.*)")
# [effects.contact], [[script]], time.end, script[2].force, net.size = 4.0; two parts at least, or brackets
KEY = re.compile(r"(?:--set '?)?\[*([a-z_]\w*(?:\.[A-Za-z_]\w*|\[\d+\])*)\]*(?: ?= ?.*)?'?")
Target = tuple[str, str]  # document, anchor


class Unknown(Exception):
    """A name that exunet does not have."""


def target(text: str) -> Target | None:
    """Return the page and the anchor of what a text names; None if it is not a name of exunet."""
    if match := PUBLIC.match(text):
        return public_target(match[1])
    if match := COMMAND.match(text):
        return command_target(match[1], match[2])
    match = KEY.fullmatch(text)
    if match and match[1].partition(".")[0] in TABLES[""].keys and (text[0] == "[" or is_path(match[1])):
        return key_target(re.sub(r"\[\d+\]", ".0", match[1]).split("."))
    return None


def is_path(text: str) -> bool:
    """Return whether a text with a point may be the path of a key, and is no file."""
    return "." in text and not text.endswith((".toml", ".png", ".csv", ".html"))


def public_target(name: str) -> Target | None:
    if name in GROUPS:
        return f"reference/python/{GROUPS[name]}", slugify(f"exunet.{name}")
    if importlib.util.find_spec(f"exunet.{name}"):  # a package
        return None
    raise Unknown(f"exunet.{name} is not a public name")


def command_target(name: str, rest: str) -> Target:
    if name not in build_commands.COMMANDS:
        raise Unknown(f"exunet {name} is not a command")
    parameters = build_commands.COMMANDS[name].params
    known = {option for parameter in parameters for option in (*parameter.opts, *parameter.secondary_opts)}
    for option in re.findall(r"(?<=\s)--?[a-z][\w-]*", rest):
        if option not in known | {"-h", "--help"}:
            raise Unknown(f"exunet {name} does not have the option {option}")
    return f"reference/commands/{name}", ""


def key_target(path: list[str]) -> Target:
    """Return the table of a key: each part is a table, a name that the case chooses, or the key itself."""
    at, table = "", TABLES[""]
    for place, part in enumerate(path):
        if part == "NAME" and f"{at}.NAME" not in TABLES:  # of any of its tables
            break
        for inner in (f"{at}.{part}".lstrip("."), f"{at}.NAME".lstrip(".")):
            if inner in TABLES:
                at, table = inner, TABLES[inner]
                break
        else:
            if part.isdigit():
                continue
            mapping = f"{at}.{part}.NAME".lstrip(".")
            if mapping in TABLES:
                at = mapping.removesuffix(".NAME")
                continue
            if part not in table.keys or not all(map(str.isdigit, path[place + 1 :])):
                raise Unknown(f"{'.'.join(path)} is not a key of a case")
    if at in TABLES and table.paths:
        return f"reference/keys/{table.page}", slugify(table.heading.replace("`", ""))
    return "reference/keys/index", ""


class LinkNames(SphinxTransform):
    """Link inline code to the reference, and warn of a name that the reference does not have."""

    default_priority = 400

    def apply(self, **_: Any) -> None:
        """Do it for all inline code outside of links and titles."""
        self.link_files()
        if self.env.docname.startswith(GENERATED):
            return
        for literal in list(self.document.findall(nodes.literal)):
            text = literal.astext()
            if self.env.docname in OTHERS and not text.startswith(("[", "exunet")):
                continue
            try:
                found = target(text)
            except Unknown as unknown:
                LOGGER.warning("%s", unknown, location=literal)
                continue
            parents = [literal.parent, literal.parent.parent, getattr(literal.parent.parent, "parent", None)]
            linked = any(isinstance(node, nodes.reference | pending_xref | nodes.title) for node in parents)
            if found and not linked:
                options = {"refdomain": "doc", "reftype": "myst", "refdoc": self.env.docname}
                link = pending_xref("", reftarget=found[0], reftargetid=found[1], refexplicit=True, **options)
                literal.replace_self(link)
                link += nodes.inline("", "", literal, classes=["xref", "myst"])

    def link_files(self) -> None:
        """Let links to pages of the repository outside of docs/ open a copy of the file."""
        for link in list(self.document.findall(pending_xref)):
            file = f"{link['reftarget']}.md"
            if link.get("refdomain") == "doc" and os.path.isabs(file) and os.path.exists(file):
                path = os.path.relpath(file, Path(self.env.doc2path(self.env.docname)).parent)
                copy = download_reference("", "", *link.children, reftarget=path, refdoc=self.env.docname)
                link.replace_self(copy)


def setup(app: Any) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(LinkNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
