"""Fields of messages as arrays, for a recording of one file or of several."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from telenano.recording.messages import LeftOut, RecordedChannel, RecordedMessage

if TYPE_CHECKING:
    import numpy.typing as npt


class RecordedFields(Protocol):
    """Base of a recording that returns fields as arrays; NumPy is imported only when they are requested.

    path: the file, or the first of several. left_out: counts of the messages that its readers skipped.
    """

    path: Path
    left_out: LeftOut

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Channels in the order of their first appearance."""

    def messages(
        self, topics: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of the named channels with `start_ns` <= reception time < `end_ns` [ns]; None for all."""

    def columns(self, channel_topic: str, fields: Sequence[str]) -> "dict[str, npt.NDArray[Any]]":
        """Return fields of every message of a channel as arrays; see `telenano.recording.columns.columns`."""
        from telenano.recording.columns import columns

        return columns(self, channel_topic, fields)

    def column_pieces(self, channel_topic: str, fields: Sequence[str]) -> "Iterator[dict[str, npt.NDArray[Any]]]":
        """Yield the result of `columns` in pieces of some thousand messages, so that memory is bounded."""
        from telenano.recording.columns import column_pieces

        return column_pieces(self, channel_topic, fields)
