"""The section of a summary on its recording: missing parts and oddities."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from telenano.recording.info import RecordingInfo


def recording_facts(
    info: RecordingInfo, start_ns: int, missing: Sequence[str], odd: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the section of a summary on its recording; `complete` is true if nothing at all is missing.

    Args:
        info: Facts on the recording.
        start_ns: The start of the session, from which the times of the parts count [ns].
        missing: Sentences on missing parts besides those of `info`.
        odd: Sentences on oddities besides those of `info`.
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
