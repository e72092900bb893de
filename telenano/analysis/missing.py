"""The account of the recording that a session is reported from: what it lacks, and what is odd."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from telenano.recording.info import RecordingInfo


def recording_facts(
    info: RecordingInfo, start_ns: int, missing: Sequence[str], odd: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the part of a summary on its recording; `complete` is whether nothing at all is missing.

    Args:
        info: What is known of the recording.
        start_ns: The start of the session, from which the times of the parts count [ns].
        missing: Sentences on what is missing besides those of `info`.
        odd: Sentences on what is odd besides those of `info`.
    """
    sentences = list(dict.fromkeys([*info.missing, *missing]))
    facts: dict[str, Any] = {
        "file": info.path,
        "complete": not sentences,
        "missing": sentences,
        "lost": info.lost,
        "messages": info.messages,
    }
    if info.odd or odd:
        facts["odd"] = [*info.odd, *odd]
    if info.parts:
        facts["parts"] = [
            {
                "file": Path(part.path).name,
                "begins_s": round((part.start_ns - start_ns) * 1e-9, 3),
                "ends_s": round((part.end_ns - start_ns) * 1e-9, 3),
                "pause_s": round(part.pause_s, 3),
                "messages": part.messages,
            }
            for part in info.parts
        ]
    return facts
