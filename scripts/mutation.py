#!/usr/bin/env python3
"""Changes one operator or number at a time in the files that stop a motor, and runs their tests each time.

`scripts/mutation.py NAME [--json FILE]`: guard, motion, limits, clearing, standing, supervision, following,
shaft. A change that no test notices survives. It is either a hole in the tests or a change without a
difference; those are listed in tests/mutation/NAME.txt with the reason. Exit code 1 when one survives that
is not listed there.

`scripts/mutation.py policy` moves every threshold of needle_rig/workbench/policy.py, to three times its value
and to a third (whole numbers: one up, one down), and runs the test that the threshold names as its guard.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import functools
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

ROOT = Path(__file__).resolve().parent.parent
GUARD = ROOT / "firmware/core/nr_guard.c"
MOTION = ROOT / "firmware/core/nr_motion.c"
CONTROL = ROOT / "needle_rig/control"
CONTROL_FILES = ("limits", "clearing", "standing", "supervision", "following", "shaft")
"""Of needle_rig/control; the test that notices their changes is named after each."""
POLICY_FILE = ROOT / "needle_rig/workbench/policy.py"
WORKBENCH_TESTS = ROOT / "tests/workbench"
LONGEST_S = 60
"""A change that never comes back is noticed by that: the tests of any file take a tenth of it."""
SLOW_IMPORTS = ("numpy", "numba", "scipy.special", "scipy.sparse")
PYTEST = (
    *("-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "--hypothesis-seed=1"),
    "--hypothesis-profile=ci",
    # pytest-timeout takes the alarm for itself
    *("-p", "no:timeout", "-o", "addopts=--import-mode=importlib", "-m", "not slow and not long"),
)

C_SWAPS = {
    "<=": ("<", "=="), ">=": (">", "=="), "<": ("<=", ">"), ">": (">=", "<"), "==": ("!=",), "!=": ("==",),
    "&&": ("||",), "||": ("&&",), "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",), "|=": ("=",),
    "+=": ("-=",), "&": ("|",), "++": ("--",), "true": ("false",), "false": ("true",), "!": ("",), "~": ("",),
}  # fmt: skip
C_TOKEN = re.compile(
    r"<=|>=|==|!=|&&|\|\||\|=|\+=|\+\+|->|--|[<>+*/&!~|-]|\btrue\b|\bfalse\b|\b\d+u?\b|\w+|\s+|."
)


@dataclass(frozen=True)
class Mutant:
    """One change: the line it is on, what it says, and the whole changed file."""

    line: int
    change: str
    text: str


def c_mutants(text: str) -> Iterator[Mutant]:
    """Operators swapped, numbers moved by one, statements left out; comments and includes are passed over."""
    bare = re.sub(r"/\*.*?\*/", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.S)
    bare = re.sub(r"^#.*$", lambda m: " " * len(m[0]), bare, flags=re.M)
    for found in C_TOKEN.finditer(bare):
        token, at = found[0], found.start()
        options: tuple[str, ...] = C_SWAPS.get(token, ())
        if re.fullmatch(r"\d+u?", token):
            number = int(token.rstrip("u"))
            options = (str(number + 1), str(number - 1)) if number else ("1",)
        if token in "*-&" and not bare[:at].rstrip()[-1:].isalnum() and bare[:at].rstrip()[-1:] not in ")]":
            continue  # a pointer, an address or a sign
        if token in ("*",) and re.search(r"\bstruct \w+ ?$", bare[:at]):
            continue
        for option in options:
            yield _mutant(text, at, at + len(token), option)
    for found in re.finditer(r"^ +[^\n{}]*;\n", bare, flags=re.M):
        if not re.match(r"\s*(return|const|int|uint|struct|static|bool)", found[0]):
            yield _mutant(text, found.start(), found.end() - 1, "        ;")


def _mutant(text: str, start: int, end: int, new: str) -> Mutant:
    line = text.count("\n", 0, start) + 1
    before = text.splitlines()[line - 1]
    changed = text[:start] + new + text[end:]
    return Mutant(line, f"{before.strip()}  ->  {changed.splitlines()[line - 1].strip()}", changed)


class PythonMutants(ast.NodeTransformer):
    """Yields every single change by counting the places where one can be made."""

    COMPARE: ClassVar = {
        ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
        ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn,
        ast.NotIn: ast.In,
    }  # fmt: skip
    ARITHMETIC: ClassVar = {
        ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitOr: ast.BitAnd,
        ast.BitAnd: ast.BitOr,
    }  # fmt: skip

    def __init__(self, place: int) -> None:
        self.left = place
        self.line = 0

    def _here(self, node: ast.AST) -> bool:
        self.left -= 1
        if self.left == -1:
            self.line = getattr(node, "lineno", 0)
            return True
        return False

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        new = self.COMPARE.get(type(node.ops[0]))
        if new and self._here(node):
            node.ops = [new(), *node.ops[1:]]
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        if self._here(node):
            node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        new = self.ARITHMETIC.get(type(node.op))
        if new and self._here(node):
            node.op = new()
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:  # what is written in annotations has no effect
            node.value = self.visit(node.value)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.body = [self.visit(statement) for statement in node.body]
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, (ast.Not, ast.USub)) and self._here(node):
            return node.operand
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, bool):
            return ast.copy_location(ast.Constant(not node.value), node) if self._here(node) else node
        if isinstance(node.value, (int, float)) and self._here(node):
            return ast.copy_location(ast.Constant(node.value + 1), node)
        return node


def python_mutants(text: str) -> Iterator[Mutant]:
    """Comparisons, logic, arithmetic, signs and constants, one at a time."""
    original = ast.unparse(ast.parse(text))
    place = 0
    while True:
        change = PythonMutants(place)
        tree = ast.fix_missing_locations(change.visit(ast.parse(text)))
        if change.left >= 0:
            return
        new = ast.unparse(tree)
        lines = [(a, b) for a, b in zip(original.splitlines(), new.splitlines(), strict=True) if a != b]
        if lines:
            yield Mutant(change.line, f"{lines[0][0].strip()}  ->  {lines[0][1].strip()}", new)
        place += 1


def guard_survives(mutant: Mutant) -> bool:
    """Whether the guard's tests pass with a host library made of this change."""
    return _firmware_survives(
        GUARD, mutant, tuple(f"tests/firmware/test_guard{part}.py" for part in ("", "_safety", "_latch"))
    )


def motion_survives(mutant: Mutant) -> bool:
    """Whether the motion monitor's tests pass with a host library made of this change."""
    return _firmware_survives(MOTION, mutant, ("tests/firmware/test_motion.py",))


def _firmware_survives(source: Path, mutant: Mutant, tests: tuple[str, ...]) -> bool:
    with tempfile.TemporaryDirectory() as name:
        changed = Path(name) / source.name
        changed.write_text(mutant.text)
        others = [path for path in (ROOT / "firmware/core").glob("*.c") if path != source]
        sources = [changed, *others, ROOT / "firmware/generated/needle_rig.c"]
        built = subprocess.run(
            [sys.executable, "-m", "ziglang", "cc", "-std=c11", "-O1", "-w", "-fno-sanitize=all", "-fPIC",
             "-shared", "-I", ROOT / "firmware/core", *sources, "-o", Path(name) / "libneedle_rig_nodes.so"],
            capture_output=True, check=False,
        )  # fmt: skip
        if built.returncode:
            return False
        return _tests_pass(tests, lambda: _put({"NEEDLE_RIG_FIRMWARE": name}))


def control_survives(name: str, mutant: Mutant) -> bool:
    """Whether the tests of `needle_rig/control/{name}.py` pass with this change."""

    def replace() -> None:
        full = f"needle_rig.control.{name}"
        module = types.ModuleType(full)
        sys.modules[full] = module
        exec(compile(mutant.text, str(CONTROL / f"{name}.py"), "exec"), module.__dict__)

    return _tests_pass((f"tests/unit/control/test_{name}.py",), replace)


def _put(variables: dict[str, str]) -> None:
    os.environ.update(variables)


def _tests_pass(tests: tuple[str, ...], prepare: Callable[[], None]) -> bool:
    """Whether `tests` pass in a fork of this process, which has the slow imports behind it."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.chdir(ROOT)
            for stream in (1, 2):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
            with tempfile.TemporaryDirectory() as memory:
                _put({"HYPOTHESIS_STORAGE_DIRECTORY": memory})
                signal.alarm(LONGEST_S)
                prepare()
                code = int(pytest.main([*PYTEST, *tests]))
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def policy_mutants(_: str) -> Iterator[Mutant]:
    """Every threshold of the policy up and down; the text is where it stands and what it becomes."""
    from needle_rig.workbench.policy import POLICY, thresholds

    lines = POLICY_FILE.read_text().splitlines()
    for row in thresholds(POLICY):
        line = 1 + next(i for i, text in enumerate(lines) if text.startswith(f"    {row.name}: "))
        many = isinstance(row.value, tuple)
        whole = isinstance(row.value, int)
        for moved in (row.value + 1, row.value - 1) if whole else (3.0, 1.0 / 3.0):
            new = moved if whole else tuple(v * moved for v in row.value) if many else row.value * moved
            change = f"{row.group}.{row.name} {row.value} -> {new}"
            yield Mutant(line, change, json.dumps([row.group, row.name, new, row.guard]))


def policy_survives(mutant: Mutant) -> bool:
    """Whether the guard of a threshold passes with its changed value."""
    if not mutant.change:
        guards = {json.loads(m.text)[3] for m in policy_mutants("")}
        return _tests_pass(tuple(sorted(str(WORKBENCH_TESTS / guard) for guard in guards)), lambda: None)
    group, name, value, guard = json.loads(mutant.text)

    def replace() -> None:
        from needle_rig.workbench import policy

        value_ = tuple(value) if isinstance(value, list) else value
        part = dataclasses.replace(getattr(policy.POLICY, group), **{name: value_})
        policy.POLICY = dataclasses.replace(policy.POLICY, **{group: part})

    return _tests_pass((str(WORKBENCH_TESTS / guard),), replace)


TARGETS: dict[str, tuple[Path, Callable[[str], Iterator[Mutant]], Callable[[Mutant], bool]]] = {
    "guard": (GUARD, c_mutants, guard_survives),
    "motion": (MOTION, c_mutants, motion_survives),
    **{
        name: (CONTROL / f"{name}.py", python_mutants, functools.partial(control_survives, name))
        for name in CONTROL_FILES
    },
    "policy": (POLICY_FILE, policy_mutants, policy_survives),
}


def main() -> int:
    sys.path.insert(0, str(ROOT))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path, make, survives = TARGETS[options.target]
    mutants = list(make(path.read_text()))
    known = _explained(ROOT / "tests/mutation" / f"{options.target}.txt")
    for module in ("hypothesis.strategies", "cffi", "cantools", "elftools.elf.elffile", *SLOW_IMPORTS):
        importlib.import_module(module)
    if not survives(Mutant(0, "", path.read_text())):
        sys.exit("the tests fail without any change; mend that first")
    alive = [mutant for mutant in mutants if survives(mutant)]
    unexplained = [m for m in alive if m.change not in known]
    for mutant in unexplained:
        print(f"{path.relative_to(ROOT)}:{mutant.line}: {mutant.change}")
    same = len(alive) - len(unexplained)
    print(
        f"{len(mutants)} changes, {len(mutants) - len(alive)} noticed, {same} without a difference, "
        f"{len(unexplained)} survive"
    )
    if options.json:
        options.json.write_text(json.dumps([{"line": m.line, "change": m.change} for m in alive], indent=1))
    return bool(unexplained)


def _explained(path: Path) -> set[str]:
    lines = path.read_text().splitlines() if path.exists() else []
    return {line.split("  #")[0].strip() for line in lines if line and not line.startswith("#")}


if __name__ == "__main__":
    sys.exit(main())
