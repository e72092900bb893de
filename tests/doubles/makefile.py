"""Variables of the Makefile, for tests that compare it with other files."""

import re
from pathlib import Path

_MAKEFILE = Path(__file__).resolve().parents[2] / "Makefile"


def makefile_words(variable: str) -> list[str]:
    """Return the words of a variable of the Makefile, which may span several lines; fail if it is missing."""
    found = re.search(rf"^{variable} := ((?:.*\\\n)*.*)$", _MAKEFILE.read_text(), re.M)
    assert found is not None, f"the Makefile has no {variable}"
    return found.group(1).replace("\\\n", " ").split()
