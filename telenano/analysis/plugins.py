"""The packages that a recorded session used, and a check whether the same ones are installed."""

import re
from collections.abc import Mapping
from typing import Any

from telenano.recording.multi_file import RecordingSource
from telenano.settings.known_packages import KNOWN_PACKAGES, OWN_PACKAGES
from telenano.settings.plugins import installed
from telenano.settings.scenario import named_in
from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.extras import how_to_add_package
from telenano.wire.printable import printable

_DIGEST = re.compile(r"sha256:[0-9a-f]{1,64}")
# kinds whose word in the table of known packages is not their singular
_KNOWN_AS = {"devices": "driver"}
# kinds that were merged with others: recordings of before have their entries under these
_EARLIER = {"samples": "layers", "readers": "maps"}
# greatest length of name and version of a package together; the longest names on an index have some 90 letters
_MOST_LETTERS = 200


def recorded_plugins(recording: RecordingSource, document: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return package, version and digest of each package entry that a scenario names, by `kind.name`.

    Raises:
        RecordingError: The recording names an impossible package; such a text may be malicious.
    """
    kept = recording.metadata.get("plugins", {})
    plugins = {}
    for kind, name in named_in(document):
        if text := kept.get(f"{kind}.{name}") or kept.get(f"{_EARLIER.get(kind)}.{name}"):
            words = text.split()
            if not _is_package(*words):
                what = f"{recording.path}: metadata plugins: {kind}.{printable(name)}"
                raise RecordingError(
                    f"{what} must have the name, the version and the digest of a package, such as my-laws 1.0 sha256:0a"
                )
            plugins[f"{kind}.{name}"] = dict(zip(("package", "version", "digest"), words, strict=True))
    return plugins


def _is_package(name: str = "", version: str = "", digest: str = "", *rest: str) -> bool:
    """Return whether name and version could be those of a package (PEP 503, PEP 440)."""
    from packaging.utils import InvalidName, canonicalize_name
    from packaging.version import InvalidVersion, Version

    try:
        canonicalize_name(name, validate=True)
        Version(version)
    except (InvalidName, InvalidVersion):
        return False
    is_short = (name + version).isascii() and len(name + version) <= _MOST_LETTERS
    return is_short and not rest and _DIGEST.fullmatch(digest) is not None


def require_installed(recorded: Mapping[str, Mapping[str, str]]) -> None:
    """Raise ConfigError for the first package that is not installed.

    For a package of the project, the message has the command that installs it. For any other package it has none,
    because a recording from somebody else must not determine what is installed here.
    """
    for key, facts in recorded.items():
        kind, _, name = key.partition(".")
        if name not in installed(kind):
            package, singular = facts["package"], kind.removesuffix("s")
            # An entry of this project may be in a package of another name than when it was recorded.
            own = package if package in OWN_PACKAGES else ""
            words = f"{_KNOWN_AS.get(kind, singular)} {name}"
            known = KNOWN_PACKAGES.get(words, own) if package.startswith("telenano-") else ""
            how = how_to_add_package(known) if known else "ask the author of the recording for that package"
            what = f"{singular} {printable(name)} of {package} {facts['version']}"
            raise ConfigError(f"the session used the {what}, which is not installed here: {how}")


def differences(recorded: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return a sentence for each package whose files differ from those of the recording.

    Raises:
        ConfigError: A package is not installed; the message names it.
    """
    require_installed(recorded)
    texts = []
    for key, facts in recorded.items():
        kind, _, name = key.partition(".")
        row, what = installed(kind)[name], f"{kind.removesuffix('s')} {name} of {facts['package']}"
        if row.digest != facts["digest"]:
            texts.append(
                f"the {what} of this session was version {facts['version']} with other files; {row.version} is here"
            )
    return texts
