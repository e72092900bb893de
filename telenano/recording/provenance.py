"""Origin of a recording: the configuration files of the rig, and the versions of software and schemas."""

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
    """Return the versions of packages, Python, platform, commit and message schemas; `unknown` for a missing one."""
    texts = {"python": platform.python_version(), "platform": platform.platform(), "libzmq": zmq.zmq_version()}
    texts |= {f"package {name}": _package_version(name) for name in _PACKAGES}
    texts["commit"] = _commit()
    texts |= {f"schema {name}": str(row.model.version) for name, row in OWN_TOPICS.items()}
    return texts


def plugin_facts() -> dict[str, str]:
    """Return package, version and digest of each plugin that a scenario can name and of each topic, by `kind.name`."""
    return {
        f"{row.kind}.{row.name}": " ".join(row.facts().values())
        for row in (*in_scenarios(), *installed("topics").values())
    }


class ConfigurationFile(NamedTuple):
    """A configuration file of the rig, with its content at the start of the recording."""

    path: Path
    content: bytes


def configuration_files(site_file: Path, scenario_file: Path | None) -> dict[str, ConfigurationFile]:
    """Read the site file and, if there is one, the scenario; return them under the keys `site` and `scenario`.

    They are read once for all files of a recording, so that later changes on disk affect none of them.

    Raises:
        RecordingError: A file cannot be read; the message names it.
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
    """Write configuration files, versions, settings and `further` metadata records at the start of a recording.

    Raises RecordingError, which names the file, if it cannot be written. `now_ns` is in ns since 1970.
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
    """Return a path as text: relative to the project for a file that comes with it, else absolute."""
    absolute = path.absolute()
    is_ours = absolute.is_relative_to(_ROOT / "telenano" / "settings")
    return str(absolute.relative_to(_ROOT) if is_ours else absolute)


@cache
def _commit() -> str:
    """Return the commit of the checkout of this code, with `+` if files differ from it; `unknown` without Git."""
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
