"""Check the title of a commit: `python tests/contract/commit_title.py FILE` reads the message that git has in FILE.

`page: keep Arm within reach after a stop` has an area, which is a part of the project in small letters, and what the
commit does, as a request without a full stop.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

LONGEST = 100
_TITLE = re.compile(r"[a-z0-9][a-z0-9 _./-]*: \S.*")
# Git writes these itself, or rewrites them later.
_BY_GIT = re.compile(r"(Merge |Revert \"|fixup! |squash! |amend! )")


def fault_of(message: str) -> str:
    """Return what is wrong with the title of a message, and what would be right; empty where nothing is."""
    lines = [line for line in message.splitlines() if not line.startswith("#")]
    title = next((line for line in lines if line.strip()), "")
    if _BY_GIT.match(title):
        return ""
    if not _TITLE.fullmatch(title):
        return f"{title!r} is not of the form `area: what`, such as `page: keep Arm within reach after a stop`"
    if title.endswith("."):
        return f"{title!r} ends with a full stop, which a title does not have"
    if len(title) > LONGEST:
        return f"the title has {len(title)} characters, and {LONGEST} at most: what is longer belongs below it"
    return ""


def main(arguments: Sequence[str]) -> int:
    """Return 1, with the reason on stderr, where the message in the file has a wrong title."""
    if fault := fault_of(Path(arguments[0]).read_text(encoding="utf-8")):
        sys.stderr.write(f"commit message: {fault}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
