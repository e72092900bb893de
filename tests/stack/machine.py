"""What the machine gave and did not give while a test ran: printed at the end, never passed over in silence."""

import os

_NOTES: list[str] = []
# At 1000 Hz a rig takes most of two processors. Where others have a part of them, the kernel stops its processes for
# 50 ms of each second for the sake of the ordinary ones, and what is tested is the machine. What a test says of states
# and commands is so at a quarter of the rate as well; those that judge the motion have the rate of their scenario.
LOWER_RATE = ("--set", "realtime.rate_hz=250")
# level with the recorder, ahead of the rest that is not real-time
_NICENESS = -5
_OURS = os.getpriority(os.PRIO_PROCESS, 0)


def note(text: str) -> None:
    """Print at the end of the run what could not be judged here, or only at less than was asked for."""
    _NOTES.append(text)


def notes() -> list[str]:
    return list(_NOTES)


def keep_our_turn() -> None:
    """Let this process run when it has to: a rig takes most of two processors."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    except PermissionError:
        note("the tests may not raise their own priority (no root): on a busy machine they may wait in vain")


def usual_priority() -> None:
    """Begin a child as anybody would start it; for `preexec_fn`."""
    os.setpriority(os.PRIO_PROCESS, 0, _OURS)
