"""What the link sends on at an endpoint: the messages of a re-run against those of a recording, in their order."""

from collections.abc import Sequence
from typing import NamedTuple

from telenano.recording.field_differences import Tolerances
from telenano.wire.codec import WireError, decode_header

# This number of in a row are alike where the two are in step: one message and its duplicate are not enough.
_IN_STEP = 8


class ForwardedMessage(NamedTuple):
    """A message as it left the link at a time [ns]: the bytes of its publisher, but for bits flipped on the way."""

    topic: str
    payload: bytes
    time_ns: int

    @property
    def is_known(self) -> bool:
        """Whether the bytes are known: what was in flight when a re-run begins may not be in the recording."""
        return any(self.payload)

    @property
    def name(self) -> str:
        """Topic, number and publisher, as far as flipped bits have left them."""
        seq, src = self.number
        return f"{self.topic}, seq {seq} of {src}" if src else f"a damaged {self.topic}"

    @property
    def number(self) -> tuple[int, str]:
        """Number and publisher; -1 and nothing when the header is damaged."""
        try:
            (seq, _, src), _ = decode_header(self.topic, self.payload)
        except WireError:
            return -1, ""
        return seq, src


class ForwardedResult(NamedTuple):
    """What came of a comparison: messages met and the first seq, by topic; place of the first difference in the re-run.

    `difference` is empty, and `place` -1, where there is none.
    """

    compared: dict[str, int]
    first_seq: dict[str, int]
    difference: str = ""
    field: str = ""
    place: int = -1


def compare_forwarded(sent: Sequence[ForwardedMessage], recorded: Sequence[ForwardedMessage]) -> ForwardedResult:
    """Compare what a re-run sent on with what a recording has of it, both in the order of sending.

    Either may begin or end before the other. What the recorder alone has missed is passed over, because the journal
    has the count; topics that the recording does not have at all are left out.
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
    """Return the first places that belong together: where the later of the two begins."""
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
    """Return the field in which two messages of one name differ, and what differs in words."""
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
