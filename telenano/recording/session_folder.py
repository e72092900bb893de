"""The folder of a session: the parts of its recording, and the list of parts that the other site keeps."""

import contextlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from telenano.wire.errors import NoRecordingError, RecordingError

RECORDING_NAME = "session.mcap"
# The list of the files that the other site recorded.
FAR_LIST = "far.json"
# The recording of both sites.
_MERGED_NAME = "both.mcap"
_PART = re.compile(r"session(?:_([0-9]{1,9}))?\.mcap")


def recordings_of(path: Path) -> list[Path]:
    """Return a path itself, or all parts `session*.mcap` of the recording in a folder, sorted by name.

    Raises:
        NoRecordingError: The folder has no recording.
    """
    if not path.is_dir():
        return [path]
    paths = sorted(path.glob("session*.mcap"))
    if not paths:
        raise NoRecordingError(
            f"{path}: has no session.mcap in it; give a recording, or the folder of `telenano up --out`"
        )
    return paths


class SessionFolder:
    """The folder that `telenano up` records to."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def own(self) -> tuple[tuple[Path, ...], list[str]]:
        """Return the parts of the recording, in the order of their numbers, and a sentence for each unreadable one."""
        # Imported here because an image without a recorder lacks the MCAP library and uses only the file names.
        from telenano.recording.reader import Recording

        numbered = {
            int(match[1] or 0): path
            for path in self.path.glob("session*.mcap")
            if (match := _PART.fullmatch(path.name))
        }
        readable, faults = [], []
        for _, path in sorted(numbered.items()):
            try:
                Recording(path)
                readable.append(path)
            except RecordingError as error:
                faults.append(str(error))
        return tuple(readable), faults

    def note_far(self, files: Sequence[str]) -> None:
        """Write the names of the files to which the other site records the session, if any, to `far.json`."""
        text = json.dumps({"files": [Path(name).name for name in files]})
        # A full disk must not end the session.
        with contextlib.suppress(OSError):
            if files:
                (self.path / FAR_LIST).write_text(text + "\n", encoding="utf-8")

    @property
    def has_far(self) -> bool:
        """Whether the other site recorded the session."""
        return (self.path / FAR_LIST).exists()

    def far(self) -> tuple[str, ...]:
        """Return the names of the files to which the other site recorded the session.

        Raises:
            RecordingError: The folder has no list of them, or an invalid one.
        """
        path = self.path / FAR_LIST
        try:
            files = json.loads(path.read_text(encoding="utf-8"))["files"]
        except FileNotFoundError:
            raise RecordingError(f"{path}: is missing: no session of two sites was recorded to {self.path}") from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RecordingError(f"{path}: is not a list of files: {error}") from error
        return self.parts(files, str(path))

    @staticmethod
    def is_part(name: str) -> bool:
        """Return whether a name is that of a part of a recording, such as session.mcap or session_1.mcap."""
        return _PART.fullmatch(name) is not None

    @staticmethod
    def parts(names: Any, origin: str) -> tuple[str, ...]:
        """Return the names of parts of a recording after checking them.

        Args:
            names: The names, of any type because they come from another machine.
            origin: The source of the names, for the error.

        Raises:
            RecordingError: There is no name, or one is not that of a part.
        """
        wrong = [name for name in names if not (isinstance(name, str) and SessionFolder.is_part(name))]
        if wrong or not names:
            named = repr(wrong[0]) if wrong else "nothing"
            raise RecordingError(
                f"{origin}: {named} is not a part of a recording, such as session.mcap or session_1.mcap"
            )
        return tuple(names)

    def merge(self, far: Sequence[Path]) -> Path:
        """Merge the recording with the other site's parts into `both.mcap`; raises RecordingError as `merge_sites`."""
        from telenano.recording.site_merge import merge_sites

        target = self.path / _MERGED_NAME
        unfinished = target.with_suffix(".part")
        unfinished.unlink(missing_ok=True)
        # The launcher knows which files belong together, so the recorded identities need not prove it.
        merge_sites([*self.own()[0], *far], unfinished, same_session=True)
        unfinished.replace(target)
        return target
