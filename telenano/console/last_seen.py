"""The last known state of a device that has not answered, from the recording that is being written here.

    last_seen(rig, ["afm_node@slave"])    # {"afm_node@slave": "last seen pressing 9 nN (follow), 0.4 s ago"}

A device that is gone or cut off publishes nothing, but the recorder beside it has its last messages. Reading them takes
time, so it is done after the command was sent and its answers have come.
"""

import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from telenano.console.answers import Answer
from telenano.console.emergency_stop import LocalRig
from telenano.recording.messages import RecordedMessage
from telenano.recording.reader import Recording
from telenano.wire.errors import RecordingError
from telenano.wire.nodes import FAR_RECORDER, HAND, RECORDER, TIP

# Topics and publishers of the state of each device, as far as a recorder at either site receives them.
_STATES = {
    TIP: (("afm/state", TIP), ("teleop/backward", "controller@slave")),
    HAND: (("haptic/state", HAND), ("teleop/forward", "controller@master")),
}
_PROC = Path("/proc")
# Errors of a file that is damaged or being removed; the answers are reported without a last state then.
_UNREADABLE = (RecordingError, OSError, KeyError, IndexError, TypeError, ValueError)
_END_OF_TIME = 2**63
# Forces below this are no contact that a person needs to know of [N].
_NO_FORCE_N = 0.05e-9


def last_seen(rig: LocalRig, devices: Iterable[str]) -> dict[str, str]:
    """Return a sentence on the last recorded state of each device; a device without one is left out."""
    recordings = [recording for path in _recorded_now(rig) if (recording := _opened(path)) is not None]
    found = {}
    for device in devices:
        newest: list[RecordedMessage] = []
        for recording in recordings:
            with suppress(*_UNREADABLE):
                wanted = _STATES.get(device, ())
                by_channel = recording.newest_before(_END_OF_TIME, lambda c, w=wanted: (c.topic, c.src) in w)  # type: ignore[misc]
                newest += by_channel.values()
        if newest:
            # Of messages of about the same time the device's own says more than that of its half of the law.
            message = max(newest, key=lambda one: (one.log_ns // 10**9, one.channel.src == device))
            with suppress(*_UNREADABLE):
                found[device] = f"last seen {_in_words(message)}, {_ago(time.time_ns() - message.log_ns)} ago"
    return found


def with_last_seen(rig: LocalRig, answers: dict[str, Answer]) -> dict[str, Answer]:
    """Return the answers, each of a device that has not answered with its last recorded state."""
    silent = [node for node, answer in answers.items() if answer.kind not in ("ack", "refused") and node in _STATES]
    seen = last_seen(rig, silent) if silent else {}
    return {node: answer._replace(last_seen=seen.get(node, "")) for node, answer in answers.items()}


def _recorded_now(rig: LocalRig) -> list[Path]:
    """Return the files that the recorders of a rig on this machine have open."""
    paths = []
    for recorder in (RECORDER, FAR_RECORDER):
        for holder in rig.holders_of(recorder):
            with suppress(OSError):
                for entry in (_PROC / str(holder.process) / "fd").iterdir():
                    with suppress(OSError):
                        target = str(entry.readlink())
                        if target.endswith(".mcap"):
                            paths.append(Path(f"/proc/{holder.process}/root{target}" if holder.folders_of else target))
    return list(dict.fromkeys(paths))


def _opened(path: Path) -> Recording | None:
    try:
        return Recording(path)
    except (RecordingError, OSError):
        return None


def _in_words(message: RecordedMessage) -> str:
    fields: Any = message.fields()
    topic = message.channel.topic
    if topic == "afm/state":
        return f"{_contact(fields['tip_force_n'][2], fields['in_contact'])} ({fields['mode']})"
    if topic == "teleop/backward":
        return _contact(fields["force_n"][2], fields["in_contact"])
    if topic == "haptic/state":
        driven = "in emergency stop" if fields["estop"] else "not driven" if fields["mode"] == "off" else "driven"
        return driven if fields.get("armed") is not True else f"{driven}, armed"
    return "armed" if fields.get("hand_armed") is True else "not armed"


def _contact(force_n: float, in_contact: bool) -> str:
    if force_n > _NO_FORCE_N:
        return f"pressing {1e9 * force_n:.3g} nN"
    if force_n < -_NO_FORCE_N:
        return f"pulled by {-1e9 * force_n:.3g} nN"
    return "touching the sample" if in_contact else "free of the sample"


def _ago(duration_ns: int) -> str:
    return f"{max(0.0, duration_ns * 1e-9):.1f} s"
