"""One recording of the two that the sites of a session keep, on the clock of the master's."""

import heapq
from collections.abc import Iterator, Sequence
from pathlib import Path

from proto.errors import RecordingError
from proto.nodes import site_of
from recording.mcap_scan import describe_damage
from recording.messages import RawChannel, RawMessage
from recording.reader import Recording
from recording.rewrite import CopyResult, CopyWriter

# both say what the slave's clock is ahead of the master's, and how well that is known
_STATUS, _NETWORK = "link/status", "link/network"


def merge_sites(sources: Sequence[Path], target: Path) -> CopyResult:
    """Merge the recordings of the master's site (first) and of the slave's.

    Times of reception at the slave are put on the master's clock, by the offset that the link measured with the least
    uncertainty; messages are copied byte by byte, so that what is in them stays on the clock of who sent it. A channel
    that both have is taken from the recorder at the site of the channel, who received it nearby.
    Raises RecordingError when they are not of two sites, no offset was measured, or the target exists.
    """
    recordings = [Recording(source) for source in sources]
    sites = [site_of(recording.metadata.get("recording", {}).get("node", "")) for recording in recordings]
    if sites[:1] != ["master"] or set(sites[1:]) != {"slave"}:
        found = ", ".join(f"{source} of {site or 'no site'}" for source, site in zip(sources, sites, strict=True))
        raise RecordingError(f"recordings of the master's site and then of the slave's are needed, these are {found}")
    ahead_ns = clock_ahead_ns(recordings[0])
    of_slave = {_identity(channel) for r in recordings[1:] for channel in _channels(r)}
    of_master = {_identity(channel) for channel in _channels(recordings[0])}
    skipped = [part for recording in recordings for part in recording.structural_damage]

    def wanted(recording: Recording, site: str) -> Iterator[RawMessage]:
        others = of_slave if site == "master" else of_master
        shift_ns = 0 if site == "master" else ahead_ns
        taken: dict[int, tuple[RawChannel, bool]] = {}
        for message in recording.raw(skipped.append):
            known = taken.get(id(message.channel))
            if known is None:
                channel = _identity(message.channel)
                known = taken[id(message.channel)] = (message.channel, channel not in others or channel[2] == site)
            if known[1]:
                yield message if not shift_ns else message._replace(log_ns=max(0, message.log_ns - shift_ns))

    with CopyWriter(target) as writer:
        writer.copy_attachments_and_metadata(recordings)
        writer.add_metadata("merged", {"slave_clock_ahead_ns": str(ahead_ns)})
        streams = [wanted(recording, site) for recording, site in zip(recordings, sites, strict=True)]
        for message in heapq.merge(*streams, key=lambda message: message.log_ns):
            writer.add(message)
    return CopyResult(path=str(target), messages=writer.messages, skipped=describe_damage(skipped))


def clock_ahead_ns(recording: Recording) -> int:
    """Return what the slave's clock is ahead of the master's [ns], as measured with the least uncertainty."""
    best: tuple[float, float] | None = None
    for message in recording.messages([_STATUS, _NETWORK]):
        fields = message.fields()
        # what the master's own end measured of the slave's clock
        if message.topic == _NETWORK and fields["direction"] != "backward":
            continue
        clock = fields["clock"]
        if clock["valid"] and (best is None or clock["uncertainty_s"] < best[0]):
            best = (clock["uncertainty_s"], clock["offset_s"])
    if best is None:
        raise RecordingError(f"{recording.path}: has no {_STATUS} or {_NETWORK} in which the clocks were compared")
    return round(best[1] * 1e9)


def _channels(recording: Recording) -> Iterator[RawChannel]:
    seen = set()
    for message in recording.raw():
        if id(message.channel) not in seen:
            seen.add(id(message.channel))
            yield message.channel


def _identity(channel: RawChannel) -> tuple[str, str, str]:
    """Return topic, source and site of a channel."""
    entries = dict(channel.metadata)
    return channel.topic, entries.get("src", ""), entries.get("site", "")
