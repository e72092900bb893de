"""Distributions whose packages have names of telenano's own, such as proto-plus with `proto`; the later one wins.

Nothing of telenano's other packages is imported here, since one of them may be overwritten.
"""

import base64
import hashlib
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

# what the wheel installs at the top level
OWN = ("proto", "presets", "recording", "services", "analysis", "studies", "telenano", "firmware")
_ROOT = Path(__file__).resolve().parents[1]
_REMEDY = (
    "give telenano an environment of its own (python -m venv, pipx install, uv tool install); in this one"
    " `pip uninstall {others}`, and then `pip install --force-reinstall --no-deps` of telenano, mends it"
)


def sharing() -> dict[str, set[str]]:
    """Return the packages of telenano that other distributions of this environment install too, each with those."""
    found: dict[str, set[str]] = {}
    for distribution in metadata.distributions():
        name = str(distribution.metadata["Name"])
        tops = {path.parts[0] for path in distribution.files or () if len(path.parts) > 1}
        for top in tops.intersection(OWN) if name.lower() != "telenano" else ():
            found.setdefault(top, set()).add(name)
    return found


def is_overwritten(package: str) -> bool:
    """Return whether a package of this name is not telenano's: it lies elsewhere, or has the text of another one."""
    found = find_spec(package)
    if found is None or found.origin is None:
        return True
    origin = Path(found.origin).resolve()
    if not origin.is_relative_to(_ROOT):
        return True
    digests = {path.locate(): path.hash for path in metadata.distribution("telenano").files or () if path.hash}
    expected = digests.get(Path(found.origin))
    if expected is None:
        return False
    digest = hashlib.new(expected.mode, origin.read_bytes()).digest()
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode() != expected.value


def explanation() -> str | None:
    """Return why telenano's own packages cannot be imported and what helps; None if no other distribution is why."""
    lost = {package: names for package, names in sharing().items() if is_overwritten(package)}
    if not lost:
        return None
    words = ", ".join(f"the package {package} of {' and '.join(sorted(of))}" for package, of in sorted(lost.items()))
    return f"{words} has taken the place of telenano's own: {_REMEDY.format(others=_names(lost))}"


def _names(shared: dict[str, set[str]]) -> str:
    return " ".join(sorted({name for names in shared.values() for name in names}))
