"""The files changed on this branch: those that differ from the commit at which it left main."""

import functools
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def git(*words: str) -> str | None:
    """Return the output of git in this repository; None if git is missing or fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout


@functools.cache
def base() -> str | None:
    """Return the commit at which this branch left main; None if there is no main."""
    found = git("merge-base", "HEAD", "main")
    return found if found is None else found.strip()


@functools.cache
def changed() -> frozenset[str]:
    """Return the paths that differ from that commit (from HEAD without main), and the untracked ones.

    A moved file is not included, even if its imports were adapted.
    """
    listed = (
        git("diff", "--name-only", "--diff-filter=r", base() or "HEAD"),
        git("ls-files", "--others", "--exclude-standard"),
    )
    return frozenset(path for text in listed for path in (text or "").splitlines())


def touches(*places: str) -> bool:
    """Return whether a changed file is one of the places, or lies in one of them that is a folder (written with /)."""
    return any(
        path == place or (place.endswith("/") and path.startswith(place)) for path in changed() for place in places
    )
