"""Content of the page of a recording: phases, holds with their verdicts, marks, events, and the summary."""

from typing import Any

from telenano.analysis.phases import contacts_of, moments_of, phases_of
from telenano.analysis.recorded_session import Session
from telenano.analysis.session_judge import summary_of
from telenano.analysis.swings import swings_of
from telenano.recording.messages import readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.site_clock import Timeline
from telenano.wire.errors import RecordingError

_MOST_EVENTS = 2000
# keys of the summary that the page leaves out, because they are long; the file has them
_LONG = ("rate_hz", "completeness", "seq_gaps", "holds", "parameters", "plugins")


def judged_recording(recording: RecordingSource) -> dict[str, Any]:
    """Return the content of a recording's page beside its curves, by key; times are since the first message [s].

    `phases`, `holds`, `swings`, `interruptions` and `losses` (spans with messages missing from the recording) have
    `from_s` and `to_s`; `moments` have `t_s`, `kind`, `level`, `src` and `text`; `summary` is that of `telenano
    report`, and `fault` states why there is none. The swings are those of the force that is commanded to the hand, from
    which the banner of a live rig is made as well.
    """
    start_ns = recording.span_ns[0]
    nothing: tuple[str, ...] = ("phases", "holds", "swings", "interruptions", "losses")
    document: dict[str, Any] = {**{key: [] for key in nothing}, "summary": None}
    try:
        session = Session.of(recording)
        summary = summary_of(session, recording)
    except RecordingError as error:
        return {**document, "moments": _events(recording, start_ns, Timeline(recording)), "fault": str(error)}
    moments = _events(recording, start_ns, session.timeline)
    return {**document, **_session_facts(session, summary, (session.start_ns - start_ns) * 1e-9, moments)}


def summary_facts(summary: dict[str, Any], shift_s: float) -> dict[str, Any]:
    """Return the content of a page from a summary alone; shift_s: start of the session in the recording [s]."""
    spans = {
        name: [{**one, "from_s": one["start_s"] + shift_s, "to_s": one["end_s"] + shift_s} for one in summary[name]]
        for name in ("holds", "interruptions")
    }
    return {
        "session_s": [shift_s, shift_s + summary["duration_s"]],
        **spans,
        "summary": {key: value for key, value in summary.items() if key not in _LONG},
    }


def _session_facts(
    session: Session, summary: dict[str, Any], shift_s: float, events: list[dict[str, Any]]
) -> dict[str, Any]:
    series = session.series()
    in_contact = session.tip["in_contact"].astype(bool)
    contacts = contacts_of(series.tip_time_s, in_contact) if in_contact.size else []
    phases = phases_of(series.hand_time_s, series.hand_force_n, contacts, summary["holds"], session.duration_s)
    moments = [
        {"t_s": moment.time_s + shift_s, "kind": moment.kind, "level": "info", "src": "afm_node", "text": moment.text}
        for moment in moments_of(contacts, session.duration_s)
    ]
    # Nodes report other interruptions themselves.
    moments += [
        {
            "t_s": one["start_s"] + shift_s, "kind": one["kind"], "level": "warning",
            "src": "haptic_node" if "hand" in one["reason"] else "afm_node",
            "text": f"{one['reason']} for {1e3 * (one['end_s'] - one['start_s']):.0f} ms, and no message is missing",
        }
        for one in summary["interruptions"]
        if one["kind"] == "source_silent"
    ]  # fmt: skip
    gaps_s = () if summary["recording"]["complete"] else session.gaps_s()
    return {
        **summary_facts(summary, shift_s),
        "losses": [{"from_s": begin + shift_s, "to_s": end + shift_s} for begin, end in gaps_s],
        "phases": [{"kind": p.kind, "from_s": p.from_s + shift_s, "to_s": p.to_s + shift_s} for p in phases],
        "swings": [
            {
                "from_s": s.start_s + shift_s,
                "to_s": s.end_s + shift_s,
                "hertz": s.frequency_hz,
                "peak_to_peak_n": s.peak_to_peak_n,
            }
            for s in swings_of(series.reference_time_s, session.command["force_n.2"])
        ],
        "moments": sorted([*events, *moments], key=lambda moment: float(moment["t_s"])),
    }


def _events(recording: RecordingSource, start_ns: int, timeline: Timeline) -> list[dict[str, Any]]:
    """Return marks and reports of nodes, at most _MOST_EVENTS of them, the first ones."""
    rows = []
    events = recording.select(lambda channel: channel.topic == "session/event" and channel.via == "direct")
    for message, fields in readable(events, recording.left_out):
        if fields.get("kind") in ("ack", "refused"):
            continue
        at_ns = timeline.time_ns(message)
        text = str(fields.get("text", ""))
        row = {"kind": str(fields.get("kind", "")), "level": str(fields.get("level", "info")), "src": message.src}
        rows.append({**row, "t_s": (at_ns - start_ns) * 1e-9, "text": text})
        if len(rows) >= _MOST_EVENTS:
            break
    return rows
