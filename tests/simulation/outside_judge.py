"""A judge independent of the project's code: it reads the files of a session, and reports the broken invariants.

    python tests/simulation/outside_judge.py FOLDER

It reads the recordings of both sites, the schedule, the history of outside actions, the ledger of all messages sent,
the account of the devices, and the statements of the report (`verdict.json`). Times are those of the rig since its
start [s].
"""

import sys
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

from device_judge import judge_chain, judge_forces, judge_places, judge_told
from session_files import HAND, LATE_S, LINK, TIP, Break, Fields, Newest, Session

# Validity of a command; hold of a tip without one, before it is withdrawn [s].
DEADLINE_S, HOLD_S = 0.05, 0.2
# Time after the newest message of a page in which the hand that it pushes is let go [s].
PUSHED_S = 0.1
# Time, in addition to the round trip, within which a tip stops following after the hand last felt an answer [s].
UNFELT_S = 0.5
# Time for which a person waits who presses a stop [s].
PATIENCE_S = 6.2
# Stated bounds of the defaults: travel of hand and base [m], their greatest speeds [m/s], and forces at the hand [N].
HAND_TRAVEL_M, HAND_M_PER_S, HAND_FORCE_N = (-0.0045001, 0.0145001), 0.0394, 10.0
HAND_FORCES = ("operator_force_n", "motor_force_n")
BASE_M, BASE_M_PER_S = (-200.1e-9, 200.1e-9), 2.0e-6
VISITORS = ("launcher", "console", "view", "estop", "recorder")


def _is_known(missing_s: list[float], from_s: float, to_s: float) -> bool:
    return bisect_left(missing_s, from_s) == bisect_right(missing_s, to_s)


def judge_tip(session: Session) -> Iterator[Break]:
    """Check: no command in force is late; the tip is held and withdrawn in time; it follows only a hand that feels."""
    states = session.direct[TIP, "afm/state"]
    armed = Newest([one for one in session.direct["controller@slave", "afm/command"] if one.fields.get("hand_armed")])
    lost, lost_hands = session.missing("controller@slave", "afm/command"), session.missing(HAND, "haptic/state")
    hands, follows_s = session.direct[HAND, "haptic/state"], 0.0
    drives = Newest([one for one in hands if one.fields["mode"] != "off"])
    for before, state in pairwise(states):
        at_s, mode = state.sent_s, state.fields["mode"]
        if mode == "follow" != before.fields["mode"]:
            follows_s = at_s
        if mode not in ("follow", "hold") or not _is_known(lost, at_s - 0.4, at_s):
            continue
        newest, age_s = armed.at(at_s), at_s - armed.time_of(at_s)
        if age_s > DEADLINE_S + session.grain_s + HOLD_S * (mode == "hold"):
            yield Break("safe_in_time", at_s, f"the tip is in {mode} {age_s * 1e3:.0f} ms after the last command")
        if mode != "follow" or before.fields["mode"] != "follow" or at_s - before.sent_s > 0.1 or newest is None:
            continue
        if state.fields.get("device") == before.fields.get("device") == "lost":
            yield Break("safe_in_time", at_s, "the tip follows although the instrument is lost")
        old_s = at_s - (min(one.fields["hand_t_ns"] for one in (newest, state)) - session.epoch_ns) * 1e-9
        allowed_s = DEADLINE_S + session.grain_s + session.way_s("forward", at_s)
        if old_s > allowed_s:
            name = "nothing_late" if state.depth_m - before.depth_m > 1e-12 else "safe_in_time"
            yield Break(name, at_s, f"the tip follows a sample of {1e3 * old_s:.0f} ms, {1e3 * allowed_s:.0f} allowed")
        unfelt_s = at_s - max(drives.time_of(at_s), follows_s)
        if unfelt_s > UNFELT_S + session.trip_s(at_s) and _is_known(lost_hands, at_s - unfelt_s, at_s):
            yield Break("felt_hand", at_s, f"the tip follows a hand that has felt nothing for {unfelt_s:.2f} s")


def judge_hand(session: Session) -> Iterator[Break]:
    """Check: the hand is released when its newest command, the answered sample, or the push of a page is too old."""
    pushes_s = [at_s for at_s, _, _ in session.sent["view@master", "operator/force"]]
    for one in session.direct[HAND, "haptic/state"] if session.schedule.get("operator") == "page" else ():
        pushed_s = one.sent_s - ([-1e9, *pushes_s])[bisect_right(pushes_s, one.sent_s)]
        if one.fields["operator_force_n"][2] and pushed_s > PUSHED_S + session.grain_s:
            yield Break("safe_in_time", one.sent_s, f"a page pushes the hand {pushed_s:.2f} s after its last message")
    commands = Newest(session.direct["controller@master", "haptic/command"])
    lost = session.missing("controller@master", "haptic/command")
    for one in session.direct[HAND, "haptic/state"]:
        at_s, state = one.sent_s, one.fields
        if state["mode"] == "off" or not _is_known(lost, at_s - 0.4, at_s):
            continue
        if (age_s := at_s - commands.time_of(at_s)) > DEADLINE_S + session.grain_s:
            yield Break("safe_in_time", at_s, f"the motor is on {age_s * 1e3:.0f} ms after the last command")
        old_s = at_s - (state["answered_t_ns"] - session.epoch_ns) * 1e-9
        if old_s > DEADLINE_S + session.grain_s + session.trip_s(at_s):
            yield Break("nothing_late", at_s, f"the hand obeys an answer to a sample of {old_s * 1e3:.0f} ms")


def judge_stops(session: Session) -> Iterator[Break]:
    """Check: after a stop nothing arms without a person; arming moves nothing; a stop is answered or kept."""
    given = {act["sender"]: (act["at_s"], act["name"]) for act in session.acts if act["what"] == "command"}
    presses = {act["id"]: act for act in session.acts if act["what"] == "press"}
    acks, arms, asked = set[tuple[str, str]](), list[tuple[float, str]](), _asked(session)
    for device, topic in ((HAND, "haptic/state"), (TIP, "afm/state")):
        line = [*session.direct[device, topic], *session.direct[device, "session/event"]]
        pressed_s, suspect, withdrawn, since_s, lost = None, None, False, 0.0, session.missing(device, "session/event")
        started_s = [act["at_s"] for act in session.acts if act["what"] == "started" and act["node"] == device]
        for one in sorted(line, key=lambda one: one.sent_s):
            said = one.fields
            if suspect is not None and one.sent_s > suspect.at_s + 0.005:
                # The answer to an arming comes after the state that it has changed. It may be missing in the files.
                is_asked = any(given_s <= suspect.at_s and until_s >= since_s for given_s, until_s in asked)
                yield from [] if is_asked and not _is_known(lost, since_s, one.sent_s) else [suspect]
                suspect, pressed_s, withdrawn = None, None, False
            while started_s and started_s[0] < one.sent_s:
                # A new process is armed by nobody.
                withdrawn, since_s = True, started_s.pop(0)
            if one.topic == topic:
                moves = said["mode"] in ("follow", "hold") or said.get("armed") is True
                left = said["mode"] != "estop" if device == TIP else not said["estop"]
                if said["mode"] == "retracting" and pressed_s is None:
                    withdrawn, since_s = True, one.sent_s
                if suspect is None and one.sent_s > since_s + 0.001 and (left if pressed_s else withdrawn and moves):
                    suspect = Break("stop_is_last", one.sent_s, f"{device} is in {said['mode']} without an arming")
            elif said["kind"] == "ack" and said["data"].get("command") == "estop":
                acks.add((said["id"], device))
                since_s, press = one.sent_s, presses.get(said["id"], {})
                pressed_s = max(pressed_s or 0.0, press.get("at_s", since_s))
            elif said["kind"] == "ack" and said["data"].get("command") == "arm":
                given_s, name = given.get(said["id"].rpartition("-")[0], (0.0, ""))
                if pressed_s is not None and given_s < pressed_s:
                    text = f"{device} is armed by a command of {given_s:.2f} s, before the stop of {pressed_s:.2f} s"
                    yield Break("stop_is_last", one.sent_s, text)
                pressed_s, suspect, withdrawn = None, None, False
                arms += [(one.sent_s, name)] if device == TIP else []
    yield from _judge_arming(session, arms)
    yield from _judge_window(session)
    ended = {one["id"]: one["missing"] for one in session.acts if one["what"] == "pressed"}
    for act in presses.values():
        for device in act["devices"] if act["at_s"] < session.end_s - PATIENCE_S else ():
            answered = (act["id"], device) in acks or device not in ended.get(act["id"], (device,))
            if not answered and not {device, LINK if device == TIP else device} & set(session.history["kept"]):
                yield Break("stop_kept", act["at_s"], f"the stop for {device} was neither answered nor kept")


def _asked(session: Session) -> list[tuple[float, float]]:
    """Return the times from each command that may arm, by a person or the launcher, to its answer [s]."""
    answered = {act["sender"]: act["at_s"] for act in session.acts if act["what"] == "answered"}
    given = [act for act in session.acts if act["what"] == "command" and act["name"] in ("arm", "recover")]
    asked = [(act["at_s"], answered.get(act["sender"], session.end_s)) for act in given]
    return asked + [(at_s, at_s + UNFELT_S) for at_s, _, _ in session.sent["launcher@master", "session/control"]]


def _judge_window(session: Session) -> Iterator[Break]:
    events = reversed(session.direct[TIP, "session/event"])
    obeyed = {one.fields["id"]: one.sent_s for one in events if one.fields["kind"] == "ack"}
    samples = [one for one in session.seen if one.channel == "teleop/forward@slave"]
    for act in session.acts:
        if act["what"] != "press" or act["site"] != "master" or TIP not in act["devices"] or LINK not in act["kept"]:
            continue
        # An event that no recorder has heard may be the answer.
        unheard_s = [sent_s for sent_s in session.missing(TIP, "session/event") if sent_s > act["at_s"]]
        until_s = min(obeyed.get(act["id"], session.end_s), session.end_s, *unheard_s)
        for late_s in [one.sent_s for one in samples if act["at_s"] + session.grain_s < one.sent_s < until_s][:1]:
            text = f"a sample sent {late_s - act['at_s']:.3f} s after a stop has crossed before it was obeyed"
            yield Break("stop_is_last", late_s, text)


def _judge_arming(session: Session, arms: list[tuple[float, str]]) -> Iterator[Break]:
    states = Newest(session.direct[TIP, "afm/state"])
    commands = Newest(session.direct["controller@slave", "afm/command"])
    # Other commands that arm, of the launcher or at the end, send the tip to the place of the hand.
    others_s = [at_s for at_s, name in arms if name != "arm"]
    for at_s in (at_s for at_s, name in arms if name == "arm" and all(abs(at_s - one) > 0.3 for one in others_s)):
        depths_m = [one.depth_m for one in states.between(at_s - session.grain_s, at_s + 0.3)]
        asked_m = [one.depth_m for one in commands.between(at_s - 0.15, at_s + 0.3)] or [0.0]
        moved_m = max(depths_m) - depths_m[0] if depths_m else 0.0
        if moved_m > max(asked_m) - min(asked_m) + 0.5e-9:
            yield Break("stop_is_last", at_s, f"arming has moved the tip by {1e9 * moved_m:.1f} nm towards the sample")


def judge_recordings(session: Session) -> Iterator[Break]:
    """Check: recorded messages are unaltered, losses are reported, silence is no loss, delivered messages were sent."""
    corrupt = any(one["corrupt"] for one in session.events("line"))
    said: dict[tuple[str, str], list[Fields]] = defaultdict(list)
    for one in session.seen:
        if one.topic == "recorder/gap":
            said[one.fields["src"], one.fields["channel_topic"]].append(one.fields)
        elif one.topic == "recorder/rejected" and not corrupt:
            yield Break("delivered_was_sent", one.sent_s, f"a message was refused: {one.fields['text'][:100]}")
        elif not one.whole and one.topic != "recorder/rejected":
            name = "recorded_as_sent" if one.via == "direct" else "delivered_was_sent"
            yield Break(name, one.sent_s, f"{one.channel} of {one.fields.get('src')} is not as it was sent")
    unsaid, lost = [], 0
    for (src, topic), seen in session.direct.items():
        if src.partition("@")[0] in VISITORS or topic.startswith("recorder/") or not seen:
            continue
        have = {(one.fields["seq"], one.fields["t_ns"]) for one in seen}
        gaps = said.get((src, topic), [])
        for gap in gaps:
            if gap["first_missing"] > max(seq for _, seq, _ in session.sent[src, topic]):
                yield Break("recorded_as_sent", 0.0, f"a gap of {topic} of {src} names what was not sent: {gap}")
        for sent_s, seq, t_ns in session.sent[src, topic]:
            if (seq, t_ns) in have or sent_s < seen[0].sent_s:
                continue
            lost += 1
            if not any(gap["first_missing"] <= seq <= gap["last_missing"] for gap in gaps):
                unsaid.append((sent_s, src, topic))
    told = [*session.verdict["missing"], *session.history["missing"]]
    if session.verdict["failure"]:
        return
    if unsaid and not told:
        at_s, src, topic = min(unsaid)
        text = f"{len(unsaid)} messages are missing and nothing says so, the first {topic} of {src}"
        yield Break("recorded_as_sent", at_s, text)
    if told and not lost and not session.events("disk", "site_restart", "kill"):
        yield Break("recorded_as_sent", 0.0, f"nothing is missing, and the report says: {told[0][:200]}")


def judge_counters(session: Session) -> Iterator[Break]:
    """Check: the counters of publishers, link and files agree with the messages."""
    for name, counted, read in session.statistics:
        if counted != read:
            yield Break("counters_agree", 0.0, f"{name} says {counted} messages and has {read}")
    for one in session.direct[LINK, "link/status"]:
        for way in ("forward", "backward"):
            said = one.fields[way]
            gone = said["messages_out"] + sum(said["dropped"].values()) + said["queue_depth"]
            if balance := said["messages_in"] + said["duplicated"] - gone:
                yield Break("counters_agree", one.sent_s, f"the link has {balance} messages {way} unaccounted for")
    for one in session.seen:
        if one.topic != "session/event" or one.via != "direct" or one.fields["data"].get("state") != "ended":
            continue
        for key, count in one.fields["data"].items():
            src, topic = one.fields["src"], key.removeprefix("sent.")
            last = [seq for at_s, seq, _ in session.sent.get((src, topic), []) if at_s <= one.sent_s][-1:]
            if last and count != last[0] + 1:
                yield Break("counters_agree", one.sent_s, f"{src} says {count} on {topic}, and {last[0] + 1} were sent")


def judge_verdict(session: Session) -> Iterator[Break]:
    """Check: the verdict blames no law for effects of the schedule, and a hold judged stable was held."""
    # A report knows nothing of a sample that has risen under the tip.
    rises = any(one["fault"] == "risen" for one in session.events("device"))
    if session.verdict["kind"] in ("limit_cycle", "diverged") and session.laws == {"wave"} and not rises:
        yield Break("law_not_blamed", 0.0, f"{session.verdict['kind']}: {session.verdict['reason'][:200]}")
    hands, tips = session.direct[HAND, "haptic/state"], Newest(session.direct[TIP, "afm/state"])
    lost = sorted([*session.missing(HAND, "haptic/state"), *session.missing(TIP, "afm/state")])
    # A force profile that a person starts again is another session.
    zero_s, silent_s = (session.verdict["start_ns"] - session.epoch_ns) * 1e-9, DEADLINE_S + session.grain_s
    for hold in session.verdict["holds"]:
        inside = [one for one in hands if hold["start_s"] <= one.sent_s - zero_s <= hold["end_s"]]
        if hold["verdict"] != "stable" or not inside or not _is_known(lost, inside[0].sent_s, inside[-1].sent_s):
            continue
        held = [one for one in inside if one.fields["mode"] != "off" and tips.mode(one.sent_s, silent_s) == "follow"]
        if (held_s := len(held) / session.schedule["rate_hz"]) < 0.4 * (hold["end_s"] - hold["start_s"]):
            text = f"the hold from {hold['start_s']:.2f} s is stable, and hand and tip were in it for {held_s:.2f} s"
            yield Break("praised_was_held", inside[0].sent_s, text)


def judge_energy(session: Session) -> Iterator[Break]:
    """Check: in the first stretch that only waves moved, no more energy leaves both ports than has entered."""
    if session.schedule["law"] != "wave":
        return
    tips = session.direct[TIP, "afm/state"]
    first_s = next((one.sent_s for one in tips if one.fields["mode"] == "follow"), 0.0)
    begun_anew = [one["at_s"] for one in session.events("law", "kill", "site_restart")]
    ends = [one["at_s"] for one in session.events("device", "stall")]
    ends += [one.sent_s for one in tips if one.fields["mode"] != "follow"]
    ends += [one.sent_s for one in session.direct[HAND, "haptic/state"] if one.fields["mode"] == "off"]
    end_s = min([*begun_anew, *(one for one in ends if one > first_s + UNFELT_S)], default=session.end_s)
    masters = Newest(session.direct["controller@master", "law/status"])
    for one in session.direct["controller@slave", "law/status"]:
        if (near := masters.at(one.sent_s)) is None or not first_s < one.sent_s < end_s:
            continue
        sum_j = near.fields["port_energy_j"] + one.fields["port_energy_j"]
        power_w = abs(near.fields["port_power_w"]) + abs(one.fields["port_power_w"])
        if sum_j < -1e-6 - 0.02 * power_w:
            yield Break("energy_granted", one.sent_s, f"{1e6 * sum_j:.1f} uJ have come out of both ports")


def judge_going_on(session: Session) -> Iterator[Break]:
    """Check: a rig that can go on does so: after the last fault a person arms it, and hand and tip follow."""
    said = [one.fields["text"] for one in session.direct["launcher@master", "session/event"]]
    stops = [one["at_s"] for one in session.events("press", "kill", "site_restart", "device", "arm")]
    stops += [one["at_s"] for one in session.events("stall", "partition") if one["for_s"] > DEADLINE_S + HOLD_S]
    if failure := session.history["failure"]:
        # A stop, the end of a device, or so long a silence that the tip is withdrawn cancels the arming at the start of
        # a session, which a person must repeat.
        if "the session is running" in said or not any(at_s < session.end_s for at_s in stops):
            yield Break("goes_on", session.end_s, f"the rig has ended: {failure[:300]}")
        return
    at_s = next((one["at_s"] for one in session.acts if one["what"] == "recovered"), None)
    if at_s is None or (session.trip_s(99.0) > 0.06 and session.laws != {"wave"}):
        return
    for device, topic, wanted in ((HAND, "haptic/state", "position"), (TIP, "afm/state", "follow")):
        mode = Newest(session.direct[device, topic]).mode(at_s, DEADLINE_S + session.grain_s)
        if mode != wanted and not session.missing(device, topic)[-1:] > [at_s - 0.2]:
            yield Break("goes_on", at_s, f"{device} is {mode} after all was armed again")


def _each(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list) else (value,)


def judge_bounds(session: Session) -> Iterator[Break]:
    """Check: each quantity of a state is within its stated bound and a number, and no place steps beyond its speed."""
    for (_, topic), messages in session.direct.items():
        if topic.partition("/")[0] in ("haptic", "afm", "teleop"):
            for one in messages:
                values = [(name, each) for name, value in one.fields.items() for each in _each(value)]
                for name in [name for name, each in values if isinstance(each, float) and not isfinite(each)]:
                    yield Break("within_bounds", one.sent_s, f"{name} of {topic} is no number")
    for one in session.direct[HAND, "haptic/state"]:
        said = one.fields
        places = {"position_m": said["position_m"][2], "reference_m": said["reference_m"][2]}
        outside = {name: z for name, z in places.items() if not HAND_TRAVEL_M[0] <= -z <= HAND_TRAVEL_M[1]}
        outside |= {name: f for name in HAND_FORCES if not abs(f := said[name][2]) <= HAND_FORCE_N}
        if not abs(speed := said["velocity_m_per_s"][2]) <= HAND_M_PER_S:
            outside["velocity_m_per_s"] = speed
        for name, value in outside.items():
            yield Break("within_bounds", one.sent_s, f"{name} of the hand is {value:.6g}")
    for one in session.direct["controller@master", "haptic/command"]:
        if one.fields["mode"] != "off" and not HAND_TRAVEL_M[0] <= -one.fields["position_m"][2] <= HAND_TRAVEL_M[1]:
            yield Break("within_bounds", one.sent_s, f"the law leads the hand to {-one.fields['position_m'][2]:.6g} m")
    states = session.direct[TIP, "afm/state"]
    for before, one in pairwise([None, *states]):
        if not BASE_M[0] <= one.depth_m <= BASE_M[1]:
            yield Break("within_bounds", one.sent_s, f"the base is at {one.depth_m:.6g} m")
        # A new process has a new simulated instrument, and the place of one that is lost is that of its last reading.
        read = before is not None and all(pair.fields.get("device") in (None, "ok") for pair in (before, one))
        if not read or before.fields["seq"] + 1 != one.fields["seq"] or one.fields["hand_t_ns"] == 0:
            continue
        most_m = BASE_M_PER_S * (one.sent_s - before.sent_s + LATE_S)
        if abs(way_m := one.depth_m - before.depth_m) > most_m:
            yield Break("within_bounds", one.sent_s, f"the base has gone {way_m:.6g} m in one step")


ALL = (
    judge_tip,
    judge_bounds,
    judge_hand,
    judge_stops,
    judge_going_on,
    judge_recordings,
    judge_counters,
    judge_verdict,
    judge_energy,
    judge_told,
    judge_places,
    judge_forces,
    judge_chain,
)


def judged(session: Session) -> list[Break]:
    """Return the first break of each broken invariant, from the files of a session."""
    found = [one for judge in ALL for one in judge(session)]
    return list({one.invariant: one for one in reversed(found)}.values())


if __name__ == "__main__":
    sys.exit("\n".join(map(str, judged(Session(Path(sys.argv[1]))))) or None)
