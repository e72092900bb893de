"""Situations that schedules must reach, recognised in the files of a session and not by its schedule.

If a night of schedules never reaches a situation, the generator is at fault.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

from session_files import HAND, LINK, TIP, Fields, Newest, Seen, Session

Stretch = tuple[float, float]


def _states(session: Session, device: str) -> list[Seen]:
    return session.direct[device, "afm/state" if device == TIP else "haptic/state"]


def _down(session: Session, node: str) -> list[Stretch]:
    """Return the times without a process of a node: from each end to the next start [s]."""
    stretches = []
    for act in session.acts:
        ends = act["what"] in ("killed", "ended") and act["at_s"] < session.end_s
        if ends and act["node"] == node:
            starts = [one["at_s"] for one in session.acts if one["what"] == "started" and one["node"] == node]
            stretches.append((act["at_s"], next((at_s for at_s in starts if at_s > act["at_s"]), session.end_s)))
    return stretches


def _silent(session: Session, device: str, least_s: float) -> list[Stretch]:
    """Return the times in which a device sent nothing for longer than `least_s`, by the stamps of its states [s]."""
    times = [one.sent_s for one in _states(session, device)]
    return [pair for pair in pairwise(times) if pair[1] - pair[0] > least_s]


def _acks(session: Session, device: str, command: str) -> list[float]:
    events = session.direct[device, "session/event"]
    return [e.sent_s for e in events if e.fields["kind"] == "ack" and e.fields["data"].get("command") == command]


def _presses(session: Session) -> list[Fields]:
    return [act for act in session.acts if act["what"] == "press"]


def _unanswered(session: Session) -> list[Stretch]:
    """Return the times from each stop for the tip until a person had its answers, or gave up [s]."""
    ended = {act["id"]: act["at_s"] for act in session.acts if act["what"] == "pressed"}
    return [(act["at_s"], ended.get(act["id"], act["at_s"])) for act in _presses(session) if TIP in act["devices"]]


def _within(times: list[float], stretches: list[Stretch], late_s: float = 0.0) -> bool:
    return any(begin <= at_s <= end + late_s for at_s in times for begin, end in stretches)


@lru_cache(maxsize=1)
def _holds(session: Session) -> list[Stretch]:
    """Return the times in which the hand pressed steadily, with hand and tip coupled [s]."""
    tips = Newest(_states(session, TIP))
    inside = []
    for one in _states(session, HAND):
        tip = tips.at(one.sent_s)
        presses = 0.8 <= one.fields["session_s"] <= 3.7 or 4.1 <= one.fields["session_s"] <= 7.6
        if presses and one.fields["mode"] != "off" and tip is not None and tip.fields["mode"] == "follow":
            inside.append(one.sent_s)
    return [pair for pair in pairwise(inside) if pair[1] - pair[0] < 0.1]


def _changes(session: Session, device: str, *modes: str) -> list[float]:
    """Return the times at which a device changed from one mode to another [s]."""
    states = _states(session, device)
    pairs = pairwise(states)
    return [after.sent_s for before, after in pairs if (before.fields["mode"], after.fields["mode"]) == modes]


@lru_cache(maxsize=1)
def _partitions(session: Session) -> list[Stretch]:
    """Return the times of more than 30 ms in which samples of the hand, or answers, were sent and none arrived [s].

    What arrives at the slave is recorded nowhere. Its half answers each sample, so none has arrived while it sent no
    answer. At the hand an answer has arrived where its state descends from a newer one. Times in which a node on the
    way stood still, or was away, do not count.
    """
    samples = [at_s for at_s, _, _ in session.sent["controller@master", "teleop/forward"]]
    answers = [at_s for at_s, _, _ in session.sent["controller@slave", "teleop/backward"]]
    states = pairwise(_states(session, HAND))
    answered = [now.sent_s for old, now in states if now.fields["answered_t_ns"] > old.fields["answered_t_ns"]]
    return [
        *_apart(session, _without(answers, samples), "controller@slave", TIP, LINK),
        *_apart(session, _without(answered, answers), "controller@master", HAND, LINK, "recorder@master"),
    ]


def _without(arrived: list[float], sent: list[float]) -> list[Stretch]:
    """Return the times of more than 30 ms without an arrival, in which more than five messages were sent [s]."""
    long = [(begin, end) for begin, end in pairwise(arrived) if end - begin > 0.03]
    return [(begin, end) for begin, end in long if bisect_left(sent, end) - bisect_right(sent, begin) > 5]


def _apart(session: Session, stretches: list[Stretch], *nodes: str) -> list[Stretch]:
    """Return the times in no part of which one of these nodes stood still or was away [s]."""
    away = [stretch for node in nodes for stretch in _away(session, node)]
    return [(begin, end) for begin, end in stretches if not any(a <= end and b >= begin for a, b in away)]


def _away(session: Session, node: str) -> list[Stretch]:
    """Return the times in which a node stood still, or had no process [s]."""
    stalls = [act for act in session.acts if act["what"] == "stalled" and act["node"] == node]
    return [*((act["at_s"], act["at_s"] + act["for_s"]) for act in stalls), *_down(session, node)]


def _recordings(session: Session, state: str) -> list[str]:
    """Return the sentences in which a recorder has reported a state of its recording."""
    events = [e for e in session.seen if e.topic == "session/event" and e.fields["kind"] == "recording"]
    return [str(e.fields["text"]) for e in events if e.fields["data"].get("state") == state]


def _law_changes(session: Session) -> list[Stretch]:
    """Return the times in which one half had changed to another law and waited for the other half [s]."""
    return [
        (one.sent_s - 0.02, one.sent_s + 0.02)
        for half in ("controller@master", "controller@slave")
        for one in session.direct[half, "law/status"]
        if one.fields["switching"]
    ]


def _voids(session: Session) -> bool:
    return any(act["what"] == "answered" and act["void"] for act in session.acts)


def _two_at_once(session: Session) -> bool:
    given = [(act["at_s"], act["console"]) for act in session.acts if act["what"] == "command"]
    return any(b[0] - a[0] < 0.1 and a[1] != b[1] for a, b in pairwise(given))


def _steps(session: Session) -> list[float]:
    """Return the times within 60 ms of which the age of the hand's sample that the tip obeys steps by over 8 ms [s].

    The age is steady before and after a step; while a process stands still it is not.
    """
    states = [one for one in _states(session, TIP) if one.fields["mode"] == "follow"]
    times = [one.sent_s for one in states]
    ages = [one.sent_s - (one.fields["hand_t_ns"] - session.epoch_ns) * 1e-9 for one in states]
    steps = []
    for at_s, age_s in zip(times, ages, strict=True):
        wanted = (at_s - 0.06, at_s + 0.06, at_s + 0.12)
        places = [bisect_left(times, one) for one in wanted]
        if places[-1] == len(times) or any(
            times[k] - one > session.grain_s + 0.01 for k, one in zip(places, wanted, strict=True)
        ):
            continue
        before_s, after_s, then_s = (ages[k] for k in places)
        if abs(after_s - age_s) > 0.008 and max(abs(age_s - before_s), abs(then_s - after_s)) < 0.004:
            steps.append(at_s)
    return steps


def _clock_stepped(session: Session) -> bool:
    clocks = [one.fields["clock"] for one in session.direct[LINK, "link/status"] if one.fields["clock"]["valid"]]
    return any(abs(a["offset_s"] - b["offset_s"]) > 0.1 for a, b in pairwise(clocks))


SITUATIONS: dict[str, Callable[[Session], bool]] = {
    "a stop while a device was being started again": lambda s: any(
        begin <= act["at_s"] <= end
        for act in _presses(s)
        for device in act["devices"]
        for begin, end in _down(s, device)
    ),
    "a stop while the link was away": lambda s: _within([one["at_s"] for one in _presses(s)], _down(s, LINK)),
    "a link that ended between a stop and its answer": lambda s: _within(
        [begin for begin, _ in _down(s, LINK)], _unanswered(s)
    ),
    "a stop while the instrument stood still": lambda s: _within(
        [one["at_s"] for one in _presses(s) if TIP in one["devices"]], _silent(s, TIP, 0.05)
    ),
    "a stop in a partition": lambda s: _within([one["at_s"] for one in _presses(s)], _partitions(s)),
    "a partition while a law changed": lambda s: any(
        begin <= at_s <= end for at_s, _ in _law_changes(s) for begin, end in _partitions(s)
    ),
    "a half that ended after a change of the law": lambda s: any(
        at_s < begin
        for at_s, _ in _law_changes(s)
        for half in ("controller@master", "controller@slave")
        for begin, _ in _down(s, half)
    ),
    "a partition in a hold": lambda s: _within([begin for begin, _ in _partitions(s)], _holds(s), 0.1),
    "a step of the delay in a hold": lambda s: _within(_steps(s), _holds(s), 0.02),
    "a full disk in the middle of a file": lambda s: any(
        "cannot be written: No space" in text for text in _recordings(s, "failed")
    ),
    "a folder that went while it was recorded to": lambda s: bool(_recordings(s, "removed")),
    "a recorder killed in a hold": lambda s: any(
        _within([begin for begin, _ in _down(s, recorder)], _holds(s), 0.3)
        for recorder in ("recorder@master", "recorder@slave")
    ),
    "a hand killed while the tip followed": lambda s: any(
        (tip := Newest(_states(s, TIP)).at(begin)) is not None and tip.fields["mode"] == "follow"
        for begin, _ in _down(s, HAND)
    ),
    "an instrument lost while it followed": lambda s: any(
        before.fields["mode"] == "follow" and after.fields.get("device") == "lost"
        for before, after in pairwise(_states(s, TIP))
    ),
    "an arming that a stop made void": _voids,
    "two persons who commanded within a tenth of a second": _two_at_once,
    "a clock that was set while its site was away": _clock_stepped,
    "a tip that was held and followed again": lambda s: bool(_changes(s, TIP, "hold", "follow")),
    "a tip withdrawn because nothing came": lambda s: bool(_changes(s, TIP, "hold", "retracting")),
    "an arming of a tip that was stopped": lambda s: (
        bool(_changes(s, TIP, "estop", "follow")) or bool(_changes(s, TIP, "estop", "retracted"))
    ),
}


def situations(session: Session) -> frozenset[str]:
    """Return the situations that a session has reached."""
    return frozenset(name for name, is_reached in SITUATIONS.items() if is_reached(session))
