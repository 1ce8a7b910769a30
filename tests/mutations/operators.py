"""Change operators of the physics one at a time and look which tests notice.

    python tests/mutations/operators.py --sample 0.05 --seed 20261121 [--only MODULE] [--jobs 2] [--passing]

What is changed: the arithmetic operators (+ - * / **, unary minus, augmented assignments) and comparisons
(< <= > >= == !=) of the modules in PHYSICS; annotations, f-strings, the building of texts and `raise`
statements are left out. Whether an operator is in the sample, and what replaces it, follow from the seed and
the operator's own line alone, so edits elsewhere do not change the sample.

How: `git archive` puts the commit into one scratch folder for each job, which stands first on PYTHONPATH
(the copy is complete, so an editable install cannot fill gaps from the working tree). The tests that
`.ci/run` runs, quick ones and one slow one of a group, run there once unchanged; tests that fail there are
left out and named. With --passing it is taken that all pass, as they do at a commit that CI has run. Then
each mutant meets the test files that concern its module (CONCERNED), and what survives those meets all tests
of CI, all with `-x`, in a fork of a process that has the libraries imported (`forked_pytest.py`). A test
that takes longer than the limit counts as one that fails: a mutant that never ends is noticed.
XDG_CACHE_HOME is a folder of the job's own, filled from the user's cache, so the kernels of mutants stay out
of that; they are removed after each.

Every verdict is appended to `records.jsonl` in --out as it falls. A second call with the same --out goes on
where the first ended; survivors are tried again if the commit has changed. The survivors of the last
complete sample are explained in operators.md beside this file.
"""

# ruff: noqa: T201
from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).resolve().parents[2]

PHYSICS = (
    "forces/**/*.py", "bodies/*.py", "system/*.py", "coupling/*.py", "net/*.py", "backends/compiled/*.py",
    "backends/exudyn/step_choice.py", "simulation/control.py", "simulation/envelope.py",
    "simulation/guards.py", "simulation/monitor.py", "simulation/peaks.py", "simulation/refinement.py",
    "results/capture.py", "results/corner_units.py", "results/loads.py", "results/margins.py",
    "results/measures.py", "results/momenta.py", "results/passages.py", "results/touching.py",
    "results/verdict.py",
)  # fmt: skip

# Test files that concern the modules whose path begins so; the longest prefix counts. They run in the order
# of the time that they take.
CONCERNED = {
    "forces/": "force_loops effects terms effects_estimates effects_together verify kernel stability guards",
    "forces/cable": "force_loops terms effects kernel stability planar guards peaks auto simulation verify",
    "forces/jumps": "jumps terms effects auto methods retry loop",
    "forces/loops": "force_loops terms kernel effects effects_together loop verify",
    "forces/contact/": "contact/* touched_ports passages bounce verify_contact force_loops bodies_at_states",
    "forces/contact/bod": "bodies_at_states contact/test_bodies_messages.py contact/test_bodies_touch.py",
    "forces/contact/blend": "contact/test_touch.py contact/test_pushes_at_states.py bodies_at_states",
    "forces/contact/core": "contact/test_core_distance.py contact/test_touch.py bodies_at_states",
    "forces/contact/foretold": "contact/test_foretold.py",
    "forces/contact/frame": "contact/test_pushes_at_states.py meshes_at_states bodies_at_states",
    "forces/contact/friction": "contact/test_pushes_at_states.py bodies_at_states",
    "forces/contact/grid": "contact/test_grid_core.py contact/test_mesh_core.py meshes_at_states",
    "forces/contact/impact": "contact/test_impact.py contact/test_pushes_at_states.py",
    "forces/contact/law": "contact/test_foretold.py contact/test_pushes_at_states.py contact/test_touch.py",
    "forces/contact/mesh": "meshes_at_states contact/test_mesh_contact.py",
    "forces/contact/near": "contact/test_near.py meshes_at_states bodies_at_states",
    "forces/contact/pair": "contact/test_self_contact.py contact/test_self_contact_runs.py",
    "forces/contact/piece": "contact/test_grid_core.py meshes_at_states contact/test_mesh_core.py",
    "forces/contact/span": "contact/test_touch.py contact/test_pushes_at_states.py bodies_at_states",
    "forces/contact/spheres": "contact/test_pushes_at_states.py contact/test_near.py bounce",
    "forces/contact/thread": "contact/test_pushes_at_states.py contact/test_near.py meshes_at_states",
    "forces/contact/together": "contact/test_self_contact.py contact/test_self_contact_runs.py",
    "forces/contact/touchable": "contact/test_bodies_messages.py contact/test_contact_messages.py",
    "forces/contact/touching": "contact/test_touch.py contact/test_pushes_at_states.py bodies_at_states",
    "forces/closing": "closing/* verify_closing script carried",
    "forces/perimeter": "closing/* verify_closing script",
    "forces/control": "control_laws control corner_units corner_faults",
    "forces/thrusters": "loops_on_bodies control_laws corner_units control thrust",
    "forces/barrels": "barrels ejection nominal_motion effects",
    "forces/launch_laws": "barrels ejection effects",
    "forces/held": "attachments bodies carried verify_bodies",
    "forces/blocks": "loops_on_bodies attachments bodies verify_bodies",
    "forces/on_bodies": "loops_on_bodies forces_on_bodies effects_on_bodies verify_bodies",
    "forces/wrench": "loops_on_bodies forces_on_bodies from_outside ports",
    "forces/linear_term": "loops_on_bodies force_loops effects terms kernel effects_together",
    "forces/directions": "magnitudes effects terms effects_estimates",
    "forces/surface": "magnitudes force_loops effects effects_estimates",
    "forces/from_outside": "loops_on_bodies from_outside ports simulation",
    "forces/reel": "reels reel_instants reeled_ports tethers sleeping verify_bodies",
    "forces/rubbing_loops": "closing/test_line_friction.py closing/* verify_closing",
    "forces/rotation_loops": "loops_on_bodies turning bodies attachments",
    "forces/effects/": "force_loops nominal_motion magnitudes effects effects_estimates effects_together "
    "terms thrust",
    "forces/effects/contact": "magnitudes contact/* touched_ports bounce effects_estimates verify_contact",
    "forces/effects/self_contact": "magnitudes contact/* effects_estimates",
    "forces/effects/thrust": "magnitudes thrust terms simulation",
    "forces/estimate": "nominal_motion magnitudes effects_estimates effects",
    "bodies/": "turning bodies body_cases shapes simulation restart envelope guards verify_bodies",
    "bodies/distance": "distance between surfaces contact/test_core_distance.py",
    "bodies/surfaces": "surfaces shapes contact/test_triangles.py contact/test_mesh_core.py",
    "bodies/between": "between passages distance contact/test_core_distance.py",
    "bodies/approach": "between passages distance body_cases",
    "bodies/body": "ports shapes bodies attachments contact/test_touch.py",
    "bodies/crossing": "passages between distance contact/test_touch.py preparation",
    "bodies/cross_checks": "shapes guides bodies preparation",
    "bodies/overlap": "surfaces shapes between distance contact/test_touch.py preparation",
    "bodies/touched": "contact/* touched_ports",
    "bodies/guide": "guides ports bodies attachments",
    "bodies/keys": "shapes guides bodies preparation",
    "bodies/kinematics": "guides reels attachments carried bodies",
    "bodies/constraint_loops": "guides reels turning attachments bodies couple_exudyn inputs_and_states",
    "bodies/port": "ports reeled_ports touched_ports port_jumps coupling",
    "bodies/rigid": "turning shapes ports guides bodies",
    "bodies/shapes": "shapes distance surfaces wireframe passages contact/test_touch.py",
    "bodies/triangle_loops": "contact/test_triangles.py contact/test_mesh_core.py",
    "bodies/wireframe": "wireframe figures_bodies",
    "bodies/mass": "shapes bodies items",
    "bodies/making": "shapes bodies",
    "bodies/mesh": "surfaces shapes distance",
    "bodies/obj": "surfaces",
    "bodies/packed": "shapes passages distance",
    "coupling/": "coupling couple_runs coupled_cases coupled_snapshots macro_steps ports port_jumps",
    "coupling/prediction": "ports macro_steps light_nodes reeled_ports touched_ports coupling couple_runs",
    "coupling/undo": "ports coupling couple_runs",
    "coupling/port_ratios": "touched_ports reeled_ports coupling",
    "coupling/port_loops": "ports reeled_ports touched_ports port_jumps coupling",
    "coupling/exudyn": "macro_steps couple_exudyn couple_runs coupled_cases coupled_snapshots",
    "coupling/handover": "ports macro_steps couple_runs coupled_snapshots",
    "coupling/light_nodes": "light_nodes macro_steps coupling",
    "coupling/native_items": "items couple_exudyn",
    "coupling/marked_ports": "couple_exudyn couple_runs",
    "system/approaches": "contact/test_approaches.py contact/test_foretold.py effects_estimates",
    "system/effect_survey": "contact/test_approaches.py effects_estimates contact/test_foretold.py",
    "system/mesh_core": "contact/test_mesh_core.py contact/test_mesh_contact.py",
    "system/chatter": "contact/test_chatter.py contact/test_contact_law.py",
    "system/bodies": "guides reels bodies attachments simulation",
    "system/exchange": "drum ejection",
    "system/from_scene": "drum reels sleeping closing/* bodies simulation",
    "system/energy": "energy guards bodies envelope effects effects_together planar metrics verify books",
    "system/stability": "stability guards methods auto verify",
    "system/turning": "spin_guard",
    "system/initial": "initial net planar verify",
    "system/limits": "guards guards_limits preparation",
    "system/script": "script_events script script_looks script_faults closing/* corner_units",
    "system/quantities": "quantities script script_looks closing/*",
    "system/drum": "drum sleeping reels reel_instants tethers",
    "system/carried": "carried ejection sleeping reels books",
    "system/ejection": "ejection barrels bodies",
    "system/begun": "begun release",
    "system/set_parameters": "set script",
    "system/within_steps": "script_events script",
    "system/": "bodies simulation guards restart envelope planar terms books",
    "backends/compiled/": "schemes turning seen_steps jumps loop terms bodies simulation peaks retry auto",
    "backends/compiled/loop": "step_control schemes seen_steps jumps loop retry auto bounce",
    "backends/compiled/many_steps": "schemes seen_steps jumps step_control turning loop retry auto",
    "backends/compiled/many": "side_by_side ensemble spread seen_steps loop",
    "backends/compiled/schemes": "schemes turning loop",
    "backends/compiled/se": "seen_steps peaks loop",
    "backends/compiled/sight": "seen_steps peaks sleeping reels loop",
    "backends/compiled/work": "seen_steps turning loop bodies",
    "backends/compiled/side_by_side": "side_by_side ensemble spread",
    "backends/exudyn/": "step_choice terms effects auto retry methods restart simulation",
    "simulation/control": "control corner_units",
    "simulation/": "guards peaks envelope retry effects_estimates simulation guards_limits loop",
    "results/": "metrics guards planar plot bodies effects large_result summary",
    "results/capture": "contact/* measures_setting",
    "results/corner_units": "loads corner_units control",
    "results/loads": "loads margins tethers body_cases attachments",
    "results/margins": "margins tethers",
    "results/measures": "loads metrics books body_rows guards planar",
    "results/momenta": "books body_cases body_rows summary",
    "results/passages": "passages contact/*",
    "results/touching": "contact/*",
    "results/verdict": "contact/* script",
    "net/": "net initial planar verify areas",
    "net/accordion": "folding net",
    "net/areas": "areas metrics",
    "net/arrays": "net tethers closing/* cut",
    "net/canister": "folding",
    "net/closing": "closing/*",
    "net/creases": "creases folding",
    "net/cut": "cut net",
    "net/drive": "reels tethers closing/*",
    "net/explicit": "net preparation",
    "net/folding": "folding",
    "net/hexagonal": "net creases",
    "net/lattice": "cut net creases",
    "net/loops": "cut net",
    "net/meeting": "meeting string_folds folding closing/* tethers",
    "net/outline": "outline cut net",
    "net/rectangular": "net creases",
    "net/reel": "drum reels",
    "net/star": "star folding",
    "net/string_folds": "string_folds folding",
    "net/tether": "tethers reels",
}

REPLACED = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*", ast.USub: "+",
    ast.Lt: ("<=", ">="), ast.LtE: ("<", ">"), ast.Gt: (">=", "<="), ast.GtE: (">", "<"),
    ast.Eq: "!=", ast.NotEq: "==",
}  # fmt: skip
SYMBOL = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.USub: "-",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
TEST_LIMIT = 120.0  # [s] of one test; the longest takes 20 s on two idle cores
WHOLE_LIMIT = 7200.0  # [s] of all tests of CI


@dataclass(frozen=True)
class Mutant:
    """One changed operator.

    key  : module, function, text of the line, and which operator of that line in that function
    span : byte offsets of the operator and of the expression that it joins, put in brackets if `bracketed`
    """

    key: str
    module: str
    line: int
    source: str
    original: str
    replaced: str
    span: tuple[int, int, int, int]
    bracketed: bool

    def applied(self, text: bytes) -> bytes:
        """The module's text with the change."""
        start, first, last, end = self.span
        left, right = (b"(", b")") if self.bracketed else (b"", b"")
        changed = text[:start] + left + text[start:first] + self.replaced.encode() + text[last:end] + right
        return changed + text[end:]


def share(seed: int, key: str) -> float:
    """A number in [0, 1) that follows from the seed and the key alone."""
    return int(hashlib.sha256(f"{seed} {key}".encode()).hexdigest()[:12], 16) / 16.0**12


def mutants_of(tree: Path, module: str, seed: int) -> Iterator[Mutant]:
    """All mutants of a module, one for each operator."""
    text = (tree / module).read_bytes()
    lines = text.splitlines(keepends=True)
    begins = [0]
    for line in lines:
        begins.append(begins[-1] + len(line))
    seen: Counter[str] = Counter()

    def place(line: int, column: int) -> int:
        return begins[line - 1] + column

    def mutant(function: str, operator: ast.AST, whole: ast.AST, after: int, before: int) -> Mutant:
        symbol, choice = SYMBOL[type(operator)], REPLACED[type(operator)]
        first = after + text[after:before].index(symbol.encode())
        line = text[:first].count(b"\n") + 1
        shown = lines[line - 1].decode().strip()
        name = f"{module}:{function}: {shown}"
        seen[name] += 1
        key = f"{name} [{seen[name]}]"
        if not isinstance(choice, str):
            choice = choice[int(2.0 * share(seed, key + " replacement"))]
        span = (place(whole.lineno, whole.col_offset), first, first + len(symbol),
                place(whole.end_lineno, whole.end_col_offset))  # fmt: skip
        bracketed = isinstance(whole, ast.BinOp)
        if isinstance(whole, ast.AugAssign):
            choice = choice + "="
            span = (span[0], span[1], span[2] + 1, span[3])
            symbol += "="
        return Mutant(key, module, line, shown, symbol, choice, span, bracketed)

    def visit(node: ast.AST, function: str) -> Iterator[Mutant]:
        if isinstance(node, ast.JoinedStr | ast.Raise):
            return
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}" if function else node.name
        if isinstance(node, ast.BinOp) and type(node.op) in SYMBOL and not builds_text(node):
            left, right = node.left, node.right
            yield mutant(function, node.op, node, place(left.end_lineno, left.end_col_offset),
                         place(right.lineno, right.col_offset))  # fmt: skip
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            start = place(node.lineno, node.col_offset)
            yield mutant(function, node.op, node, start, start + 1)
        elif isinstance(node, ast.AugAssign) and type(node.op) in SYMBOL and not builds_text(node):
            yield mutant(function, node.op, node, place(node.target.end_lineno, node.target.end_col_offset),
                         place(node.value.lineno, node.value.col_offset))  # fmt: skip
        elif isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
            for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
                if type(operator) in SYMBOL:
                    yield mutant(function, operator, node, place(left.end_lineno, left.end_col_offset),
                                 place(right.lineno, right.col_offset))  # fmt: skip
        for name, child in ast.iter_fields(node):
            if name not in ("annotation", "returns"):
                for part in child if isinstance(child, list) else [child]:
                    if isinstance(part, ast.AST):
                        yield from visit(part, function)

    yield from visit(ast.parse(text), "")


def builds_text(node: ast.BinOp | ast.AugAssign) -> bool:
    """True if one of the operands is a string."""
    operands = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    return any(
        isinstance(one, ast.JoinedStr) or (isinstance(one, ast.Constant) and isinstance(one.value, str))
        for one in operands
    )


def drawn(tree: Path, sample: float, seed: int, only: str) -> tuple[list[Mutant], int]:
    """The sample, and the number of operators that it is drawn from."""
    modules = sorted({path for pattern in PHYSICS for path in (tree / "exunet").glob(pattern)})
    every = [m for path in modules for m in mutants_of(tree, path.relative_to(tree).as_posix(), seed)]
    every = [m for m in every if only in m.module]
    return [m for m in every if share(seed, m.key) < sample], len(every)


def concerned(tree: Path, module: str) -> list[str]:
    """The test files that concern a module."""
    path = module.removeprefix("exunet/")
    prefix = max((p for p in CONCERNED if path.startswith(p)), key=len)
    files: list[str] = []
    for name in CONCERNED[prefix].split():
        pattern = f"tests/{name.replace('*', 'test_*.py')}" if "/" in name else f"tests/test_{name}.py"
        found = [file.relative_to(tree).as_posix() for file in tree.glob(pattern)]
        if not found:
            sys.exit(f"CONCERNED[{prefix!r}] names {name}, and there is no such test file")
        files += found
    return files


class Scratch:
    """A copy of the tree in which one mutant at a time is tried."""

    def __init__(self, folder: Path, commit: str, cache: Path) -> None:
        self.tree, self.cache = folder / "tree", folder / "cache"
        shutil.rmtree(self.tree, ignore_errors=True)  # a call that was killed has left its mutant there
        self.tree.mkdir(parents=True)
        packed = subprocess.run(["git", "archive", commit], cwd=ROOT, check=True, capture_output=True)
        subprocess.run(["tar", "x"], cwd=self.tree, input=packed.stdout, check=True)
        if not self.cache.is_dir():
            if cache.is_dir():
                shutil.copytree(cache, self.cache / "exunet", copy_function=shutil.copy2)
            self.cache.mkdir(exist_ok=True)
        environment = dict(os.environ, XDG_CACHE_HOME=str(self.cache), PYTHONPATH=str(self.tree),
                           PYTHONDONTWRITEBYTECODE="1")  # fmt: skip
        self.process = subprocess.Popen(
            [sys.executable, "-P", Path(__file__).with_name("forked_pytest.py")], cwd=self.tree,
            env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def pytest(self, arguments: list[str], limit: float = TEST_LIMIT) -> tuple[int | None, str]:
        """Exit code (None: longer than the limit) and output of the tests of CI with these arguments.

        limit : [s] of one test
        """
        always = [
            "-q", "-n", "0", "-m", "not slow or ci", "-rfE", "--tb=line", "-p", "no:cacheprovider",
            "-o", f"faulthandler_timeout={limit}", "-o", "faulthandler_exit_on_timeout=true",
        ]  # fmt: skip
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps([[*always, *arguments], WHOLE_LIMIT]) + "\n")
        self.process.stdin.flush()
        code, output = json.loads(self.process.stdout.readline())
        return code, Path(output).read_text(errors="replace")

    def unchanged(self) -> dict[str, object]:
        """Seconds of each test file without a change, and the tests that fail."""
        report = self.tree.parent / "unchanged.xml"
        asked = [f"--junitxml={report}", "-o", "junit_family=xunit1"]
        self.pytest(asked, limit=10.0 * TEST_LIMIT)  # none is to be lost since others use the cores
        seconds: Counter[str] = Counter()
        failing = []
        for case in xml.etree.ElementTree.parse(report).iter("testcase"):
            file = case.get("file", "")
            seconds[file] += float(case.get("time", 0.0))
            if case.find("failure") is not None or case.find("error") is not None:
                failing.append(f"{file}::{case.get('name')}")
        return {"seconds": dict(seconds), "failing": failing}

    def killed(self, mutant: Mutant, tests: list[str]) -> tuple[str | None, float]:
        """The test that notices a mutant ("time limit" if one never ends, None if none does), and [s]."""
        path = self.tree / mutant.module
        right = path.read_bytes()
        kernels = set(self.cache.rglob("*"))
        began = time.monotonic()
        path.write_bytes(mutant.applied(right))
        try:
            code, output = self.pytest(["-x", *tests])
        finally:
            path.write_bytes(right)
            for file in set(self.cache.rglob("*")) - kernels:
                if file.is_file():
                    file.unlink()
        seconds = time.monotonic() - began
        if code is None or "Timeout (" in output:
            return "time limit", seconds
        if code == 0:
            return None, seconds
        if found := re.search(r"^(?:FAILED|ERROR) (tests/\S+)", output, re.MULTILINE):
            return found[1], seconds
        raise RuntimeError(f"pytest ended with {code}, no test failed: {output[-2000:]}")


def main() -> None:
    """Draw, try, record, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=float, default=0.05, help="part of the operators")
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--only", default="", help="modules whose path contains this")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--commit", default="HEAD", help="what to put into the scratch folders")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "mutations")
    parser.add_argument("--concerned-only", action="store_true", help="not all tests of CI for survivors")
    parser.add_argument(
        "--passing", action="store_true", help="all tests pass without a change: no first pass"
    )
    parser.add_argument("--list", action="store_true", help="only show the sample")
    chosen = parser.parse_args()
    sample, total = drawn(ROOT, chosen.sample, chosen.seed, chosen.only)
    if chosen.list:
        for mutant in sample:
            print(f"{mutant.module}:{mutant.line}: {mutant.original} -> {mutant.replaced}: {mutant.source}")
        print(f"{len(sample)} of {total} operators")
        return

    commit = subprocess.run(
        ["git", "rev-parse", "--short", chosen.commit], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()
    folder = chosen.out / commit
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "exunet"
    first = Scratch(folder / "0", commit, home)
    told = folder / "unchanged.json"
    if not told.is_file() and not chosen.passing:
        told.write_text(json.dumps(first.unchanged(), indent=1))
    unchanged = json.loads(told.read_text()) if told.is_file() else {"seconds": {}, "failing": []}
    for test in unchanged["failing"]:
        print(f"fails without a change, left out: {test}")
    left_out = [f"--deselect={test}" for test in unchanged["failing"]]
    idle: Queue[Scratch] = Queue()
    idle.put(first)
    for number in range(1, chosen.jobs):
        idle.put(Scratch(folder / str(number), commit, first.cache / "exunet"))

    sample, total = drawn(first.tree, chosen.sample, chosen.seed, chosen.only)
    records = chosen.out / "records.jsonl"
    verdicts: dict[str, dict[str, object]] = {}
    if records.is_file():
        for line in records.read_text().splitlines():
            record = json.loads(line)
            verdicts[record["key"]] = record
    writing = threading.Lock()

    def attempt(mutant: Mutant, whole: bool) -> None:
        files = sorted(
            concerned(first.tree, mutant.module), key=lambda file: unchanged["seconds"].get(file, 0.0)
        )
        scratch = idle.get()
        try:
            by, seconds = scratch.killed(mutant, [*(["tests"] if whole else files), *left_out])
        finally:
            idle.put(scratch)
        verdict = "killed" if by else "survived" if whole else "survived what concerns it"
        record = asdict(mutant) | {
            "commit": commit,
            "verdict": verdict,
            "by": by,
            "seconds": round(seconds, 1),
        }
        with writing:
            verdicts[mutant.key] = record
            with records.open("a") as file:
                file.write(json.dumps(record) + "\n")
            print(f"{verdict:9} {mutant.module}:{mutant.line} {mutant.original} -> {mutant.replaced} | "
                  f"{mutant.source} | {by} ({seconds:.0f} s)", flush=True)  # fmt: skip

    def undecided(mutant: Mutant, known: tuple[str, ...]) -> bool:
        record = verdicts.get(mutant.key, {})
        return record.get("verdict") not in known or (
            record["verdict"] != "killed" and record["commit"] != commit
        )

    for whole in (False,) if chosen.concerned_only else (False, True):
        known = ("killed", "survived") if whole else ("killed", "survived", "survived what concerns it")
        left = [mutant for mutant in sample if undecided(mutant, known)]
        with ThreadPoolExecutor(chosen.jobs) as pool:
            list(pool.map(attempt, left, [whole] * len(left)))

    print(f"\ncommit {commit}, seed {chosen.seed}, {len(sample)} of {total} operators")
    table = Counter((m.module, verdicts[m.key]["verdict"]) for m in sample)
    print(f"{'module':44} killed survived")
    for module, number in sorted(Counter(m.module for m in sample).items()):
        print(f"{module:44} {table[module, 'killed']:6} {number - table[module, 'killed']:8}")
    for mutant in sample:
        if verdicts[mutant.key]["verdict"] != "killed":
            print(f"survived: {mutant.key}: {mutant.original} -> {mutant.replaced}")


if __name__ == "__main__":
    main()
