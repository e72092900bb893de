"""Mutation tests of the modules that guard, account or decide: change one thing at a time and see whether a test fails.

`make mutation` takes a seeded sample of the possible mutants of each module in `mutated_modules.py`, puts each one into
a copy of the tree, and runs the tests that the table names for the module. A mutant is killed if a test fails or if the
tests take much longer than without it. A survivor is printed with its difference: it needs a test, or an entry among
the equivalents of `mutated_modules.py` with the reason why it changes nothing.
"""

import argparse
import ast
import difflib
import os
import queue
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, cast

from mutated_modules import EQUIVALENT, MODULES

ROOT = Path(__file__).resolve().parents[2]
SEED, SAMPLE, LEAST_SHARE = 25, 40, 0.9
# a mutant that allocates without end is stopped by this and not by the machine
_MOST_BYTES = 8 << 30

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}


class Mutant(NamedTuple):
    """A changed module; name: function, line, what was there, and what is there now."""

    name: str
    source: str


class Change(NamedTuple):
    """One possible change: the node that is replaced, and by what."""

    scope: str
    node: ast.expr | ast.stmt
    text: str


def changes(tree: ast.AST, scope: str = "") -> Iterator[Change]:
    """Yield every change of a module in the order of its nodes; texts, annotations and imports are left alone."""
    for node in ast.iter_child_nodes(tree):
        inner = scope
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inner = f"{scope}.{node.name}".lstrip(".")
        if isinstance(node, ast.expr | ast.stmt):
            yield from (Change(scope, node, text) for text in _replacements(node))
        yield from changes(_without_annotations(node), inner)


def _without_annotations(node: ast.AST) -> ast.AST:
    """Return what of a node can be changed: no annotation, decorator, formatted text or import."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        # `iter_child_nodes` asks only for a list of nodes
        defaults: list[Any] = [*node.args.defaults, *(value for value in node.args.kw_defaults if value is not None)]
        return ast.Module([*defaults, *node.body], [])
    if isinstance(node, ast.ClassDef):
        return ast.Module(node.body, [])
    if isinstance(node, ast.AnnAssign):
        return ast.Module([cast(Any, node.value)] if node.value else [], [])
    if isinstance(node, ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Raise):
        return ast.Module([], [])
    return node


def _replacements(node: ast.expr | ast.stmt) -> Iterator[str]:
    """Yield what can stand instead of a node."""
    match node:
        case ast.Compare():
            for place, operator in enumerate(node.ops):
                for other in _COMPARISONS[type(operator)]:
                    ops = [*node.ops[:place], other(), *node.ops[place + 1 :]]
                    yield ast.unparse(ast.Compare(node.left, ops, node.comparators))
        case ast.BoolOp():
            yield ast.unparse(ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values))
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield ast.unparse(node.operand)
        case ast.Constant(value=bool() as value):
            yield str(not value)
        case ast.Constant(value=int() as number):
            yield str(number + 1 if abs(number) < 100 else 2 * number)
        case ast.Constant(value=float() as real):
            yield repr(2.0 * real if real else 1.0)
        case ast.BinOp() if type(node.op) in _ARITHMETIC and not _is_text(node):
            yield ast.unparse(ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right))
        case ast.AugAssign() if type(node.op) in _ARITHMETIC:
            yield ast.unparse(ast.AugAssign(node.target, _ARITHMETIC[type(node.op)](), node.value))
            yield "pass"
        case ast.Call(func=ast.Name(id="min" | "max" as called), args=[first, second, *_]):
            yield ast.unparse(ast.Call(ast.Name("max" if called == "min" else "min"), node.args, node.keywords))
            yield from (ast.unparse(first), ast.unparse(second))
        case ast.Call(func=ast.Name(id="abs" | "any" | "all"), args=[only]):
            yield ast.unparse(only)
        case ast.IfExp():
            yield from (ast.unparse(node.body), ast.unparse(node.orelse))
        case ast.Expr(value=ast.Call()) | ast.Delete() | ast.Break() | ast.Continue():
            yield "pass"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield "pass"


def _is_text(node: ast.BinOp) -> bool:
    parts = (node.left, node.right)
    return any(
        isinstance(p, ast.JoinedStr) or (isinstance(p, ast.Constant) and isinstance(p.value, str)) for p in parts
    )


def conditions(tree: ast.AST, scope: str = "") -> Iterator[Change]:
    """Yield for each `if` and `while` of a module the change that never enters it."""
    for node in ast.iter_child_nodes(tree):
        inner = scope
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inner = f"{scope}.{node.name}".lstrip(".")
        if isinstance(node, ast.If | ast.While) and ast.unparse(node.test) != "TYPE_CHECKING":
            yield Change(inner, node.test, "False")
        yield from conditions(node, inner)


def mutants(source: str) -> list[Mutant]:
    """Return all mutants of a module, each with a name of its own."""
    tree = ast.parse(source)
    lines = source.encode().splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))
    found: list[Mutant] = []
    counts: dict[str, int] = {}
    for scope, node, text in (*changes(tree), *conditions(tree)):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        whole = source.encode()
        put = text if isinstance(node, ast.stmt) else f"({text})"
        name = f"{scope or 'module'}: {lines[node.lineno - 1].decode().strip()} [{ast.unparse(node)} => {text}]"
        counts[name] = counts.get(name, 0) + 1
        name += f" ({counts[name]})" if counts[name] > 1 else ""
        found.append(Mutant(name, (whole[:begin] + put.encode() + whole[end:]).decode()))
    return found


def sampled(module: str, source: str, count: int, seed: int) -> list[Mutant]:
    """Return `count` mutants of a module, the same ones for the same source and seed; all where there are fewer."""
    every = mutants(source)
    chosen = random.Random(f"{seed} {module}").sample(range(len(every)), min(count, len(every)))
    return [every[number] for number in sorted(chosen)]


def copy_of_tree(folder: Path) -> Path:
    """Copy the files of the working tree that git knows or would add."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def tests_pass(folder: Path, tests: tuple[str, ...], timeout_s: float | None) -> bool:
    """Return whether the tests pass in a copy of the tree within a time."""
    # numba compiles nothing here: a mutant would wait longer for its compiler than for its tests
    own = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_DISABLE_JIT": "1"}
    marked = ["-m", "not stack and not endurance"]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *marked, *tests]
    with subprocess.Popen(
        command, cwd=folder, env={**os.environ, **own}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (_MOST_BYTES,) * 2),
    ) as process:  # fmt: skip
        try:
            return process.wait(timeout_s) == 0
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return False


def run_module(module: str, folders: "queue.Queue[Path]", pool: ThreadPoolExecutor, count: int, seed: int) -> float:
    """Try the mutants of one module, print what came, and return the share killed of those that change anything."""
    tests, source = MODULES[module], (ROOT / module).read_text()
    equivalent = EQUIVALENT.get(module, {})

    def survives(changed: str, timeout_s: float | None) -> bool:
        folder = folders.get()
        try:
            (folder / module).write_text(changed)
            return tests_pass(folder, tests, timeout_s)
        finally:
            (folder / module).write_text(source)
            folders.put(folder)

    begun = time.monotonic()
    if not survives(source, None):
        sys.exit(f"{module}: its tests fail without a mutant: {' '.join(tests)}")
    clean_s = time.monotonic() - begun
    timeout_s = 10.0 + 4.0 * clean_s
    # the tests have to see the copy, or every mutant would survive
    if survives(f"{source}\nraise RuntimeError('a mutant that every test sees')\n", timeout_s):
        sys.exit(f"{module}: its tests do not import it from the copy of the tree")
    chosen = sampled(module, source, count, seed)
    alive = [name in equivalent for name, _ in chosen]
    tried = [mutant for mutant, known in zip(chosen, alive, strict=True) if not known]
    outcomes = list(pool.map(lambda mutant: survives(mutant.source, timeout_s), tried))
    left = [mutant for mutant, survived in zip(tried, outcomes, strict=True) if survived]
    share = 1.0 - len(left) / len(tried) if tried else 1.0
    print(f"| {module} | {len(chosen)} | {len(tried) - len(left)} | {sum(alive)} | {len(left)} |"
          f" {100.0 * share:.0f} % | {clean_s:.1f} s |", flush=True)  # fmt: skip
    for mutant in left:
        print(f"  survivor  {mutant.name}")
        difference = difflib.unified_diff(source.splitlines(), mutant.source.splitlines(), n=0, lineterm="")
        print("\n".join(f"    {line}" for line in list(difference)[2:]), flush=True)
    return share


def main() -> int:
    """Run the mutants of the modules that are named, or of all; 1 where too many survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("module", nargs="*", choices=[*MODULES, []], help="path of a module; default: all of the table")
    parser.add_argument("--count", type=int, default=SAMPLE, help=f"mutants of each module; {SAMPLE}")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the sample; {SEED}")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="mutants that are tried side by side")
    given = parser.parse_args()
    print("| module | mutants | killed | equivalent | survivors | killed of the rest | tests |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder, ThreadPoolExecutor(given.workers) as pool:
        folders: queue.Queue[Path] = queue.Queue()
        for number in range(given.workers):
            folders.put(copy_of_tree(Path(folder) / str(number)))
        shares = [run_module(module, folders, pool, given.count, given.seed) for module in given.module or MODULES]
    return int(min(shares) < LEAST_SHARE)


if __name__ == "__main__":
    sys.exit(main())
