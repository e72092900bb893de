"""The packages that a recorded session used, as its recording names them, and whether the same ones are here."""

from collections.abc import Mapping
from typing import Any

from presets.known_packages import KNOWN_PACKAGES
from presets.plugins import installed
from proto.errors import ConfigError
from proto.extras import how_to_add_package
from recording.multi_file import RecordingSource
from services.runtime.settings.scenario import named_in


def recorded_plugins(recording: RecordingSource, document: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return package, version and digest of each entry of a package that a scenario names, by `kind.name`."""
    kept = recording.metadata.get("plugins", {})
    found = {}
    for kind, name in named_in(document):
        if text := kept.get(f"{kind}.{name}"):
            found[f"{kind}.{name}"] = dict(zip(("package", "version", "digest"), text.split(), strict=True))
    return found


def require_installed(recorded: Mapping[str, Mapping[str, str]]) -> None:
    """Raise ConfigError for the first package that is not installed; the message names it and says what adds it."""
    for key, facts in recorded.items():
        kind, _, name = key.partition(".")
        if name not in installed(kind):
            package, version = facts["package"], facts["version"]
            own = package in KNOWN_PACKAGES.values()
            how = how_to_add_package(package) if own else f"pip install {package}=={version}"
            what = f"{kind.removesuffix('s')} {name} of {package} {version}"
            raise ConfigError(f"the session used the {what}, which is not installed here: {how}")


def differences(recorded: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return a sentence for each package whose files are not those of the recording.

    Raises:
        ConfigError: A package is not installed; the message names it.
    """
    require_installed(recorded)
    texts = []
    for key, facts in recorded.items():
        kind, _, name = key.partition(".")
        row, what = installed(kind)[name], f"{kind.removesuffix('s')} {name} of {facts['package']}"
        if row.digest != facts["digest"]:
            texts.append(f"the {what} was {facts['version']} with other files, and is {row.version} here")
    return texts
