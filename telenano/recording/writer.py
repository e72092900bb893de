"""Writer of a recording: one MCAP file that stays readable up to the last flush if the process is killed."""

import contextlib
import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import IO, Annotated, Literal

import msgpack
from pydantic import BaseModel, ConfigDict, Field

from telenano.recording.disk import OWN_DISK, Disk, Identity
from telenano.recording.info import END_NAME
from telenano.recording.mcap_messages import Compression, MessageWriter
from telenano.recording.records import GAP_TOPIC, RECORDS, REJECTED_TOPIC, GapRecord, RejectedRecord
from telenano.settings.config import validate
from telenano.settings.package_topics import row_of
from telenano.wire import TOPICS
from telenano.wire.codec import fields_of
from telenano.wire.errors import RecordingError
from telenano.wire.messages import Record
from telenano.wire.nodes import site_of
from telenano.wire.schema import json_schema

# Reason for which a file ended.
FileEnd = Literal["stopped", "split", "quota"]


def channel_topic(topic: str, src: str, site: str) -> str:
    """Return the channel name of messages from `src` (node@site) on `topic`, received at `site`."""
    return topic if site_of(src) == site else f"{topic}@{site}"


class FileSettings(BaseModel):
    """Place, name, compression and flushing of a recording's file."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    directory: Path = Field(default=Path(), description="Folder of the recording; it is created if it does not exist")
    file_name: str = Field(
        default="session.mcap",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap$",
        description="Name of the file; one that exists is kept and the new one is called NAME_1.mcap, NAME_2.mcap, ...",
    )
    compression: Compression = Field(default="zstd", description="Compression of each chunk")
    chunk_size_bytes: Annotated[int, Field(ge=4096, le=64 << 20)] = Field(
        default=1 << 20, description="Size at which a chunk is closed before its flush [bytes], 4096 to 67108864"
    )
    sync_to_disk: bool = Field(
        default=False,
        description="Wait at each flush until the disk has the data: then a power cut loses no more either",
    )


class RecordingWriter:
    """Writer of one recording file.

    A channel has the messages of one publisher on one bus topic, received at one site. Every method raises
    RecordingError with path and reason if the file cannot be written; data flushed before stay readable.
    """

    def __init__(self, stream: IO[bytes], path: Path, node: str, settings: FileSettings, disk: Disk = OWN_DISK) -> None:
        """Start writing to a binary stream; `path` names it in errors, `node` is the recorder (node@site)."""
        self.path = path
        self.node = node
        self.size_bytes = 0
        self._stream = stream
        self._disk = disk
        # The path of the file on the disk, if `create` made it.
        self._place: Path | None = None
        # Number in the name of the file; 0 for none.
        self.number = 0
        # Identity of the file that `create` made; None for another stream.
        self._identity: Identity | None = None
        self._sync = settings.sync_to_disk
        self._schemas: dict[type[Record], int] = {}
        self._own_channels: dict[str, int] = {}
        self._own_counts = dict.fromkeys(RECORDS, 0)
        self._mcap = MessageWriter(stream, settings.chunk_size_bytes, settings.compression)
        with self._guarded():
            self._mcap.start("telenano")
            # Flush the head, so that the file can be opened from its first moment on.
            self._stream.flush()

    @classmethod
    def at(cls, path: Path, node: str, origin: str = "the recording") -> "RecordingWriter":
        """Create a file at a path, or under the first free name after it.

        Args:
            path: The path of the file.
            node: The recorder (node@site).
            origin: The subject of an error message.

        Raises:
            ConfigError: The name is not that of a recording.
        """
        return cls.create(node, validate(FileSettings, {"directory": path.parent, "file_name": path.name}, origin))

    @classmethod
    def create(cls, node: str, settings: FileSettings, number: int = 0, disk: Disk = OWN_DISK) -> "RecordingWriter":
        """Create a file under the first free name, counting up from `number`; nothing is ever overwritten."""
        stem, suffix = Path(settings.file_name).stem, Path(settings.file_name).suffix
        while True:
            path = settings.directory / (f"{stem}_{number}{suffix}" if number else settings.file_name)
            try:
                stream = disk.create(path)
                try:
                    writer = cls(stream, disk.named(path), node, settings, disk)
                except RecordingError:
                    # A file that has no head is no recording.
                    disk.remove(path)
                    raise
                writer._place = path
                writer._identity = disk.identity(stream)
                writer.number = number
                return writer
            except FileExistsError as error:
                if not disk.is_folder(settings.directory):
                    raise RecordingError(f"{settings.directory}: is not a folder") from error
                number += 1
            except OSError as error:
                raise RecordingError(f"{path}: cannot be created: {error.strerror}") from error

    def channel(self, topic: str, src: str, site: str) -> int:
        """Register the channel of messages from `src` (node@site) on a topic, received at `site`; return its number."""
        row = row_of(topic) or TOPICS[topic]
        metadata = {
            "topic": topic,
            "site": site,
            "via": "direct" if site_of(src) == site else "link",
            "src": src,
            "rate_hz": "" if row.rate_hz is None else str(row.rate_hz),
            "delivery": row.delivery,
        }
        return self._register(channel_topic(topic, src, site), row.model, metadata)

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return self._mcap.message_count

    def write(self, channel: int, log_ns: int, publish_ns: int, seq: int, payload: bytes) -> None:
        """Write a message with its payload unchanged; times are in ns."""
        try:
            self._mcap.add_message(channel, log_ns, payload, publish_ns, seq)
        except OSError as error:
            raise self._failure(error) from error

    def write_gap(self, log_ns: int, gap: GapRecord) -> None:
        self._write_own(GAP_TOPIC, log_ns, fields_of(gap))

    def write_rejected(self, log_ns: int, rejected: RejectedRecord) -> None:
        self._write_own(REJECTED_TOPIC, log_ns, fields_of(rejected))

    def attach(self, name: str, media_type: str, data: bytes, log_ns: int) -> None:
        with self._guarded():
            self._mcap.add_attachment(0, log_ns, name, media_type, data)

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        with self._guarded():
            self._mcap.add_metadata(name, dict(entries))

    def flush(self) -> None:
        """Close the current chunk and pass all data to the operating system; with `sync_to_disk` wait for the disk.

        Killing the process afterwards loses none of these data.
        """
        with self._guarded():
            self._mcap.flush()
            self._sync_and_measure()

    def finish(self, end: Mapping[str, str] | None = None) -> None:
        """Write index and statistics and close the file; a second call does nothing.

        Args:
            end: Metadata of the end: its reason (`state`, a FileEnd) and the losses known to the recorder (`note`).
        """
        if self._stream.closed:
            return
        if end is not None:
            self.add_metadata(END_NAME, end)
        with self._guarded():
            self._mcap.finish()
            self._stream.flush()
            self._sync_and_measure()
            self._stream.close()

    def in_place(self) -> bool:
        """Return whether the file still exists under its name: writing to a removed file would raise no error."""
        try:
            return self._identity is None or self._identity == self._disk.identity_at(self.path)
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            # Unknown; the file is still open, so it is not reported as gone.
            return True

    def abandon(self) -> None:
        """Close the stream without finishing the file, and ignore errors."""
        with contextlib.suppress(OSError):
            self._stream.close()

    def discard(self) -> None:
        """Close and remove the file that `create` made, and ignore errors."""
        self.abandon()
        if self._place is not None:
            with contextlib.suppress(OSError):
                self._disk.remove(self._place)

    def _write_own(self, topic: str, log_ns: int, fields: dict[str, object]) -> None:
        if topic not in self._own_channels:
            metadata = {"topic": topic, "site": site_of(self.node), "via": "direct", "src": self.node}
            metadata |= {"rate_hz": "", "delivery": "lossless"}
            self._own_channels[topic] = self._register(topic, RECORDS[topic], metadata)
        self.write(self._own_channels[topic], log_ns, log_ns, self._own_counts[topic], msgpack.packb(fields))
        self._own_counts[topic] += 1

    def _register(self, topic: str, model: type[Record], metadata: dict[str, str]) -> int:
        with self._guarded():
            if model not in self._schemas:
                schema = _schema_of(model)
                self._schemas[model] = self._mcap.register_schema(model.__name__, "jsonschema", schema)
            return self._mcap.register_channel(topic, "msgpack", self._schemas[model], metadata)

    def _sync_and_measure(self) -> None:
        if self._sync:
            self._disk.sync(self._stream)
        self.size_bytes = self._stream.tell()

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> RecordingError:
        """Close the file, which cannot be written, and return the error that reports it."""
        # Closing flushes once more and fails for the same reason, but releases the descriptor.
        self.abandon()
        return RecordingError(f"{self.path}: cannot be written: {error.strerror or error}")


@cache
def _schema_of(model: type[Record]) -> bytes:
    """Return the JSON Schema of a message; cached because each file needs it and making it takes milliseconds."""
    return json.dumps(json_schema(model), sort_keys=True).encode()
