"""Install a made-up package of another author where Python finds it: its files, and its entry points by group."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def describe_package(
    site: Path, name: str, entries: Mapping[str, Mapping[str, str]], version: str = "1.2", more: str = ""
) -> None:
    """Write the metadata that pip writes for a package into a folder of packages; `more`: further lines of it."""
    facts = site / f"{name}-{version}.dist-info"
    facts.mkdir(parents=True, exist_ok=True)
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{more}")
    groups = (
        f"[telenano.{kind}]\n" + "".join(f"{entry} = {target}\n" for entry, target in rows.items())
        for kind, rows in entries.items()
    )
    (facts / "entry_points.txt").write_text("".join(groups))


def install_package(site: Path, name: str, files: Mapping[str, str], entries: Mapping[str, Mapping[str, str]]) -> None:
    """Write a package into a folder of packages.

    Args:
        site: The folder, which `environment_with` puts on the path of Python.
        name: The name of the package and its module.
        files: The text of each file in the package, by its name.
        entries: For each kind of entry point (`telenano.KIND`), the target of each name.
    """
    for file, text in files.items():
        (site / name / file).parent.mkdir(parents=True, exist_ok=True)
        (site / name / file).write_text(text)
    describe_package(site, name, entries)


def environment_with(site: Path, **more: str) -> dict[str, str]:
    """Return the environment of a process that can import the packages of a folder."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(site), *sys.path[1:]]), "COLUMNS": "500"} | more


def run_with(script: str, site: Path, *arguments: str, **more: str) -> str:
    """Run a script in a folder, in a process that can import its packages; return its output, fail if it fails."""
    command = [sys.executable, "-W", "error", "-c", script, *arguments]
    done = subprocess.run(
        command, cwd=site, capture_output=True, text=True, env=environment_with(site, **more), check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def said_with(script: str, site: Path, *arguments: str, **more: str) -> Any:
    """Return the document that a script prints as JSON; see `run_with`."""
    return json.loads(run_with(script, site, *arguments, **more))
