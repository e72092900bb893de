"""Several files read as one recording, and the interface that a single file and several share."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from telenano.recording.info import RecordingInfo
from telenano.recording.messages import ChannelFilter, LeftOut, RecordedChannel, RecordedMessage
from telenano.recording.reader import Piece, Recording, SeeMessage, info_of
from telenano.recording.recorded_fields import RecordedFields
from telenano.recording.session_identity import one_session
from telenano.wire.errors import RecordingError


class RecordingSource(RecordedFields, Protocol):
    """A recording of one file or several, as playback, searches and reports use it."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of reception [ns]."""

    @property
    def closed(self) -> bool:
        """Whether the file, or the last one of several, was closed properly, so that its end was recorded."""

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Files within the recording, by name."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name."""

    def info(self, see: SeeMessage | None = None) -> RecordingInfo:
        """Read everything, call `see` with each message, and return the summary."""

    def select(
        self, wanted: ChannelFilter | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of the wanted channels with `start_ns` <= reception time < `end_ns` [ns]."""

    def pieces(self, length_ns: int, lead_ns: int) -> Iterator[Piece]:
        """Yield pieces of about `length_ns`, each with the chunks of `lead_ns` before it [ns]."""

    def newest_before(
        self, time_ns: int, wanted: ChannelFilter | None = None
    ) -> dict[RecordedChannel, RecordedMessage]:
        """Return the newest message of each wanted channel received before a time [ns]."""


class MultiFileRecording(RecordedFields):
    """The files of a recording that was split, read as one."""

    def __init__(self, recordings: Sequence[Recording]) -> None:
        self.left_out = LeftOut()
        filled = [recording for recording in recordings if recording.span_ns != (0, 0)] or list(recordings[:1])
        self.files = sorted(filled, key=lambda recording: recording.span_ns)
        self.path = self.files[0].path

    @property
    def closed(self) -> bool:
        """Whether the last file was closed."""
        return self.files[-1].closed

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files within the recording, by name; the first part's if several parts have one of the same name."""
        return {name: data for file in reversed(self.files) for name, data in file.attachments.items()}

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata of the first part."""
        return self.files[0].metadata

    def info(self, see: SeeMessage | None = None) -> RecordingInfo:
        """Read all parts, call `see` with each message, and return the summary of the whole."""
        return info_of(self.files, see)

    def messages(
        self, topics: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of all parts, one part after the other."""
        for file in self.files:
            yield from file.messages(topics, start_ns, end_ns)

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        return tuple(dict.fromkeys(channel for file in self.files for channel in file.channels))

    @property
    def span_ns(self) -> tuple[int, int]:
        return self.files[0].span_ns[0], max(file.span_ns[1] for file in self.files)

    def select(
        self, wanted: ChannelFilter | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        for file in self.files:
            yield from file.select(wanted, start_ns, end_ns)

    def pieces(self, length_ns: int, lead_ns: int) -> Iterator[Piece]:
        for file in self.files:
            yield from file.pieces(length_ns, lead_ns)

    def newest_before(
        self, time_ns: int, wanted: ChannelFilter | None = None
    ) -> dict[RecordedChannel, RecordedMessage]:
        newest: dict[RecordedChannel, RecordedMessage] = {}
        for file in self.files:
            newest |= file.newest_before(time_ns, wanted)
        return newest


def files_of(recording: RecordingSource) -> list[Recording]:
    """Return the files of a recording; none for another kind of source."""
    if isinstance(recording, MultiFileRecording):
        return recording.files
    return [recording] if isinstance(recording, Recording) else []


def open_recordings(paths: Sequence[str | Path], *, same_session: bool = False) -> RecordingSource:
    """Open a recording, or several files of one session; files of the same content are read once.

    Args:
        paths: The files.
        same_session: Whether to join files that do not state whether they belong to one session.

    Raises:
        RecordingError: No path is given, a file cannot be read, or two are not of one session; the message names them.
    """
    if not paths:
        raise RecordingError("no recording was given")
    recordings = one_session([Recording(path) for path in paths], same_session=same_session)
    return recordings[0] if len(recordings) == 1 else MultiFileRecording(recordings)
