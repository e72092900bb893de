"""The files that a change touches: those that differ from the commit at which this branch left main."""

import functools
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def git(*words: str) -> str | None:
    """Return what git says here, None where there is no git or it fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout


@functools.cache
def base() -> str | None:
    """Return the commit at which this branch left main, None where there is no main."""
    found = git("merge-base", "HEAD", "main")
    return found if found is None else found.strip()


@functools.cache
def changed() -> frozenset[str]:
    """Return the paths that differ from that commit, and those that git does not know yet; without main only these.

    A file that was only moved, or moved with the imports that name its new place, is none of them.
    """
    listed = (
        git("diff", "--name-only", "--diff-filter=r", base() or "HEAD"),
        git("ls-files", "--others", "--exclude-standard"),
    )
    return frozenset(path for text in listed for path in (text or "").splitlines())


def touches(*places: str) -> bool:
    """Return whether the change touches one of some files, or a file in one of some folders, whose names end in /."""
    return any(
        path == place or (place.endswith("/") and path.startswith(place)) for path in changed() for place in places
    )
