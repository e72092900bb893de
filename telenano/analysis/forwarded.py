"""Comparison of the messages that the link sends on at an endpoint, in order: those of a re-run with a recording."""

from collections.abc import Sequence
from typing import NamedTuple

from telenano.recording.field_differences import Tolerances
from telenano.wire.codec import WireError, decode_header

# number of equal messages in a row that shows re-run and recording to be in step: a message and its duplicate do not
_IN_STEP = 8


class ForwardedMessage(NamedTuple):
    """A message that left the link at a time [ns]: the bytes of its publisher, with bits flipped by the link."""

    topic: str
    payload: bytes
    time_ns: int

    @property
    def is_known(self) -> bool:
        """Whether the bytes are known: messages in flight at the start of a re-run may not be in the recording."""
        return any(self.payload)

    @property
    def name(self) -> str:
        """Topic, number and publisher, or only the topic if the header is damaged."""
        seq, src = self.number
        return f"{self.topic}, seq {seq} of {src}" if src else f"a damaged {self.topic}"

    @property
    def number(self) -> tuple[int, str]:
        """Number and publisher; -1 and an empty text if the header is damaged."""
        try:
            (seq, _, src), _ = decode_header(self.topic, self.payload)
        except WireError:
            return -1, ""
        return seq, src


class ForwardedResult(NamedTuple):
    """Result of a comparison: by topic, the number of messages compared and their first seq; the first difference.

    `place` is that of the difference in the re-run. Without one, `difference` is empty and `place` -1.
    """

    compared: dict[str, int]
    first_seq: dict[str, int]
    difference: str = ""
    field: str = ""
    place: int = -1


def compare_forwarded(sent: Sequence[ForwardedMessage], recorded: Sequence[ForwardedMessage]) -> ForwardedResult:
    """Compare the messages that a re-run sent on with those of a recording, both in the order of sending.

    Either may start or end before the other. Messages that only the recorder missed are skipped, because the journal
    counts them; so are topics that are not in the recording at all.
    """
    topics = {message.topic for message in recorded}
    places = [place for place, message in enumerate(sent) if message.topic in topics]
    sent = [sent[place] for place in places]
    result = ForwardedResult({}, {})
    if not sent:
        return result
    start = _start(sent, recorded)
    if start is None:
        text = f"re-run {sent[0].name}, which is not recorded with what follows it"
        return result._replace(difference=text, place=places[0])
    here, there = start
    last_here = {message[:2]: place for place, message in enumerate(sent)}
    last_there = {message[:2]: place for place, message in enumerate(recorded)}
    while here < len(sent) and there < len(recorded):
        message, expected = sent[here], recorded[there]
        if _alike(message, expected):
            there += 1
            if message.is_known:
                result.compared[message.topic] = result.compared.get(message.topic, 0) + 1
                result.first_seq.setdefault(message.topic, message.number[0])
        elif last_there.get(message[:2], -1) > there or last_here.get(expected[:2], -1) < here:
            field, text = _difference(message, expected)
            return result._replace(difference=text, field=field, place=places[here])
        here += 1
    return result


def _start(sent: Sequence[ForwardedMessage], recorded: Sequence[ForwardedMessage]) -> tuple[int, int] | None:
    """Return the places in both at which the later of the two starts; None if they have nothing in common."""
    places: dict[tuple[str, bytes], list[int]] = {}
    for place, message in enumerate(recorded):
        places.setdefault(message[:2], []).append(place)
    for here, message in enumerate(sent):
        for there in places.get(message[:2], ()):
            pairs = zip(sent[here : here + _IN_STEP], recorded[there : there + _IN_STEP], strict=False)
            if all(_alike(*pair) for pair in pairs):
                earlier = min(here, there)
                return here - earlier, there - earlier
    return None


def _alike(message: ForwardedMessage, recorded: ForwardedMessage) -> bool:
    if message.topic != recorded.topic:
        return False
    return message.payload == recorded.payload or (
        len(message.payload) == len(recorded.payload) and not message.is_known
    )


def _difference(message: ForwardedMessage, recorded: ForwardedMessage) -> tuple[str, str]:
    """Return the field in which two messages of one name differ, empty if unknown, and the difference in words."""
    if message.name == recorded.name:
        difference = Tolerances().first_difference(_fields(message), _fields(recorded))
        if difference is not None:
            return difference.field, f"re-run {difference.text} recorded"
        different = sum(left != right for left, right in zip(message.payload, recorded.payload, strict=False))
        different += abs(len(message.payload) - len(recorded.payload))
        return "", f"{different} bytes of {message.name} differ from those recorded"
    return "", f"re-run {message.name} against {recorded.name} recorded"


def _fields(message: ForwardedMessage) -> dict[str, object]:
    try:
        return decode_header(message.topic, message.payload)[1]
    except WireError:
        return {}
