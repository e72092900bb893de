"""Packages that fail in every way that the code of one can: at its import, and when what it brings is called."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from telenano.settings.plugins import KINDS
from telenano.testing import environment_with, install_package

NOISE = "NOISE OF A PACKAGE"
# Lines that a package runs, at its import or in what it brings.
RAISES = {
    "a text that cannot be made": "class E(Exception):\n    def __str__(self): raise self\nraise E()",
    "a base exception with a text that ends the program": (
        "class E(BaseException):\n    def __str__(self): raise SystemExit(0)\n    __repr__ = __str__\nraise E()"
    ),
    "a text that is none": "class E(Exception):\n    def __str__(self): return None\nraise E()",
    "a group with an interruption": "raise BaseExceptionGroup('g', [KeyboardInterrupt()])",
    "a group of groups": "raise ExceptionGroup('g', [ExceptionGroup('h', [ValueError('inner'), OSError(5, 'x')])])",
    "an interruption": "raise KeyboardInterrupt",
    "the end of a generator": "raise GeneratorExit",
    "the end of an iterator": "raise StopIteration",
    "a cancelled task": "import asyncio\nraise asyncio.CancelledError",
    "the end of the program": "raise SystemExit(3)",
    "the end of the program by an object": "raise SystemExit(object())",
    "what a terminal obeys": "raise ValueError('a\\nb` c\\x1b[2J\\u202e\\ud800' * 9)",
    "a megabyte": "raise ValueError('x' * 1000000)",
    "an error of the system": "open('/nonexistent/x')",
    "no end of calls": "def f(): f()\nf()",
    "no memory": "raise MemoryError",
    "a closed pipe": "raise BrokenPipeError",
    "the end of a command": "import typer\nraise typer.Exit(0)",
    "a wrong option": "import typer\nraise typer.BadParameter('bad')",
    "an error of our own": "from telenano.wire import ConfigError\nraise ConfigError('mine')",
    "a warning": "import warnings\nwarnings.simplefilter('error')\nwarnings.warn('old')",
}
LEAVES = {
    "prints": f"print({NOISE!r})",
    "closes the output": "import sys\nsys.stdout.close()",
    "closes the errors": "import sys\nsys.stderr.close()",
    "closes the descriptors": "import os\nos.close(1)\nos.close(2)",
    "takes the output away": "import sys\nsys.stdout = None",
    "takes the errors away": "import sys\nsys.stderr = None",
    "brings another thing": "IT = 3",
    "brings nothing": "IT = None",
    "brings what nothing can be asked": (
        "class O:\n    def __getattribute__(self, name): raise KeyboardInterrupt\n"
        "    __call__ = __repr__ = __str__ = __eq__ = __hash__ = __iter__ = lambda *words: 1 / 0\nIT = O()"
    ),
}
AT_IMPORT = {**RAISES, **LEAVES}
# The rows of a package's commands.
ROWS = {
    "rows that are a number": "7",
    "rows that are a text": "'evil'",
    "rows that are a list": "[1, 2]",
    "a row without a text": "{'evil': ('hollow.it:run', None)}",
    "a row with an empty text": "{'evil': ('hollow.it:run', '')}",
    "a row of one": "{'evil': ('hollow.it:run',)}",
    "a row of three": "{'evil': ('hollow.it:run', 'Do.', 3)}",
    "a row that is a text": "{'evil': 'hollow.it:run'}",
    "a row whose name is a number": "{3: ('hollow.it:run', 'Do.')}",
    "a row without a name": "{'': ('hollow.it:run', 'Do.')}",
    "a row of control characters": "{'ev\\x1bil': ('hollow.it:run', 'D\\x1b[2Jo\\n\\n`x`.')}",
    "a row without a function": "{'evil': ('hollow.it', 'Do.')}",
    "a row of nothing": "{None: None}",
    "a row whose text is odd": "{'evil': ('hollow.it:run', 'Do.\\ud800\\u202e')}",
}
# Every command line has to work, whatever a package does that it does not name.
OTHERS = (
    *(
        "--help",
        "--help-all",
        "--version",
        "law list",
        "law list --json",
        "scenario check fig12",
        "scenario list --json",
    ),
    *("param get controller.law --json", "device list --json", "bag info DEMO --json", "bag --help", "doctor --json"),
)
# What calls the code of a package, and the name of the package in what it says.
CALLS = ("evil", "bag evil", "bag export DEMO --to evil --out made", "doctor --json")

_PROGRAM = """
import json, sys
from dataclasses import asdict
from ended_commands import ended
told = {}
for line in json.load(sys.stdin):
    end = ended(line.split(), 20.0)
    told[line] = end if isinstance(end, str) else asdict(end)
json.dump(told, sys.stdout)
"""


def told_with(folder: Path, files: Mapping[str, str], entries: Mapping[str, Mapping[str, str]],
              lines: Sequence[str], demo: Path) -> dict[str, Any]:  # fmt: skip
    """Return how each command line ends where a package of these files is installed."""
    site = folder / "site"
    install_package(site, "hollow", files, entries)
    here = environment_with(site, TELENANO_RUNTIME_DIR=str(folder / "run"), HOME=str(folder))
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM],
        input=json.dumps([line.replace("DEMO", str(demo)) for line in lines]),
        capture_output=True, text=True, cwd=folder, env=here, check=True,
    )  # fmt: skip
    return dict(zip(lines, json.loads(done.stdout).values(), strict=True))


def fails_at_import(folder: Path, source: str, demo: Path, lines: Sequence[str] = OTHERS) -> dict[str, Any]:
    """Return how the commands end that do not name a package, whose entries of all kinds are of one module."""
    entries = {kind: {f"evil_{kind}": "hollow.it:IT"} for kind in KINDS} | {"topics": {"wind_evil": "hollow.it:IT"}}
    return told_with(folder, {"__init__.py": "", "it.py": f"{source}\n"}, entries, lines, demo)


def fails_in_call(folder: Path, source: str, demo: Path, lines: Sequence[str] = CALLS) -> dict[str, Any]:
    """Return how the commands end that call a function of a package."""
    inner = "".join(f"    {line}\n" for line in source.splitlines())
    module = f"def run(json: bool = False):\n{inner}\ndef call(*words):\n{inner}"
    rows = "ROWS = {'evil': ('hollow.it:run', 'Do.'), 'bag evil': ('hollow.it:run', 'Do.')}\n"
    entries = {
        "commands": {"rows": "hollow.rows:ROWS"},
        "exports": {"evil": "hollow.it:call"},
        "checks": {"evil": "hollow.it:call"},
    }
    return told_with(folder, {"__init__.py": "", "it.py": module, "rows.py": rows}, entries, lines, demo)


def has_rows(folder: Path, rows: str, demo: Path, lines: Sequence[str] = OTHERS) -> dict[str, Any]:
    """Return how the commands end that do not name a package whose rows of commands are these."""
    files = {"__init__.py": "", "rows.py": f"ROWS = {rows}\n", "it.py": "def run():\n    pass\n"}
    return told_with(folder, files, {"commands": {"rows": "hollow.rows:ROWS"}}, lines, demo)
