"""What a recording, and several files of one, have besides messages: fields as arrays."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from telenano.recording.messages import LeftOut, RecordedChannel, RecordedMessage

if TYPE_CHECKING:
    import numpy.typing as npt


class RecordedFields(Protocol):
    """What is read through a recording; what that needs is imported when it is asked for.

    path: the file, or the first of several. left_out: what its readers could not take.
    """

    path: Path
    left_out: LeftOut

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Channels in the order of their first appearance."""

    def messages(
        self, topics: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages of channels by name within bounds [ns]."""

    def columns(self, channel_topic: str, fields: Sequence[str]) -> "dict[str, npt.NDArray[Any]]":
        """Return fields of every message of a channel as arrays; see `telenano.recording.columns.columns`."""
        from telenano.recording.columns import columns

        return columns(self, channel_topic, fields)

    def column_pieces(self, channel_topic: str, fields: Sequence[str]) -> "Iterator[dict[str, npt.NDArray[Any]]]":
        """Yield what `columns` returns in pieces of some thousand messages, so that no recording is too long."""
        from telenano.recording.columns import column_pieces

        return column_pieces(self, channel_topic, fields)
