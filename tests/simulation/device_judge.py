"""Invariants on what hand and instrument were told, and on where they are, by the account of the devices themselves.

A state that a node publishes is its own word. Here it is compared with the device behind it, so that what the other
invariants conclude from mode, place and force holds of the device.
"""

from bisect import bisect_right
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

from session_files import HAND, LATE_S, TIP, Break, Newest, Seen, Session, TipStep

# Stated defaults: the place of safety [m], the speeds of base, retraction and hand [m/s], and the acceleration of the
# base after a hold [m/s^2].
RETRACTED_M, BASE_M_PER_S, RETRACT_M_PER_S, HAND_M_PER_S, RESUME_M_PER_S2 = -100e-9, 2e-6, 1e-6, 0.0394, 2e-6
# Metres at the tip per metre at the hand, and newtons at the hand per newton at the tip.
POSITION_SCALE, FORCE_SCALE = 1.5e-6, 1e8
# Differences that rounding explains [m, N].
SAME_M, SAME_N = 1e-12, 1e-12
MODES = ("off", "position", "force")
# The message of a turn is sent within this time of the step, and not before this time after it [s].
TURN_S, SENDING_S = 0.0001, 9.9e-6
# Laws that lead the base by the place of the hand, and the way of a free base per way of the hand and scale.
OF_PLACE, BY_PLACE = {"virtual_impedance", "position_force"}, (0.8, 1.25)
# Least way of the hand at which the two are compared [m], and the greatest force of a tip that is free [N].
WAY_M, FREE_N = 1e-3, 0.5e-9
# Greatest difference of the share of its force that the hand holds from what the report says.
SAME_SHARE = 0.1


def _with_steps(states: list[Seen], steps: list[Any]) -> Iterator[tuple[Seen, Any, Any]]:
    """Yield each recorded state with the step that it tells of, and the step before; None if that was of no process."""
    times = [one.at_s for one in steps]
    for state in states:
        # The next step may come before the message of this one, in a process that has the command for it.
        place = bisect_right(times, state.sent_s - SENDING_S) - 1
        if place >= 0 and state.sent_s - times[place] <= TURN_S:
            step = steps[place]
            yield state, step, steps[place - 1] if step.again and place else None


def judge_told(session: Session) -> Iterator[Break]:
    """Check: a state says what its device was told and gave; the hand's reference makes no step beyond its speed."""
    for state, step, _ in _with_steps(session.direct[TIP, "afm/state"], session.tip_steps):
        force_n = state.fields["tip_force_n"][2]
        if abs(state.depth_m - step.base_m) > SAME_M or not abs(force_n - step.force_n) <= SAME_N:
            said = f"{1e9 * state.depth_m:.3f} nm and {1e9 * force_n:.3f} nN"
            given = f"{1e9 * step.base_m:.3f} nm and {1e9 * step.force_n:.3f} nN"
            yield Break("states_are_true", state.sent_s, f"the state of the tip says {said}, the instrument {given}")
    commands = Newest(session.direct["controller@master", "haptic/command"])
    lost_s = session.missing("controller@master", "haptic/command")
    for state, step, before in _with_steps(session.direct[HAND, "haptic/state"], session.hand_steps):
        said = state.fields
        command = commands.at(state.sent_s)
        if command is not None and (command.fields["hand_seq"], command.fields["hand_t_ns"]) == (
            said["answered_seq"],
            said["answered_t_ns"],
        ):
            asked_m = -command.fields["position_m"][2]
            is_newest = not any(command.sent_s < one_s <= state.sent_s for one_s in lost_s)
            if step.mode == 1 and not said["limited"] and is_newest and abs(asked_m - step.reference_m) > 1e-9:
                text = f"the hand is told {1e3 * step.reference_m:.4f} mm, and the law asks {1e3 * asked_m:.4f} mm"
                yield Break("as_commanded", state.sent_s, text)
        pairs = [
            (said["position_m"][2], -step.position_m),
            (said["reference_m"][2], -step.reference_m),
            (said["motor_force_n"][2], -step.motor_n),
        ]
        if said["mode"] != MODES[step.mode] or any(abs(a - b) > 1e-12 for a, b in pairs):
            text = f"the state of the hand says {said['mode']}, {pairs[0][0]:.6g} m, {pairs[2][0]:.4g} N"
            yield Break("states_are_true", state.sent_s, f"{text}, its device {MODES[step.mode]}, {pairs}")
        if before is not None and step.mode == before.mode == 1:
            most_m = HAND_M_PER_S * (step.at_s - before.at_s + LATE_S)
            if abs(way_m := step.reference_m - before.reference_m) > most_m:
                yield Break("within_bounds", step.at_s, f"the reference of the hand has gone {way_m:.6g} m in one step")


def judge_places(session: Session) -> Iterator[Break]:
    """Check: the base is where its mode says: held it stands, withdrawn it goes away at its speed, and never nears."""
    held_s, period_s = -1e9, 1.0 / session.schedule["rate_hz"]
    for state, step, before in _with_steps(session.direct[TIP, "afm/state"], session.tip_steps):
        mode, at_s = state.fields["mode"], state.sent_s
        if mode != "follow":
            # A base that is withdrawn meanwhile comes back at its full speed.
            held_s = at_s if mode == "hold" else -1e9
        if before is None:
            continue
        way_m, passed_s = step.told_m - before.told_m, step.at_s - before.at_s
        if mode == "hold" and abs(way_m) > SAME_M:
            yield Break("place_of_mode", at_s, f"the base goes {1e9 * way_m:.3f} nm although it is held")
        elif mode not in ("follow", "hold") and way_m > SAME_M:
            yield Break("place_of_mode", at_s, f"the base goes {1e9 * way_m:.3f} nm towards the sample while {mode}")
        elif mode in ("retracting", "estop", "retracted") and step.told_m > RETRACTED_M + SAME_M:
            # The first step of a retraction covers the time since the step before; a pause counts as one period.
            least_m = RETRACT_M_PER_S * min(passed_s, period_s) - RETRACT_M_PER_S * LATE_S
            if mode == "retracted" or -way_m < least_m:
                text = f"the base is at {1e9 * step.told_m:.2f} nm and goes {-1e9 * way_m:.3f} nm away while {mode}"
                yield Break("place_of_mode", at_s, text)
        elif mode == "follow":
            since_s = at_s - held_s + period_s + LATE_S
            most_m = min(RESUME_M_PER_S2 * since_s, BASE_M_PER_S) * (passed_s + LATE_S)
            if abs(way_m) > most_m:
                yield Break("place_of_mode", at_s, f"the base goes {1e9 * way_m:.3f} nm in one step after a hold")


def judge_forces(session: Session) -> Iterator[Break]:
    """Check: a tip that feels more than its limit, or no number, is withdrawn from the next step on until armed."""
    events = session.direct[TIP, "session/event"]
    arms_s = [
        one.sent_s for one in events if one.fields["kind"] == "ack" and one.fields["data"].get("command") == "arm"
    ]
    arms_s += session.missing(TIP, "session/event")
    limit_n = session.schedule["force_limit_n"]
    modes = Newest(session.direct[TIP, "afm/state"])
    pressed: TipStep | None = None
    for before, step in pairwise(session.tip_steps):
        if not step.again or any(before.at_s < one_s <= step.at_s + TURN_S for one_s in arms_s):
            pressed = None
        elif pressed is None and modes.mode(before.at_s + TURN_S, 2 * TURN_S) in ("follow", "hold"):
            refused = not before.valid or not before.force_n <= limit_n
            pressed = before if refused and before.status != "lost" else None
        if pressed is not None and step.told_m > before.told_m + SAME_M:
            text = f"{1e9 * pressed.force_n:.1f} nN were felt at {pressed.at_s:.3f} s, {1e9 * limit_n:.1f} allowed"
            yield Break("force_limited", step.at_s, f"the base goes towards the sample, and {text}")
        if pressed is not None and step.told_m > RETRACTED_M + SAME_M and step.told_m >= before.told_m:
            text = f"{1e9 * pressed.force_n:.1f} nN were felt at {pressed.at_s:.3f} s, {1e9 * limit_n:.1f} allowed"
            yield Break("force_limited", step.at_s, f"the base stands at {1e9 * step.told_m:.1f} nm, and {text}")


def judge_chain(session: Session) -> Iterator[Break]:
    """Check: the base follows the command in force, and the command the hand, by sign and scale; a report says so."""
    commands = {
        (one.fields["seq"], one.fields["hand_t_ns"]): one for one in session.direct["controller@slave", "afm/command"]
    }
    hands = {one.fields["t_ns"]: one for one in session.direct[HAND, "haptic/state"]}
    begun: tuple[float, float] | None = None
    for state, step, before in _with_steps(session.direct[TIP, "afm/state"], session.tip_steps):
        said = state.fields
        command = commands.get((said["command_seq"], said["hand_t_ns"]))
        if said["mode"] != "follow" or said["limited"] or before is None:
            begun = begun if said["mode"] == "follow" and before is not None and step.at_s - before.at_s < 0.1 else None
            continue
        if command is not None and command.fields.get("hand_armed"):
            asked_m = command.depth_m - said.get("offset_m", 0.0)
            if abs(asked_m - step.told_m) > 1e-12:
                text = f"the base is told {1e9 * step.told_m:.3f} nm, the command in force asks {1e9 * asked_m:.3f} nm"
                yield Break("as_commanded", state.sent_s, text)
        hand = hands.get(said["hand_t_ns"])
        if hand is None or abs(step.force_n) > FREE_N or said.get("offset_m") or not session.laws <= OF_PLACE:
            continue
        place = -hand.fields["position_m"][2], step.told_m
        begun = begun or place
        if abs(way_m := place[0] - begun[0]) > WAY_M:
            ratio = (place[1] - begun[1]) / (POSITION_SCALE * way_m)
            if not BY_PLACE[0] <= ratio <= BY_PLACE[1]:
                text = f"the hand has gone {1e3 * way_m:.2f} mm, and the base {ratio:.2f} times the scale of that"
                yield Break("as_commanded", state.sent_s, text)
                begun = None
    yield from _judge_shares(session)


def _judge_shares(session: Session) -> Iterator[Break]:
    zero_s = (session.verdict["start_ns"] - session.epoch_ns) * 1e-9
    for hold in session.verdict["holds"]:
        if hold["verdict"] != "stable" or hold["hold_ratio"] is None or hold["judged_to_s"] is None:
            continue
        from_s, to_s = (zero_s + 0.3 * hold["judged_from_s"] + 0.7 * hold["judged_to_s"], zero_s + hold["judged_to_s"])
        # The state that ends a contact is no part of it, and its step is just before.
        forces_n = [FORCE_SCALE * one.force_n for one in session.tip_steps if from_s <= one.at_s < to_s - TURN_S]
        if len(forces_n) < 5:
            continue
        tip_n, hand_n = sum(forces_n) / len(forces_n), hold["hand_force_n"]
        if abs(tip_n * hold["hold_ratio"] - hand_n) > SAME_SHARE * max(tip_n, hand_n):
            words = f"the ratio {hold['hold_ratio']:.3f}, the tip {tip_n:.3f} N, and the hand {hand_n:.3f} N"
            text = f"the hold from {hold['start_s']:.2f} s has {words}"
            yield Break("praised_was_held", from_s, text)
