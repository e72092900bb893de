"""Every place that writes a file, and every loop that reads, is in one of two tables, with its lock or its bound.

`written_files.md` has a row for each function that writes, `reader_loops.md` one for each function with a loop over a
reader. A new one has to be put in there, which asks for what was left out before: who else writes the file, and what
ends the loop.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("services", "telenano", "deploy", "packages")
TABLES = Path(__file__).parent
# What writes: functions by their name, methods by theirs, and functions of a module alone.
WRITES = {"write_whole", "changed", "atomic_file", "whole_folder", "whole_results", "mkstemp"}
WRITING_METHODS = {
    *("write_text", "write_bytes", "rename", "truncate", "ftruncate", "symlink_to", "hardlink_to", "tofile", "savefig"),
    *(
        "savez",
        "savez_compressed",
        "savetxt",
        "savemat",
        "imsave",
        "to_csv",
        "to_parquet",
        "write_table",
        "ParquetWriter",
    ),
}
_COPIES = ("copy", "copy2", "copyfile", "copyfileobj", "copytree", "move", "make_archive", "unpack_archive")
WRITES_OF = {("shutil", name) for name in _COPIES}
WRITES_OF |= {("np", "save"), ("os", "link"), ("os", "symlink"), ("os", "sendfile"), ("os", "copy_file_range")}
# These open a file for reading or for writing, as `open` does, by their second argument or by `mode`.
OPENERS = {"open", "fdopen", "ZipFile", "TarFile", "File", "GzipFile", "LZMAFile", "BZ2File", "memmap", "open_memmap"}
# A reader: what takes something of a socket, a pipe or a device, or waits for it.
READS = {"recv", "recv_multipart", "recv_into", "recvfrom", "recvfrom_into", "recvmsg", "recv_monitor_message", "poll",
         "accept", "recv_string", "recv_bytes"}  # fmt: skip
# These are readers of their modules alone: a recording has a `select` as well, and a file is read to its end.
READS_OF = {("select", "select"), ("zmq", "select"), ("os", "read")}
# To parse all modules takes seconds, and most have none of these.
_MAYBE_WRITES = re.compile(
    r"os\.open\(|(open|File|memmap)\([^)]*[\"'][rb]*[wax+]|\.replace\((?![\"'])|whole_|atomic_|mkstemp|np\.save\(|\bshutil\.|"
    r"\bos\.(link|symlink|sendfile|copy_file)|\.(" + "|".join(WRITING_METHODS) + r")\("
)
_MAYBE_READS = re.compile(r"\.(recv\w*|poll|accept)\b|\bos\.read|recv_monitor|\bselect\.select|zmq\.select")


def name_of(call: ast.Call) -> str:
    """Return the last name of what is called."""
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def mode_of(call: ast.Call) -> str:
    """Return the mode with which a call of `open` opens a file."""
    modules = ("io", "os", "gzip", "lzma", "bz2")
    is_method = name_of(call) == "open" and isinstance(call.func, ast.Attribute)
    is_method = is_method and getattr(getattr(call.func, "value", None), "id", "") not in modules
    places = call.args[0 if is_method else 1 :][:1] + [word.value for word in call.keywords if word.arg == "mode"]
    return next((str(each.value) for each in places if isinstance(each, ast.Constant)), "r")


def writes(call: ast.Call) -> bool:
    """Return whether a call writes a file, or puts one in the place of another."""
    name, owner = name_of(call), ast.unparse(getattr(call.func, "value", ast.Constant("")))
    if name == "open" and owner == "os":
        return any(flag in ast.unparse(call) for flag in ("O_CREAT", "O_WRONLY", "O_RDWR", "flags", "_OPEN"))
    if name in OPENERS:
        return any(letter in mode_of(call) for letter in "wax+")
    if (owner, name) in WRITES_OF:
        return True
    if name == "replace":
        # that of a path has one argument, that of a text two, and that of a structure only named ones
        return owner == "os" or (len(call.args) == 1 and not call.keywords and bool(owner))
    if name in WRITES:
        return isinstance(call.func, ast.Name)
    return name in WRITING_METHODS and bool(owner)


def reads(node: ast.AST) -> bool:
    """Return whether a loop takes something of a reader, or waits for one."""
    calls = [each for each in ast.walk(node) if isinstance(each, ast.Call)]
    owners = [(ast.unparse(getattr(call.func, "value", ast.Constant(""))), name_of(call)) for call in calls]
    return any(name in READS or (owner, name) in READS_OF for owner, name in owners)


def has_a_reader_by_another_name(node: ast.AST) -> bool:
    """Return whether a function gives the method of a reader to a name, and has a loop in which it may be called."""
    if isinstance(node, ast.ClassDef):
        return False
    parts = list(ast.walk(node))
    called = {id(each.func) for each in parts if isinstance(each, ast.Call)}
    named = (each for each in parts if isinstance(each, ast.Attribute) and each.attr.startswith("recv"))
    return any(isinstance(each, ast.While | ast.For) for each in parts) and any(
        id(each) not in called for each in named
    )


def places(tree: ast.AST, *, loops: bool) -> Iterator[str]:
    """Yield the names of the functions of a module that write, or that have a loop over a reader."""

    def within(node: ast.AST, names: tuple[str, ...]) -> Iterator[str]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                if loops and has_a_reader_by_another_name(child):
                    yield ".".join((*names, child.name))
                yield from within(child, (*names, child.name))
                continue
            if loops:
                is_found = isinstance(child, ast.While | ast.For | ast.AsyncFor) and reads(child)
            else:
                is_found = isinstance(child, ast.Call) and writes(child)
            if is_found:
                yield ".".join(names) or "module"
            yield from within(child, names)

    yield from within(tree, ())


@cache
def found(*, loops: bool) -> frozenset[str]:
    """Return every such place, as `path: function`."""
    maybe = _MAYBE_READS if loops else _MAYBE_WRITES
    rows = set()
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            inner = path.relative_to(ROOT)
            text = path.read_text(encoding="utf-8")
            if "tests" not in inner.parts and "node_modules" not in inner.parts and maybe.search(text):
                # `changed` is the name of another function as well
                whole = (
                    text
                    if "atomic_files" in text
                    or path.stem == "atomic_files"
                    or re.search(r"from telenano\.files import .*\bchanged\b", text)
                    else re.sub(r"\bchanged\(", "other(", text)
                )
                rows |= {f"{inner}: {name}" for name in places(ast.parse(whole), loops=loops)}
    return frozenset(rows)


def rows_of(name: str) -> list[list[str]]:
    """Return the cells of the rows of a table."""
    lines = (TABLES / name).read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    return rows[1:]


@pytest.mark.parametrize(("name", "loops"), [("written_files.md", False), ("reader_loops.md", True)])
def test_every_place_is_in_its_table(name: str, loops: bool) -> None:
    rows = rows_of(name)
    listed = [row[0].strip("`") for row in rows]
    assert listed == sorted(set(listed))
    new, gone = found(loops=loops) - set(listed), set(listed) - found(loops=loops)
    assert not new, f"put these into tests/contract/{name}, with what bounds or locks them: {sorted(new)}"
    assert not gone, f"these are not there any more: {sorted(gone)}"
    assert all(all(row) and len(row) == len(rows[0]) for row in rows)


@pytest.mark.parametrize(
    ("line", "loops"),
    [
        ("os.replace(a, b)", False), ("a.replace(b)", False), ("open(a, 'w')", False), ("a.open(mode='ab')", False),
        ("a.write_text(b)", False), ("os.open(a, os.O_RDWR | os.O_CREAT)", False), ("changed(a, b)", False),
        ("shutil.copyfile(a, b)", False), ("np.savez(a, b=c)", False), ("np.save(a, b)", False),
        ("zipfile.ZipFile(a, 'w')", False), ("h5py.File(a, 'w')", False), ("figure.savefig(a)", False),
        ("Path(a).write_bytes(b)", False), ("os.link(a, b)", False), ("np.memmap(a, mode='w+')", False),
        ("while a.poll(0): b()", True), ("for _ in range(9): a.recv()", True), ("while 1: zmq.select(a)", True),
        ("recv = a.recv\n    while b: recv()", True), ("while b: os.read(a, 9)", True),
    ],
)  # fmt: skip
def test_a_place_is_found(line: str, loops: bool) -> None:
    tree = ast.parse(f"class A:\n  def f(self):\n    {line}\n")
    assert set(places(tree, loops=loops)) == {"A.f"}
    assert not set(places(tree, loops=not loops))


@pytest.mark.parametrize(
    "line",
    [
        "shutil.which(a)",
        "zipfile.ZipFile(a)",
        "h5py.File(a, 'r')",
        "self.save(a)",
        "a.replace('x', 'y')",
        "replace(a, b=1)",
        "open(a)",
        "a.open('rb')",
        "while b: c()",
        "a.recv()",
        "a.select(b)",
    ],
)
def test_what_writes_and_reads_nothing_is_not_found(line: str) -> None:
    tree = ast.parse(f"def f():\n    {line}\n")
    assert not [*places(tree, loops=False), *places(tree, loops=True)]
