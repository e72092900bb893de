"""Programs of others, each installed from its registry into a folder of its own, outside the repository.

The folder is `$TELENANO_FOREIGN_PROGRAMS`, or `telenano-foreign-programs` in the user's cache, and is kept for the next
run. A program that cannot be installed on this machine skips its test with the words of the client of the registry.
Python programs run in the interpreter that the virtual environment is made from, so that they import nothing of it.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from telenano.signals import run

# How long an installation may take [s]; a test of `make check` may take 300 s.
_LONGEST_S = 240.0
# How long a program may take [s].
_PATIENCE_S = 120.0
_LIBRARIES = "LD_LIBRARY_PATH"


class Program(NamedTuple):
    """A program of another project: its folder, the command that starts it, and the environment that it needs."""

    folder: Path
    command: tuple[str, ...]
    environment: Mapping[str, str] = {}

    def having(self, **variables: str | Path) -> "Program":
        """Return the program with further variables in its environment."""
        return self._replace(environment={**self.environment, **{key: str(value) for key, value in variables.items()}})

    def run(self, *words: str | Path, **options: Any) -> str:
        """Run the program with further words and return what it prints; the options are those of `subprocess.run`.

        Raises:
            AssertionError: It ended with another code than 0; the message is what it said.
        """
        kept = {"capture_output": True, "text": True, "check": False, "timeout": _PATIENCE_S}
        done = run(
            [*self.command, *(os.fspath(word) for word in words)],
            env={**bare_environment(), **self.environment},
            **kept | options,
        )
        assert done.returncode == 0, f"{self.command[0]} ended with {done.returncode}: {done.stderr or done.stdout}"
        return str(done.stdout)


def bare_environment() -> dict[str, str]:
    """Return the variables of this process without those that lead a Python to the modules of another one."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}


@cache
def python_program(*requirements: str) -> Program:
    """Install packages of PyPI, and return an interpreter that imports these and nothing of the project."""

    def install(folder: Path) -> None:
        words = ["install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:", "--target"]
        _ask([sys.executable, "-m", "pip", *words, os.fspath(folder), *requirements])

    folder = _installed("python", requirements, install)
    interpreter = getattr(sys, "_base_executable", "") or sys.executable
    return Program(folder, (interpreter, "-B"), {"PYTHONPATH": os.fspath(folder), "PYTHONNOUSERSITE": "1"})


@cache
def debian_program(path: str, *packages: str) -> Program:
    """Unpack packages of Debian, with what they need and the machine lacks, and return the program at a path in them.

    Nothing becomes part of the machine's own system.
    """

    def install(folder: Path) -> None:
        archives = folder / "archives"
        (archives / "partial").mkdir(parents=True)
        options = (f"Dir::Cache::archives={archives}", "APT::Sandbox::User=root", "Debug::NoLocking=1")
        words = ["-qq", "--yes", "--no-install-recommends", "--download-only", "--reinstall"]
        _ask(["apt-get", *words, *(word for option in options for word in ("-o", option)), "install", *packages])
        for archive in sorted(archives.glob("*.deb")):
            _ask(["dpkg-deb", "--extract", os.fspath(archive), os.fspath(folder)])
        shutil.rmtree(archives)

    folder = _installed("debian", packages, install)
    libraries = sorted({os.fspath(found.parent) for found in folder.glob("**/*.so*")})
    return Program(folder, (os.fspath(folder / path),), {_LIBRARIES: os.pathsep.join(libraries)})


@cache
def node_program(*packages: str) -> Program:
    """Install packages of npm, and return a Node that runs modules which lie in their folder."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Node")

    def install(folder: Path) -> None:
        _ask(["npm", "install", "--silent", "--no-audit", "--no-fund", "--prefix", os.fspath(folder), *packages])

    return Program(_installed("node", packages, install), (node,))


def _installed(registry: str, packages: Sequence[str], install: Callable[[Path], None]) -> Path:
    """Return the folder of installed packages; it has its name once everything is in it."""
    home = os.environ.get("TELENANO_FOREIGN_PROGRAMS")
    cached = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "telenano-foreign-programs"
    folder = (Path(home) if home else cached) / registry / re.sub(r"[^\w.=-]+", "_", "+".join(packages))
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        begun = folder.with_name(f"{folder.name}.{os.getpid()}")
        try:
            begun.mkdir()
            install(begun)
            if not folder.is_dir():
                begun.rename(folder)
        finally:
            shutil.rmtree(begun, ignore_errors=True)
    return folder


def _ask(command: Sequence[str]) -> None:
    """Run the client of a registry, and skip the test with its last words where it fails."""
    if shutil.which(command[0]) is None:
        pytest.skip(f"needs {command[0]}")
    given: dict[str, Any] = {"capture_output": True, "text": True, "check": False, "timeout": _LONGEST_S}
    try:
        done = run(command, env=bare_environment(), **given)
    except subprocess.TimeoutExpired:
        pytest.skip(f"{' '.join(command[:2])} did not install {command[-1]} within {_LONGEST_S:.0f} s")
    if done.returncode != 0:
        words = (done.stderr or done.stdout).strip().splitlines() or [f"code {done.returncode}"]
        pytest.skip(f"{' '.join(command[:2])} did not install {command[-1]}: {words[-1]}")
