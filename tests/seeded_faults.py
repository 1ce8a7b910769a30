"""Change operators, signs, factors and indices of the physics, drawn by a seed, and report which tests fail.

    python tests/seeded_faults.py --seed 7 --number 40 --minutes 45 --out faults.jsonl

A fault is one change of one expression: an arithmetic operator, a comparison, a sign, a numerical factor or
an index. A copy of the commit HEAD receives the fault; the test files that import the changed module run
first, then the comparison of both codes at random states, then all quick tests. A fault is detected if a test
fails or exceeds its time. Each verdict is appended to the output file; a second call with the same file skips
the faults that it contains. Undetected faults are printed for review: some of them do not change any result.
"""

# ruff: noqa: T201
from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PHYSICS = ("forces", "integrators", "bodies", "model", "net")
CROSS_CODE = "tests/cross_code/test_verification.py"
LIMIT = 900.0  # [s] for the quick tests, a multiple of what they take; a fault may make a loop endless

ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
COMPARISON = {
    ast.Lt: ast.Gt,
    ast.Gt: ast.Lt,
    ast.LtE: ast.Gt,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}


@dataclass(frozen=True)
class Fault:
    """A change of one expression.

    module      : path of the file, relative to the root of the project
    line        : number of the first line of the expression
    kind        : operator, comparison, sign, factor or index
    before, after : text of the expression
    start, end  : offsets of the expression in the UTF-8 text of the file [bytes]
    """

    module: str
    line: int
    kind: str
    before: str
    after: str
    start: int
    end: int


def faulty(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield kind and changed copy of an expression, for each change that is made of it."""
    changed = copy.deepcopy(node)
    if isinstance(changed, ast.BinOp) and type(changed.op) in ARITHMETIC:
        changed.op = ARITHMETIC[type(changed.op)]()
        yield "operator", changed
    elif isinstance(changed, ast.Compare) and type(changed.ops[0]) in COMPARISON:
        changed.ops[0] = COMPARISON[type(changed.ops[0])]()
        yield "comparison", changed
    elif isinstance(changed, ast.UnaryOp) and isinstance(changed.op, ast.USub):
        yield "sign", changed.operand
    elif isinstance(changed, ast.Constant) and type(changed.value) is float and changed.value != 0.0:
        yield "factor", ast.Constant(2.0 * changed.value)
    elif isinstance(changed, ast.Subscript) and type(getattr(changed.slice, "value", None)) is int:
        index = changed.slice.value  # type: ignore[attr-defined]
        changed.slice = ast.Constant(1 if index == 0 else index - 1)
        yield "index", changed


def expressions(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the expressions of function bodies, without annotations, texts, error messages and defaults."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.FunctionDef):
            for statement in child.body:
                yield statement
                yield from expressions(statement)
        elif not isinstance(child, ast.JoinedStr | ast.Raise | ast.arguments):
            if isinstance(child, ast.AnnAssign):
                yield from expressions(ast.Module([ast.Expr(child.value)] if child.value else [], []))
                continue
            yield child
            yield from expressions(child)


def faults_of(path: Path) -> list[Fault]:
    """Return all faults of a module, in the order of its text."""
    text = path.read_text(encoding="utf-8")
    starts = [0]
    for line in text.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for top in ast.parse(text).body:
        if not isinstance(top, ast.FunctionDef | ast.ClassDef):
            continue
        for node in expressions(ast.Module([top], [])):
            for kind, changed in faulty(node):
                start = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
                end = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
                before = text.encode()[start:end].decode()
                after = f"({ast.unparse(ast.fix_missing_locations(changed))})"
                module = str(path.relative_to(ROOT))
                found.append(Fault(module, node.lineno, kind, before, after, start, end))  # type: ignore[attr-defined]
    return found


def drawn(seed: int, number: int, only: str) -> list[Fault]:
    """Draw faults without repetition: first a kind, then one of its faults, so that rare kinds occur too."""
    every = [
        fault
        for package in PHYSICS
        for path in sorted((ROOT / "exunet" / package).rglob("*.py"))
        for fault in faults_of(path)
        if only in fault.module
    ]
    chance = random.Random(seed)
    by_kind = {
        kind: [fault for fault in every if fault.kind == kind] for kind in sorted({f.kind for f in every})
    }
    chosen: list[Fault] = []
    while len(chosen) < min(number, len(every)):
        kind = chance.choice([kind for kind, faults in by_kind.items() if faults])
        chosen.append(by_kind[kind].pop(chance.randrange(len(by_kind[kind]))))
    return chosen


def concerned(module: str, copied: Path) -> list[str]:
    """Return the test files that import a module."""
    dotted = module.removesuffix(".py").replace("/", ".")
    package, _, name = dotted.rpartition(".")
    names = (dotted, f"from {package} import {name}")
    tests = sorted((copied / "tests").rglob("test_*.py"))
    return [str(test) for test in tests if any(text in test.read_text(encoding="utf-8") for text in names)]


def fails(copied: Path, arguments: list[str]) -> str:
    """Run pytest in a copy of the project and return the first test that fails, or an empty text."""
    environment = {**os.environ, "PYTHONPATH": str(copied), "XDG_CACHE_HOME": str(copied.parent / "cache")}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments]
    try:
        run = subprocess.run(
            command, cwd=copied, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return "exceeds its time"
    if run.returncode in (0, 5):  # 5: no quick test in these files
        return ""
    lines = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0][:200] if lines else f"pytest ended with {run.returncode}"


def verdict(fault: Fault, copied: Path) -> str:
    """Return the test that detects a fault, or an empty text; the copy is restored afterwards."""
    path = copied / fault.module
    text = path.read_bytes()
    path.write_bytes(text[: fault.start] + fault.after.encode() + text[fault.end :])
    try:
        files = concerned(fault.module, copied)
        first = fails(copied, ["-n", "0", *files]) if files else ""
        first = first or fails(copied, ["-n", "0", str(copied / CROSS_CODE)])
        return first or fails(copied, ["--maxfail", "1"])
    finally:
        path.write_bytes(text)


def main() -> None:
    """Draw the faults, run the tests on each, append the verdicts and print the share that was detected."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--number", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=120.0, help="no further fault after this time")
    parser.add_argument("--only", default="", help="modules whose path contains this text")
    parser.add_argument("--out", type=Path, default=Path("seeded_faults.jsonl"))
    parser.add_argument("--list", action="store_true", help="print the faults and run nothing")
    options = parser.parse_args()
    faults = drawn(options.seed, options.number, options.only)
    if options.list:
        for fault in faults:
            print(f"{fault.module}:{fault.line}: {fault.kind}: {fault.before!r} -> {fault.after!r}")
        return
    known = {}
    if options.out.exists():
        rows = [json.loads(line) for line in options.out.read_text(encoding="utf-8").splitlines()]
        known = {(row["module"], row["start"], row["after"]): row["detected_by"] for row in rows}
    with tempfile.TemporaryDirectory() as folder:
        copied = Path(folder) / "project"
        copied.mkdir()
        archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=True)
        subprocess.run(["tar", "-x", "-C", str(copied)], input=archive.stdout, check=True)
        if broken := fails(copied, []):
            sys.exit(f"the quick tests fail without a fault: {broken}")
        end = time.monotonic() + 60.0 * options.minutes
        for fault in faults:
            if time.monotonic() > end:
                break
            place = (fault.module, fault.start, fault.after)
            if place not in known:
                known[place] = verdict(fault, copied)
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({**asdict(fault), "detected_by": known[place]}) + "\n")
            change = f"{fault.module}:{fault.line}: {fault.before} -> {fault.after}"
            print(f"{known[place] or 'NOT DETECTED'}: {change}")
    verdicts = [known.get((fault.module, fault.start, fault.after)) for fault in faults]
    tried = [text for text in verdicts if text is not None]
    print(f"{sum(map(bool, tried))} of {len(tried)} faults detected (seed {options.seed})")


if __name__ == "__main__":
    main()
