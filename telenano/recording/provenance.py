"""Origin of a recording: the files that describe the rig, and versions."""

import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import zmq

from telenano.files.regular_files import read_regular
from telenano.files.yaml_text import LARGEST_BYTES
from telenano.recording.mcap_scan import FORMAT
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.settings.plugins import in_scenarios, installed
from telenano.signals import children
from telenano.wire.errors import RecordingError
from telenano.wire.topics import OWN_TOPICS

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("telenano", "mcap", "msgpack", "numpy", "pydantic", "pyzmq", "zstandard")


def versions() -> dict[str, str]:
    """Return the versions of packages, Python, platform and message schemas; `unknown` where a package has none."""
    texts = {"python": platform.python_version(), "platform": platform.platform(), "libzmq": zmq.zmq_version()}
    texts |= {f"package {name}": _package_version(name) for name in _PACKAGES}
    texts["commit"] = _commit()
    texts |= {f"schema {name}": str(row.model.version) for name, row in OWN_TOPICS.items()}
    return texts


def plugin_facts() -> dict[str, str]:
    """Return package, version and digest of what a scenario can name of installed packages, by `kind.name`."""
    return {
        f"{row.kind}.{row.name}": " ".join(row.facts().values())
        for row in (*in_scenarios(), *installed("topics").values())
    }


class ConfigurationFile(NamedTuple):
    """A file that a rig is configured by, with its content when the recording began."""

    path: Path
    content: bytes


def configuration_files(site_file: Path, scenario_file: Path | None) -> dict[str, ConfigurationFile]:
    """Return site file and scenario (where one is known) by their names, read once for all files of a recording.

    What becomes of them while it is written, no later file depends on.

    Raises:
        RecordingError: One cannot be read; the message names it.
    """
    files = {}
    for name, path in (("site", site_file), ("scenario", scenario_file)):
        if path is not None:
            try:
                files[name] = ConfigurationFile(path, read_regular(path, LARGEST_BYTES))
            except OSError as error:
                raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    return files


def write_provenance(
    writer: RecordingWriter,
    config: RecorderConfig,
    files: Mapping[str, ConfigurationFile],
    now_ns: int,
    further: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> None:
    """Write what the rig is configured by, versions, settings and `further` facts at the start of a file.

    Raises RecordingError naming the file that cannot be written.
    """
    for name, file in files.items():
        writer.attach(f"{name}.yaml", "application/yaml", file.content, now_ns)
    shown = {f"{name}_file": _shown(file.path) for name, file in files.items()}
    settings = {f"recorder {key}": str(value) for key, value in config.model_dump(mode="json").items()}
    facts = {"format": FORMAT, "node": writer.node, "started_ns": str(now_ns)}
    writer.add_metadata("recording", facts | shown | settings)
    writer.add_metadata("versions", versions())
    if plugins := plugin_facts():
        writer.add_metadata("plugins", plugins)
    for name, entries in further.items():
        writer.add_metadata(name, entries)
    writer.flush()


def _shown(path: Path) -> str:
    """Return a path as it is found again: what comes with the project by its place in it."""
    absolute = path.absolute()
    is_ours = absolute.is_relative_to(_ROOT / "telenano" / "settings")
    return str(absolute.relative_to(_ROOT) if is_ours else absolute)


@cache
def _commit() -> str:
    """Return the commit that is checked out where this runs from, `+` after it where files differ; else `unknown`."""
    if not (_ROOT / ".git").exists():
        return "unknown"
    try:
        done = children.run(
            ["git", "-C", str(_ROOT), "describe", "--always", "--dirty=+", "--exclude=*"],
            capture_output=True, text=True, timeout=5.0, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip() or "unknown"


def _package_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
