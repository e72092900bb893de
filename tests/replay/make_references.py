"""Run the reference sessions and write their digests to `digests.json`; print what is not as it was there.

    python tests/replay/make_references.py [NAME ...]

To be run when the wire changes, or when a law, a model, a node or the link is meant to behave differently. A difference
for any other reason is what the digests are there to find.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from references import (
    DIGESTS,
    REFERENCES,
    Field,
    additions,
    c_library,
    differences,
    digests_of,
    read_digests,
    record,
    write_digests,
)

from telenano.recording.reader import Recording


def make(names: Sequence[str], path: Path = DIGESTS) -> list[str]:
    """Run the references of these names, write their digests, and return what changed in sentences."""
    library, kept = read_digests(path) if path.exists() else (c_library(), {})
    sessions: dict[str, dict[str, dict[str, Field]]] = {}
    changed = [] if library == c_library() else [f"the C library gives other bits than that of {path.name}"]
    for name in REFERENCES:
        if name not in names and name in kept:
            sessions[name] = kept[name]
            continue
        with tempfile.TemporaryDirectory() as folder:
            sessions[name] = digests_of(Recording(record(name, Path(folder))))
        before = kept.get(name, {})
        told = differences(before, sessions[name], same_bits=True) + additions(before, sessions[name])
        changed += [f"{name}: {text}" for text in (told if before else ["is a new reference"])]
    write_digests(sessions, path)
    return changed + [f"{name}: is not a reference any more" for name in kept if name not in REFERENCES]


def shortened(told: Sequence[str], most: int = 4) -> list[str]:
    """Return the first sentences about each channel, and how many more there are."""
    about: dict[str, list[str]] = {}
    for text in told:
        about.setdefault(":".join(text.split(":")[:2]), []).append(text)
    lines = []
    for channel, texts in about.items():
        lines += texts[:most]
        lines += [f"{channel}: {len(texts) - most} other fields as well"] * (len(texts) > most)
    return lines or ["nothing changed"]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Run the reference sessions and write their digests.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(REFERENCES)}; default: all")
    chosen = parser.parse_args().names or list(REFERENCES)
    if unknown := sorted(set(chosen) - set(REFERENCES)):
        parser.error(f"{', '.join(unknown)}: no reference; they are {', '.join(REFERENCES)}")
    sys.stdout.write("\n".join(shortened(make(chosen))) + "\n")
