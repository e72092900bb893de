"""Make what a release consists of, and try it: `make dist` runs this with the Python of `.venv`.

In the folder that is given: wheel and source distribution, a wheel of each of packages/, how they are installed
(docs/install.md), an inventory of all that they and the extra `rig` bring (CycloneDX), the list of their licences, and
SHA256SUMS. Each is made from the commit, dated by it, so that the same commit gives the same bytes; the wheel is made
from the source distribution alone. Then `rehearsal.py` does what docs/install.md says with every Python from 3.11 to
3.14 that the machine has.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterable, Sequence
from importlib.metadata import Distribution, distributions
from pathlib import Path

ROOT = Path(__file__).parents[2]
REHEARSAL = Path(__file__).with_name("rehearsal.py")
# What the inventory is made of: all but Gwyddion's converter, which is a program of its own.
EXTRAS = {
    "telenano": "rig",
    "telenano_bridges": "foxglove,lsl,nexus,protobuf,ros2,tables",
    "telenano_devices": "emulators",
    "telenano_lab": "experiments,files,learning",
}
PYTHONS = ("python3.11", "python3.12", "python3.13", "python3.14")
# Words of the licences that ask something of who passes the package on, beside naming it.
COPYLEFT = ("GPL", "MPL", "EPL", "CDDL", "GNU")
# in every environment
APART = ("pip", "setuptools")
# A wheel has no tests and none of what the page is built from.
FORBIDDEN = ("tests/", "docs/", "services/viz_node/web/src/", "benchmarks/")
WANTED = (
    "telenano/py.typed",
    "telenano/settings/demo.mcap",
    "telenano/settings/scenarios/fig12.yaml",
    "services/viz_node/web/dist/index.html",
)
# A source distribution has what its tests need and nothing that is made from it.
FORBIDDEN_IN_SOURCE = ("out/", ".venv/", "services/viz_node/web/node_modules/", "services/viz_node/web/dist/")
WANTED_IN_SOURCE = (
    "pyproject.toml",
    "requirements.lock",
    "deploy/Dockerfile",
    "compose.yaml",
    "Makefile",
    "tests/conftest.py",
    "services/viz_node/web/package-lock.json",
)


class ReleaseError(Exception):
    """The release cannot go out; the text says why."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Make and try a release; return 1 with the reason on stderr where it cannot go out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, help="the wheel of an earlier version, to upgrade from and go back to")
    parser.add_argument("--out", type=Path, default=Path("out/dist"), help="folder for the release; replaced")
    given = parser.parse_args(arguments)
    try:
        release(given.out, given.before)
    except (ReleaseError, subprocess.CalledProcessError) as error:
        print(f"release: {error}", file=sys.stderr)
        return 1
    return 0


def release(out: Path, before: Path | None) -> None:
    """Write the files of a release into a folder and try them, with an upgrade from the wheel of before, if any."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    wheel = built(out)
    for one in sorted(out.glob("*.whl")):
        check_wheel(one, WANTED if one == wheel else ())
    (source,) = out.glob("telenano-*.tar.gz")
    check_source(source)
    run([sys.executable, "-P", "-m", "twine", "check", "--strict", *map(str, sorted(out.glob("telenano*")))])
    rig = installed(out)
    inventory = [str(Path(sys.executable).parent / "cyclonedx-py"), "environment", str(rig), "--output-reproducible"]
    run([*inventory, "--of", "JSON", "-o", str(out / "sbom.json")])
    found = distributions(path=[site_of(rig)])
    packages = [one for one in found if is_brought(one.metadata["Name"])]
    (out / "licences.md").write_text(licences(packages), encoding="utf-8")
    brought = brought_with(packages)
    shutil.rmtree(out / "rig")
    shutil.copy(ROOT / "docs" / "install.md", out)
    names = sorted(path for path in out.iterdir() if path.is_file())
    sums = "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in names)
    (out / "SHA256SUMS").write_text(sums, encoding="utf-8")
    there = [python for python in PYTHONS if starts(python)]
    for python in there:
        print(run([python, "-P", str(REHEARSAL), str(out), *(["--before", str(before)] if before else [])]), end="")
    if missing := [python for python in PYTHONS if python not in there]:
        print(f"not tried, because they are not on this machine: {', '.join(missing)}")
    print(brought)
    print(f"in {out}, each with its SHA-256 in SHA256SUMS: {', '.join(path.name for path in names)}")


def built(out: Path) -> Path:
    """Build source distribution and wheels, packages/ included, dated by the commit; return the wheel of the core."""
    date = run(["git", "log", "-1", "--format=%ct"]).strip()
    command = [sys.executable, "-P", "-m", "build", "--outdir", str(out)]
    packages = [["--wheel", str(path.parent)] for path in sorted(ROOT.glob("packages/*/pyproject.toml"))]
    for arguments in ([str(ROOT)], *packages):
        run([*command, *arguments], env={**os.environ, "SOURCE_DATE_EPOCH": date})
    (wheel,) = out.glob("telenano-*.whl")
    return wheel


def check_wheel(wheel: Path, wanted: Sequence[str]) -> None:
    """Raise ReleaseError if a wheel lacks a part that is wanted, or has one that is for developers."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    if lacks := [name for name in wanted if name not in names]:
        raise ReleaseError(f"{wheel.name}: lacks {', '.join(lacks)}")
    if extra := [name for name in names if name.startswith(FORBIDDEN) or "/tests/" in name]:
        raise ReleaseError(f"{wheel.name}: has {extra[0]} and {len(extra) - 1} more that do not belong into it")


def check_source(source: Path) -> None:
    """Raise ReleaseError if a source distribution lacks a part, or has one that is made from the others."""
    with tarfile.open(source) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    if lacks := [name for name in WANTED_IN_SOURCE if name not in names]:
        raise ReleaseError(f"{source.name}: lacks {', '.join(lacks)}")
    if extra := [name for name in names if name.startswith(FORBIDDEN_IN_SOURCE)]:
        raise ReleaseError(f"{source.name}: has {extra[0]} and {len(extra) - 1} more that are made from the others")


def installed(out: Path) -> Path:
    """Install all wheels of a folder with the extras of EXTRAS into an environment; return the interpreter there."""
    run([sys.executable, "-P", "-m", "venv", str(out / "rig")])
    interpreter = (out / "rig" / "bin" / "python").absolute()
    wheels = [f"{wheel}[{EXTRAS.get(wheel.name.partition('-')[0], '')}]" for wheel in out.glob("*.whl")]
    run([str(interpreter), "-P", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *sorted(wheels)])
    return interpreter


def starts(python: str) -> bool:
    """Return whether an interpreter is there; a name that a version manager has put there may have none behind it."""
    found = shutil.which(python)
    return (
        found is not None and subprocess.run([found, "-P", "-c", ""], capture_output=True, check=False).returncode == 0
    )


def site_of(interpreter: Path) -> str:
    """Return the folder of the packages of an environment."""
    return run([str(interpreter), "-P", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]).strip()


def licences(found: Iterable[Distribution]) -> str:
    """Return a table of packages, versions and licences; those that ask more than to be named come first."""
    rows = sorted(
        {(one.metadata["Name"], one.version, licence_of(one)) for one in found}, key=lambda row: row[0].lower()
    )
    rows = [row for row in rows if is_brought(row[0])]
    rows.sort(key=lambda row: not asks_more(row[2]))
    lines = [
        f"| {name} | {version} | {licence}{' **(copyleft)**' if asks_more(licence) else ''} |"
        for name, version, licence in rows
    ]
    head = "# Licences of what the extra `rig` and the packages install\n\nAs each package states it.\n\n"
    head += "| package | version | licence |\n|---|---|---|\n"
    return head + "\n".join(lines) + "\n"


def brought_with(packages: Sequence[Distribution]) -> str:
    """Return in a sentence how many packages there are, and which ask more than to be named."""
    found = [f"{one.metadata['Name']} ({licence_of(one)})" for one in packages if asks_more(licence_of(one))]
    asking = ", ".join(found) or "none"
    return f"rig and packages bring {len(packages)} distributions; more than to be named is asked by {asking}"


def is_brought(name: str) -> bool:
    """Return whether a distribution comes from somebody else, and with ours."""
    return name not in APART and not name.startswith("telenano")


def asks_more(licence: str) -> bool:
    """Return whether the name of a licence has a word of those that bind who passes the package on."""
    return any(word in licence for word in COPYLEFT)


def licence_of(one: Distribution) -> str:
    """Return the licence of a package by its expression, its classifiers, or the first line of its text."""
    metadata = one.metadata
    expression = metadata.get("License-Expression")
    if expression:
        return str(expression)
    classified = [
        line.rpartition(" :: ")[2] for line in metadata.get_all("Classifier") or () if line.startswith("License")
    ]
    if classified:
        return ", ".join(dict.fromkeys(classified))
    text = (metadata.get("License") or "").strip()
    return text.splitlines()[0][:60] if text else "not stated"


def run(command: Sequence[str], **options: object) -> str:
    """Run a command in the repository; CalledProcessError with what it said where it fails."""
    done = subprocess.run(command, **{"cwd": ROOT, "capture_output": True, "text": True, **options})  # type: ignore[call-overload]
    if done.returncode:
        raise ReleaseError(f"{' '.join(command)}: {(done.stderr or done.stdout).strip()[-2000:]}")
    return str(done.stdout)


if __name__ == "__main__":
    raise SystemExit(main())
