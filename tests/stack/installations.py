"""Interpreters that have the wheel of the project and nothing of the environment of the tests."""

import os
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())


def requirements(name: str, extras: tuple[str, ...]) -> list[str]:
    """Return what a distribution requires with these extras; of this project what its settings say now."""
    if name == "telenano":
        own = SETTINGS["project"]
        return own["dependencies"] + [text for extra in extras for text in own["optional-dependencies"][extra]]
    return distribution(name).requires or []


def closure(extras: tuple[str, ...]) -> set[str]:
    """Return the names of all distributions that pip would install beside telenano with these extras."""
    waiting: list[tuple[str, tuple[str, ...]]] = [("telenano", extras)]
    found = set()
    while waiting:
        name, wanted = waiting.pop()
        if (name, wanted) in found:
            continue
        found.add((name, wanted))
        for text in requirements(name, wanted):
            requirement = Requirement(text)
            if requirement.marker is None or any(
                requirement.marker.evaluate({"extra": extra}) for extra in ("", *wanted)
            ):
                waiting.append((requirement.name, tuple(sorted(requirement.extras))))
    return {name for name, _ in found} - {"telenano"}


class Installation:
    """An interpreter that has the wheel and what its extras bring, and nothing else of the environment of the tests."""

    def __init__(self, folder: Path, wheel: Path, extras: tuple[str, ...]) -> None:
        self.folder = folder
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "venv")], check=True, timeout=120)
        self.python = folder / "venv" / "bin" / "python"
        (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
        self.add(wheel)
        for name in closure(extras):
            here = distribution(name)
            tops = {path.parts[0] for path in here.files or () if path.parts[0] not in ("..", "__pycache__")}
            for top in tops:
                place = site / top
                if not place.exists():
                    place.symlink_to(str(here.locate_file(top)))

    def add(self, wheel: Path) -> None:
        pip = [sys.executable, "-P", "-m", "pip", "--python", str(self.python), "install", "--quiet"]
        subprocess.run([*pip, "--no-deps", "--no-index", str(wheel)], check=True, timeout=120)

    def telenano(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = self.folder / "venv" / "bin" / "telenano"
        return self.run(str(command), *arguments)

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA"))}
        environment = {**kept, "HOME": str(self.folder), "TELENANO_RUNTIME_DIR": str(self.folder / "run")}
        return subprocess.run(command, env=environment, cwd=self.folder, capture_output=True, text=True, timeout=600)


def built(folder: Path) -> Path:
    """Build the wheel in a folder."""
    # the page of the view is built by npm, which this is not about
    unwanted = shutil.ignore_patterns("node_modules", "dist", "__pycache__", "build_page.py")
    for name in SETTINGS["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        shutil.copytree(ROOT / name, folder / "source" / name, ignore=unwanted)
    for name in ("pyproject.toml", "README.md", "hatch_build.py"):
        shutil.copy(ROOT / name, folder / "source")
    return wheel_of(folder / "source", folder)


def wheel_of(source: Path, folder: Path) -> Path:
    """Build the wheel of a folder with sources in another one."""
    pip = [sys.executable, "-P", "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--wheel-dir", str(folder), str(source)], check=True, timeout=300)
    (found,) = folder.glob("*.whl")
    return found
