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

# Topic of each device's state. A recorder of the other site has only what its half of the law reports of it.
_OWN = {TIP: ("afm/state", TIP), HAND: ("haptic/state", HAND)}
_OF_HALF = {TIP: ("teleop/backward", "controller@slave"), HAND: ("teleop/forward", "controller@master")}
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
        # The half repeats the last state of a device that is gone, so its report says less.
        for source, words in ((_OWN, "last seen"), (_OF_HALF, "last reported as")):
            message = _newest(recordings, source[device]) if device in source else None
            if message is not None:
                with suppress(*_UNREADABLE):
                    found[device] = f"{words} {_in_words(message)}, {_ago(time.time_ns() - message.log_ns)} ago"
                break
    return found


def _newest(recordings: Iterable[Recording], source: tuple[str, str]) -> RecordedMessage | None:
    """Return the newest message of a topic and publisher in the recordings; None if they have none."""
    found: list[RecordedMessage] = []
    for recording in recordings:
        with suppress(*_UNREADABLE):
            found += recording.newest_before(
                _END_OF_TIME, lambda channel: (channel.topic, channel.src) == source
            ).values()
    return max(found, key=lambda message: message.log_ns, default=None)


def with_last_seen(rig: LocalRig, answers: dict[str, Answer]) -> dict[str, Answer]:
    """Return the answers, each of a device that has not answered with its last recorded state."""
    silent = [node for node, answer in answers.items() if answer.kind not in ("ack", "refused") and node in _OWN]
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
