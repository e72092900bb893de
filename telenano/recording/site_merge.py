"""Merging of the recordings of both sites of a session into one, by the clock of the master's site."""

import heapq
from collections.abc import Iterator, Sequence
from pathlib import Path

from telenano.recording.info import END_NAME, notes_of, unclosed_text
from telenano.recording.mcap_scan import describe_damage
from telenano.recording.messages import RawChannel, RawMessage
from telenano.recording.multi_file import RecordingSource, open_recordings
from telenano.recording.reader import Recording
from telenano.recording.rewrite import CopyResult, CopyWriter
from telenano.recording.session_identity import one_session
from telenano.recording.site_clock import ClockShift, SiteClock, read_site_clock
from telenano.wire.errors import RecordingError
from telenano.wire.nodes import LINK, name_of, site_of


def merge_sites(sources: Sequence[Path], target: Path, *, same_session: bool = False) -> CopyResult:
    """Merge the recordings of the master's site (first) and of the slave's, each in one or more parts.

    Reception times at the slave are converted to the master's clock if the clocks differ, with the estimate of
    `telenano.recording.site_clock` that report and replay also use. Messages are copied byte by byte, so the times in
    them remain by the clock of their sender. A channel that both sites recorded is copied from the site that received
    it locally.

    Args:
        sources: The recordings.
        target: The file to create.
        same_session: Whether to join files that do not state whether they belong to one session.

    Raises:
        RecordingError: The sources are not of two sites or not of one session, no offset was measured, or the target
            exists or cannot be written.
    """
    recordings = one_session([Recording(source) for source in sources], same_session=same_session)
    sites = [site_of(recording.metadata.get("recording", {}).get("node", "")) for recording in recordings]
    if sites != sorted(sites) or set(sites) != {"master", "slave"}:
        sites_read = ", ".join(
            f"{recording.path} of {site or 'no site'}" for recording, site in zip(recordings, sites, strict=True)
        )
        raise RecordingError(
            f"give the recordings of the master's site first and of the slave's second; these are {sites_read}"
        )
    of_master_site = [recording.path for recording in recordings[: sites.count("master")]]
    clock = slave_clock(open_recordings(of_master_site, same_session=True))
    of_slave, of_master = (
        {_identity(channel) for r, at in zip(recordings, sites, strict=True) if at == site for channel in _channels(r)}
        for site in ("slave", "master")
    )
    skipped = [part for recording in recordings for part in recording.structural_damage]

    def wanted(recording: Recording, site: str) -> Iterator[RawMessage]:
        others = of_slave if site == "master" else of_master
        shift_of = ClockShift(None if site == "master" else clock.of_part(*recording.span_ns))
        taken: dict[int, tuple[RawChannel, bool]] = {}
        for message in recording.raw(skipped.append):
            row = taken.get(id(message.channel))
            if row is None:
                channel = _identity(message.channel)
                row = taken[id(message.channel)] = (
                    message.channel,
                    channel not in others or _nearer(channel) == site,
                )
            if row[1]:
                shift_ns = shift_of(message.log_ns, message.log_ns)
                yield message if not shift_ns else message._replace(log_ns=max(0, message.log_ns + shift_ns))

    with CopyWriter(target) as writer:
        writer.copy_attachments_and_metadata(recordings, but=END_NAME)
        writer.add_metadata(
            END_NAME, {"state": recordings[sites.count("master") - 1].ending, "note": _lacks(recordings, sites)}
        )
        ahead_ns = "" if clock.offset_s is None else str(round(clock.offset_s * 1e9) if clock.applied else 0)
        writer.add_metadata("merged", {"slave_clock_ahead_ns": ahead_ns, "reason": clock.reason})
        streams = [wanted(recording, site) for recording, site in zip(recordings, sites, strict=True)]
        for message in heapq.merge(*streams, key=lambda message: message.log_ns):
            writer.add(message)
    return CopyResult(path=str(target), messages=writer.messages, skipped=describe_damage(skipped))


def slave_clock(recording: RecordingSource) -> SiteClock:
    """Return the estimate of the slave's clock; raise RecordingError if the recording has no measurement of it."""
    clock = read_site_clock(recording)
    if clock is None:
        raise RecordingError(f"{recording.path}: has no link/status or link/network in which the clocks were compared")
    return clock


def _lacks(recordings: Sequence[Recording], sites: Sequence[str]) -> str:
    """Return a text on the losses of the single files, which their merged messages do not show."""
    unclosed = [
        unclosed_text(f"{recording.path.name} of the {site}'s site", *recording.span_ns)
        for recording, site in zip(recordings, sites, strict=True)
        if not recording.closed
    ]
    return "; ".join([*notes_of(recording.metadata for recording in recordings), *unclosed])


def _channels(recording: Recording) -> Iterator[RawChannel]:
    seen = set()
    for message in recording.raw():
        if id(message.channel) not in seen:
            seen.add(id(message.channel))
            yield message.channel


def _nearer(channel: tuple[str, str, str]) -> str:
    """Return the site that receives a channel locally; both ends of the link are in a process at the master's site."""
    _, src, site = channel
    return "master" if site_of(src) == "master" or name_of(src) == LINK else site


def _identity(channel: RawChannel) -> tuple[str, str, str]:
    """Return topic, source and site of a channel."""
    entries = dict(channel.metadata)
    return channel.topic, entries.get("src", ""), entries.get("site", "")
