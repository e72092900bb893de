"""What a launcher holds for its nodes: all that one reads that is started again, whatever has become of the files."""

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
    """The files of a rig, held from its start on: `table` is what its nodes are given to find them by."""

    def __init__(self, plan: Plan, access_control: AccessControl) -> None:
        """Hold site file, scenario and keys as they were checked, and the files that the scenario names.

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
            # One that cannot be read is reported by the node that needs it.
            with contextlib.suppress(OSError), open_regular(path) as file:
                self._held.keep_spare(path, file)
        self.refresh()

    @property
    def table(self) -> int:
        """The descriptor of the table."""
        return self._held.table

    @property
    def descriptors(self) -> tuple[int, ...]:
        """What a node has to inherit."""
        return self._held.descriptors

    def refresh(self) -> None:
        """Hold the keys as they are in force now: one that was revoked must not come back with a node.

        The list itself is read as long as it is there.
        """
        listed = self._access_control.keyring.allowed_path
        for path, content in self._access_control.held_files().items():
            self._held.keep(path, content, is_spare=path == listed)

    def close(self) -> None:
        """Let everything go."""
        self._held.close()


def named_bytes(plan: Plan) -> int:
    """Return the size of the files that the scenario names, which a node copies that finds them gone [bytes]."""
    total = 0
    for path in _named_files(plan.loaded.document):
        with contextlib.suppress(OSError):
            total += path.stat().st_size
    return total


def _named_files(document: Any) -> Iterator[Path]:
    """Yield the files that a scenario names, whatever the keys are, and those of the folders of the environment."""
    for text in _texts(document):
        # A text with a zero byte, or a long one, is no path.
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
