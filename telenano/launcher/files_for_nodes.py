"""Copies of the files that nodes read, held open by the launcher.

A restarted node reads them even if the files were deleted or changed since the start of the rig.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from telenano.files.held_files import HeldFiles
from telenano.files.regular_files import open_regular, read_regular
from telenano.files.yaml_text import LARGEST_BYTES
from telenano.launcher.plan import Plan
from telenano.runtime.security.access_control import AccessControl
from telenano.wire.errors import ConfigError

# The folders whose files a scenario names without a path.
_FOLDER_VARIABLES = ("TELENANO_NETWORKS", "TELENANO_INSTRUMENTS")
_SUFFIX = ".yaml"


class HeldForNodes:
    """The files of a rig, held from its start on; its nodes find them by the inherited descriptor `table`."""

    def __init__(self, plan: Plan, access_control: AccessControl) -> None:
        """Hold the site file, the scenario and the keys as checked, and the files that the scenario names.

        Raises:
            ConfigError: A file has gone since it was checked; the message names it.
        """
        self._held = HeldFiles()
        self._access_control = access_control
        try:
            self._held.keep(plan.site_file, read_regular(plan.site_file, LARGEST_BYTES))
        except OSError as error:
            raise ConfigError(f"{plan.site_file}: cannot be read: {error.strerror}") from error
        self._held.keep(plan.scenario_file, plan.scenario_bytes)
        for path in _named_files(plan.loaded.document):
            # The node that needs an unreadable file reports it.
            with contextlib.suppress(OSError), open_regular(path) as file:
                self._held.keep_spare(path, file)
        self.refresh()

    @property
    def table(self) -> int:
        """The descriptor of the table of held files."""
        return self._held.table

    @property
    def descriptors(self) -> tuple[int, ...]:
        """The descriptors that a node has to inherit."""
        return self._held.descriptors

    def refresh(self) -> None:
        """Hold the keys that are in force now, so that a restarted node does not accept a revoked key.

        The held list of allowed keys is used only if the file itself is gone.
        """
        listed = self._access_control.keyring.allowed_path
        for path, content in self._access_control.held_files().items():
            self._held.keep(path, content, is_spare=path == listed)

    def close(self) -> None:
        """Close all held files."""
        self._held.close()


def named_bytes(plan: Plan) -> int:
    """Return the total size of the files that the scenario names [bytes]; a node that finds them gone makes copies."""
    total = 0
    for path in _named_files(plan.loaded.document):
        with contextlib.suppress(OSError):
            total += path.stat().st_size
    return total


def _named_files(document: Any) -> Iterator[Path]:
    """Yield each existing file that any value of a scenario names, and those in the folders of the environment.

    The folders are those of TELENANO_NETWORKS and TELENANO_INSTRUMENTS.
    """
    for text in _texts(document):
        # A text with a zero byte, or one that is too long, raises instead of being a path.
        with contextlib.suppress(OSError, ValueError):
            if Path(text).is_file():
                yield Path(text)
    for folder in filter(None, map(os.environ.get, _FOLDER_VARIABLES)):
        yield from sorted(Path(folder).glob(f"*{_SUFFIX}"))


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for part in value.values():
            yield from _texts(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from _texts(part)
