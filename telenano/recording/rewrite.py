"""Filtering, merging, splitting and recovery of recordings; messages are copied byte by byte."""

import contextlib
import errno
import heapq
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self

from pydantic import BaseModel

from telenano.files.atomic_files import atomic_file, whole_results
from telenano.recording.channel_filter import ALL, Selection, some_of
from telenano.recording.mcap_messages import MessageWriter
from telenano.recording.mcap_scan import Damage, describe_damage
from telenano.recording.messages import RawChannel, RawMessage
from telenano.recording.reader import Recording
from telenano.recording.recorded_time import RecordedTime, span_of
from telenano.recording.session_identity import one_session
from telenano.wire.errors import ConfigError, ExistsError, RecordingError

_CHUNK_BYTES = 1 << 20


class CopyResult(BaseModel):
    """Result of a copy: path, number of messages, and a text for each part that could not be copied."""

    path: str
    messages: int
    skipped: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        target: Path,
        recordings: Sequence[Recording],
        messages: Iterable[RawMessage],
        skipped: Iterable[Damage] = (),
        **others: Any,
    ) -> Self:
        """Write a new recording and return its result: `CopyResult.of(target, [recording], recording.raw())`.

        Args:
            target: The file; it is removed if `messages` or the disk fails.
            recordings: The recordings whose attachments and metadata are copied.
            messages: The messages in their order.
            skipped: The parts that could not be copied; evaluated after the messages.
            others: Further fields of the result.

        Raises:
            RecordingError: The target exists or cannot be written.
        """
        with CopyWriter(target) as writer:
            writer.copy_attachments_and_metadata(recordings)
            for message in messages:
                writer.add(message)
        return cls(path=str(target), messages=writer.messages, skipped=describe_damage(skipped), **others)


class CopyWriter:
    """Writer of an MCAP file that gets its name only when it is finished; an unfinished file is removed."""

    def __init__(self, path: Path, profile: str = "telenano") -> None:
        """Create the file; raise RecordingError if it exists or cannot be created."""
        self.path = path
        self.messages = 0
        self._file = contextlib.ExitStack()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = self._file.enter_context(atomic_file(path, replace=False))
            self._stream: IO[bytes] = self._file.enter_context(part.open("wb"))
        except OSError as error:
            self._file.__exit__(type(error), error, error.__traceback__)
            # The error also comes from a file that has the name of the folder; then the target does not exist.
            if isinstance(error, FileExistsError) and path.exists():
                raise ExistsError(f"{path}: already exists and is not overwritten") from error
            raise RecordingError(f"{path}: cannot be created: {error.strerror}") from error
        self._mcap = MessageWriter(self._stream, _CHUNK_BYTES)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[RawChannel, int] = {}
        self._by_identity: dict[int, tuple[RawChannel, int]] = {}
        self._mcap.start(profile)

    def __enter__(self) -> "CopyWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        """Finish the file, or remove it after an error; raise RecordingError if it cannot be written."""
        try:
            with self._file:
                if error is not None:
                    raise error
                self._mcap.finish()
        except FileExistsError as fault:
            raise ExistsError(f"{self.path}: already exists and is not overwritten") from fault
        except OSError as fault:
            raise RecordingError(f"{self.path}: cannot be written: {fault.strerror}") from fault

    def add(self, message: RawMessage) -> None:
        # Look up the channel by identity first: hashing it with its schema costs more than writing the message.
        number = self._by_identity.get(id(message.channel))
        if number is None or number[0] is not message.channel:
            number = self._by_identity[id(message.channel)] = (message.channel, self._register(message.channel))
        self._mcap.add_message(
            channel_id=number[1],
            log_time=message.log_ns,
            data=message.payload,
            publish_time=message.publish_ns,
            sequence=message.seq,
        )
        self.messages += 1

    def attach(self, name: str, media_type: str, data: bytes, log_ns: int) -> None:
        self._mcap.add_attachment(0, log_ns, name, media_type, data)

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        self._mcap.add_metadata(name, dict(entries))

    def copy_attachments_and_metadata(self, recordings: Sequence[Recording], *, but: str = "") -> None:
        """Copy attachments and metadata; entries of one name with different content are renamed to `STEM/NAME`.

        Args:
            recordings: The recordings.
            but: The name of the metadata record that is not copied.
        """
        files: dict[str, bytes] = {}
        metadata: dict[str, dict[str, str]] = {}
        for recording in recordings:
            for name, records_of_name in recording.attachment_records.items():
                if files.setdefault(name, records_of_name.data) != records_of_name.data:
                    name = f"{recording.path.stem}/{name}"
                    files[name] = records_of_name.data
                elif any(name in earlier.attachment_records for earlier in recordings[: recordings.index(recording)]):
                    continue
                self.attach(name, records_of_name.media_type, records_of_name.data, records_of_name.log_time)
            for name, entries in recording.metadata.items():
                if name == but or (name in metadata and metadata[name] == entries):
                    continue
                while name in metadata:
                    name = f"{recording.path.stem}/{name}"
                metadata[name] = entries
                self.add_metadata(name, entries)

    def _register(self, channel: RawChannel) -> int:
        if channel not in self._channels:
            schema = 0
            if channel.schema is not None:
                if channel.schema not in self._schemas:
                    self._schemas[channel.schema] = self._mcap.register_schema(*channel.schema)
                schema = self._schemas[channel.schema]
            self._channels[channel] = self._mcap.register_channel(
                channel.topic, channel.encoding, schema, dict(channel.metadata)
            )
        return self._channels[channel]


def filter_recording(
    source: Path,
    target: Path,
    selection: Selection = ALL,
    start_s: float | RecordedTime | None = None,
    end_s: float | RecordedTime | None = None,
) -> CopyResult:
    """Copy the selected channels from a time of reception to another one, which is excluded.

    A number is a time from the start of the recording [s].

    A damaged file is read as far as possible, so a copy of everything recovers it.

    Raises:
        RecordingError: The source is not a recording, a pattern or all together select nothing, or the target exists or
            cannot be written.
    """
    recording = Recording(source)
    selection.demand_some_of(source, recording.channels)
    skipped = list(recording.structural_damage)
    first_ns, after_ns = span_of(recording.span_ns[0], start_s, end_s)
    wanted = _cached(selection)
    chosen: Iterator[RawMessage] = (
        message
        for message in recording.raw(skipped.append)
        if message.log_ns >= first_ns and (after_ns is None or message.log_ns < after_ns) and wanted(message.channel)
    )
    if (selection, start_s, end_s) != (ALL, None, None):
        # A copy of everything may be of an empty recording.
        chosen = some_of(source, chosen, recording.span_ns, start_s, end_s)
    return CopyResult.of(target, [recording], chosen, skipped)


@contextlib.contextmanager
def part_of(source: Path, start: RecordedTime | None, end: RecordedTime | None) -> Iterator[Path]:
    """Yield a recording with the messages of a part of another one, which is removed afterwards; without times itself.

    Raises:
        RecordingError: The source is not a recording, or has nothing in the part.
    """
    if start is None and end is None:
        yield source
        return
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / source.name
        filter_recording(source, part, ALL, start, end)
        yield part


def merge_recordings(sources: Sequence[Path], target: Path, *, same_session: bool = False) -> CopyResult:
    """Merge recordings of one session in the order of reception times.

    Args:
        sources: The recordings.
        target: The file to create.
        same_session: Whether to join files that do not state whether they belong to one session.

    Raises:
        RecordingError: A source is not a recording, two are not of one session, or the target exists.
    """
    recordings = one_session([Recording(source) for source in sources], same_session=same_session)
    skipped = [part for recording in recordings for part in recording.structural_damage]
    streams = (recording.raw(skipped.append) for recording in recordings)
    merged = heapq.merge(*streams, key=lambda message: message.log_ns)
    return CopyResult.of(target, recordings, merged, skipped)


def split_recording(
    source: Path, folder: Path, *, interval_s: float | None = None, size_bytes: int | None = None
) -> list[CopyResult]:
    """Split a recording into files NAME_000.mcap, NAME_001.mcap, ... each with all attachments.

    Give either `interval_s` or `size_bytes`. If one file cannot be written, none is left.

    Args:
        source: The recording to split.
        folder: The folder of the new files.
        interval_s: The duration of each file [s].
        size_bytes: The size of the payloads in each file [bytes].

    Raises:
        ConfigError: Neither or both are given, or the value is not positive.
        RecordingError: The source is not a recording, or a target exists or cannot be written.
    """
    if (interval_s is None) == (size_bytes is None):
        raise ConfigError("a split needs either an interval or a size")
    if (interval_s is not None and not interval_s > 0.0) or (size_bytes is not None and size_bytes < 1):
        raise ConfigError("the interval or size of a split must be above 0")
    recording = Recording(source)
    origin_ns = recording.span_ns[0]
    copies = []
    filled = 0

    def file_of(message: RawMessage) -> int:
        nonlocal filled
        if interval_s is not None:
            return max(0, int((message.log_ns - origin_ns) // (interval_s * 1e9)))
        filled += len(message.payload)
        return filled // (size_bytes or 1)

    try:
        with whole_results(folder, replace=False) as part:
            for number, messages in _runs(recording.raw(), file_of):
                target = folder / f"{source.stem}_{number:03d}{source.suffix}"
                if target.exists():
                    raise FileExistsError(errno.EEXIST, "", str(target))
                with CopyWriter(part / target.name) as writer:
                    writer.copy_attachments_and_metadata([recording])
                    for message in messages:
                        writer.add(message)
                copies.append(CopyResult(path=str(target), messages=writer.messages))
    except FileExistsError as error:
        raise ExistsError(f"{error.filename}: already exists and is not overwritten") from error
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    return copies


def _runs(
    messages: Iterator[RawMessage], file_of: Callable[[RawMessage], int]
) -> Iterator[tuple[int, Iterator[RawMessage]]]:
    """Yield, for each new file, its number and messages; each run must be consumed before the next one."""
    pending = next(messages, None)
    number = -1

    def run() -> Iterator[RawMessage]:
        nonlocal pending, number
        here = number
        while pending is not None and number == here:
            yield pending
            pending = next(messages, None)
            # The number never falls, so messages received slightly out of order keep their order.
            number = here if pending is None else max(here, file_of(pending))

    if pending is not None:
        number = file_of(pending)
    while pending is not None:
        yield number, run()


def _cached(selection: Selection) -> Callable[[RawChannel], bool]:
    # Look up channels by identity (and keep them alive), because hashing one with its schema is slow.
    answers: dict[int, tuple[RawChannel, bool]] = {}

    def wanted(channel: RawChannel) -> bool:
        if id(channel) not in answers:
            answers[id(channel)] = (channel, selection(channel))
        return answers[id(channel)][1]

    return wanted
