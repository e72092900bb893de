"""Faults that are planted in the running product, each with the invariants that it breaks.

    with PLANTED["a stop that is not kept"].planted():
        tried(Schedule.drawn(7)).breaks

Most of them were real faults of the product, now corrected. Each patches the present code at run time, without changing
a file.
"""

import contextlib
import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple
from unittest import mock

import msgspec
from fault_schedule import HAND, LINK, PAGE, TIP, Event, Schedule

import services.afm_node.node as afm_node
import services.controller.master_half as master_half
import services.delay_node.far_stop as far_stop
import services.haptic_node.node as haptic_node
import services.haptic_node.parts as haptic_parts
from services.controller.half import ControllerHalf
from telenano.afm import safety as tip_guard
from telenano.analysis import holds, session_judge
from telenano.devices.afm.guarded import Step
from telenano.extend.hands import MODE_OFF, MODE_POSITION
from telenano.hand import safety as hand_guard
from telenano.launcher.restart_policy import RestartTracker
from telenano.laws import wave
from telenano.link.fate import Figures
from telenano.recording.writer import RecordingWriter
from telenano.runtime.loop import commands, kept_stop
from telenano.runtime.loop.estop_latch import EstopLatch
from telenano.timing.freshness import Freshness
from telenano.virtual.bus import VirtualBus
from telenano.wire.sequence import SequenceTracker

Patch = contextlib.AbstractContextManager[Any]


class Fault(NamedTuple):
    """A planted fault: its effect, the invariants that it breaks, its patches, and a session that shows it.

    needs: the kinds of events without which no schedule shows it, in words; a word may name several, parted by `|`.
    """

    about: str
    breaks: frozenset[str]
    patches: Callable[[], list[Patch]]
    events: tuple[Event, ...] = ()
    law: str = "wave"
    operator: str = "profile"
    needs: str = ""

    def may_show(self, schedule: Schedule) -> bool:
        """Return whether a schedule has the events without which it does not show the fault."""
        kinds = {event["kind"] for event in schedule.events}
        return all(kinds & set(word.split("|")) for word in self.needs.split())

    def schedule(self, processes: str) -> Schedule:
        """Return a schedule that shows the fault with these processes, and breaks nothing without it."""
        own = dict(law=self.law, events=self.events, operator=self.operator)
        return Schedule(seed=1, delay_s=0.02, link_s=0.0, processes=processes, **own)

    @property
    def is_of_report(self) -> bool:
        """Whether the report of a session is needed to show the fault."""
        return bool(self.breaks & {"praised_was_held", "law_not_blamed", "recorded_as_sent"})

    @contextlib.contextmanager
    def planted(self) -> Iterator[None]:
        """Plant the fault while the block runs."""
        with contextlib.ExitStack() as stack:
            for patch in self.patches():
                stack.enter_context(patch)
            yield


def _fault(
    about: str, breaks: str, *patches: Callable[[], Patch], events: Sequence[Event] = (), **session: str
) -> Fault:
    return Fault(about, frozenset(breaks.split()), lambda: [patch() for patch in patches], tuple(events), **session)


def _at(at_s: float, kind: str, **facts: Any) -> Event:
    return {"at_s": at_s, "kind": kind, **facts}


def _instead(owner: Any, name: str, make: Callable[[Any], Any]) -> Callable[[], Patch]:
    """Return a function that makes a patch, which replaces a function of `owner` by `make` of it."""
    return lambda: mock.patch.object(owner, name, make(getattr(owner, name)))


def _held_forever(step: Any) -> Any:
    return lambda params, *rest: step(params._replace(hold_time_s=1e9), *rest)


def _ageless(step: Any) -> Any:
    return lambda params, state, inputs, dt: step(params, state, inputs._replace(command_age_s=0.0), dt)


def _going_on_its_own(begun: Any) -> Any:
    return lambda state, inputs: begun(state, inputs)._replace(offset_m=0.0)


def _bytes_changed(write: Any) -> Any:
    def changed(self: Any, channel: int, log_ns: int, publish_ns: int, seq: int, payload: bytes) -> None:
        if seq % 300 == 299:
            payload = payload[:-1] + bytes([payload[-1] ^ 1])
        write(self, channel, log_ns, publish_ns, seq, payload)

    return changed


def _changed_on_the_way(send: Any) -> Any:
    def changed(self: Any, topic: str, payload: bytes) -> None:
        if topic.startswith("teleop/") and zlib.crc32(payload) % 50 == 0:
            message = msgspec.msgpack.decode(payload)
            payload = msgspec.msgpack.encode({**message, "position_m": [0.0, 0.0, message["position_m"][2] * 1.001]})
        send(self, topic, payload)

    return changed


def _silent_once_answered(handle: Any) -> Any:
    def silent(self: Any, control: Any, now_ns: int) -> bool:
        if control.id in self._answers:
            return False
        return bool(handle(self, control, now_ns))

    return silent


def _miscounted(take: Any) -> Any:
    def counted(self: Any, *given: Any) -> Any:
        stats = take(self, *given)
        return stats._replace(messages_out=stats.messages_out + stats.messages_out // 100)

    return counted


def _amplified(drawn: Any) -> Any:
    def more(*given: Any) -> Any:
        inbox, wave_sqrt_w = drawn(*given)
        return inbox, 1.15 * wave_sqrt_w

    return more


def _praising(judge: Any) -> Any:
    def praised(*given: Any) -> Any:
        hold = judge(*given)
        return hold if hold is None else hold._replace(verdict="stable")

    return praised


def _blaming(judge: Any) -> Any:
    def blamed(session: Any, part: Any, force_n: float) -> Any:
        verdict = judge(session, part, force_n)
        return verdict._replace(kind="limit_cycle") if session.known.interruptions else verdict

    return blamed


def _jumping(next_base: Any) -> Any:
    def step(params: Any, base_m: float, mode: int, *inputs: float) -> tuple[float, int]:
        if mode in (tip_guard.MODE_RETRACTING, tip_guard.MODE_ESTOP):
            return min(base_m, params.retract_position_m), 0
        moved: tuple[float, int] = next_base(params, base_m, mode, *inputs)
        return moved

    return step


def _unlimited(step: Any) -> Any:
    return lambda params, *rest: step(params._replace(force_limit_n=1.0), *rest)


def _scaled(factor: float) -> Callable[[Any], Any]:
    return lambda convert: lambda vector: factor * convert(vector)


def _turned(fields: Any) -> Any:
    def turned(self: Any, memory: Any) -> Any:
        said = fields(self, memory)
        return said | {"base_position_m": said["base_position_m"][::-1]}

    return turned


def _unlatched(step: Any) -> Any:
    def fallen(params: Any, state: Any, inputs: Any, dt: float) -> Any:
        return step(params, state._replace(estop_latched=state.estop_latched and not inputs.device_lost), inputs, dt)

    return fallen


def _armed(make: Any) -> Any:
    return lambda latched, mode, reference_m, armed=True: make(latched, mode, reference_m, armed)


def _held_in_motion(next_base: Any) -> Any:
    def moved(params: Any, base_m: float, mode: int, *rest: float) -> Any:
        return next_base(params, base_m, tip_guard.MODE_FOLLOW if mode == tip_guard.MODE_HOLD else mode, *rest)

    return moved


def _slow(next_base: Any) -> Any:
    return lambda params, *rest: next_base(params._replace(retract_speed_m_per_s=1e-9), *rest)


def _cut(next_base: Any) -> Any:
    def cut(*given: Any) -> Any:
        base_m, limited = next_base(*given)
        return min(base_m, 5e-9), limited

    return cut


def _driven(make: Any) -> Any:
    return lambda mode, *rest: make(MODE_POSITION if mode == MODE_OFF else mode, *rest)


PLANTED: dict[str, Fault] = {
    "a limit that is not looked at": _fault(
        "the tip is pressed with any force",
        "force_limited",
        _instead(tip_guard, "safety_step", _unlimited),
        events=[_at(2.0, "device", device="tip", fault="risen", for_s=0.7)],
        needs="device",
    ),
    "a slow retraction": _fault(
        "the base of a tip that is withdrawn goes at a thousandth of its speed",
        "place_of_mode goes_on",
        _instead(tip_guard, "_next_base", _slow),
        events=[_at(2.0, "press", site="slave", target="afm_node")],
    ),
    "a hold that goes on": _fault(
        "the base of a held tip goes on to its last reference",
        "place_of_mode",
        _instead(tip_guard, "_next_base", _held_in_motion),
        events=[_at(0.95, "delay", forward_s=0.12, backward_s=0.01)],
    ),
    "a resumption at full speed": _fault(
        "the base goes at its full speed as soon as a hold is over",
        "place_of_mode",
        _instead(tip_guard, "_slower", lambda _: lambda params, state, mode, dt: 0.0),
        events=[_at(0.92, "stall", node="controller@slave", for_s=0.12)],
        law="virtual_impedance",
    ),
    "a sign of the base": _fault(
        "the instrument goes the other way",
        "as_commanded goes_on praised_was_held law_not_blamed energy_granted",
        _instead(afm_node, "to_paper_axis", _scaled(-1.0)),
    ),
    "a reference scaled twice": _fault(
        "the hand's reference is a tenth more than the law commands",
        "as_commanded praised_was_held energy_granted within_bounds goes_on",
        _instead(haptic_node, "to_paper_axis", _scaled(1.1)),
    ),
    "a place of ten times the size": _fault(
        "the state of the hand has ten times its place",
        "states_are_true within_bounds as_commanded praised_was_held energy_granted goes_on law_not_blamed",
        _instead(haptic_node, "to_site_frame", lambda convert: lambda value: convert(10.0 * value)),
    ),
    "an axis for another": _fault(
        "the state of the tip has x in the place of z",
        "states_are_true goes_on praised_was_held law_not_blamed energy_granted as_commanded",
        _instead(Step, "fields", _turned),
    ),
    "a clamp after the guard": _fault(
        "something behind the guard keeps the base away, and says nothing of it",
        "as_commanded goes_on praised_was_held law_not_blamed energy_granted",
        _instead(tip_guard, "_next_base", _cut),
    ),
    "a motor that stays on": _fault(
        "the motor of a hand that is off is driven",
        "states_are_true as_commanded",
        _instead(haptic_node, "DriveCommand", _driven),
        events=[_at(2.0, "press", site="master", target="*")],
    ),
    "a latch that falls with its device": _fault(
        "a hand that was lost is no longer in emergency stop",
        "stop_is_last",
        _instead(hand_guard, "step", _unlatched),
        events=[
            _at(1.5, "press", site="master", target="haptic_node"),
            _at(2.0, "device", device="hand", fault="lost", for_s=0.2),
        ],
        needs="press device",
    ),
    "a tip that jumps": _fault(
        "a tip that is withdrawn is at its place of safety in one step",
        "within_bounds",
        _instead(tip_guard, "_next_base", _jumping),
        events=[_at(2.0, "press", site="slave", target="afm_node")],
    ),
    "an arm after a stop": _fault(
        "a command that was given before an emergency stop arms after it",
        "stop_is_last",
        _instead(EstopLatch, "reason_against", lambda _: lambda self, quoted, now_ns: ""),
        events=[
            _at(1.5, "press", site="slave", target="afm_node"),
            _at(3.2, "arm", target="both", place=False),
            _at(3.205, "press", site="slave", target="afm_node"),
        ],
        needs="press arm",
    ),
    "a stop that expires": _fault(
        "an emergency stop whose stamp is old, or of a clock that differs, is refused",
        "stop_kept goes_on stop_is_last",
        lambda: mock.patch.object(commands, "_OBEYED_AT_ANY_AGE", ("stop",)),
        events=[_at(0.0, "clock", ahead_s=-7.0, drift_ppm=0), _at(2.0, "press", site="master", target="*")],
        needs="press",
    ),
    "the window of a late stop": _fault(
        "the link lets samples of the hand pass while the instrument has not obeyed a stop",
        "stop_is_last",
        _instead(far_stop.FarStop, "holds_back", lambda _: lambda self, message: False),
        events=[_at(2.0, "press", site="master", target="afm_node")],
        needs="press",
    ),
    "a stale place": _fault(
        "an arming lets the base go to where the hand stands",
        "stop_is_last",
        _instead(tip_guard, "_begun", _going_on_its_own),
        events=[_at(2.0, "press", site="slave", target="afm_node"), _at(3.7, "arm", target="both", place=False)],
        needs="arm",
    ),
    "an outage near the end of a hold": _fault(
        "a hold is praised whatever has interrupted it",
        "praised_was_held",
        _instead(holds, "_judge_hold", _praising),
        events=[_at(1.5, "partition", direction="both", for_s=2.6)],
    ),
    "a lost answer": _fault(
        "a command that comes again is not answered again",
        "stop_kept goes_on",
        _instead(commands.CommandHandler, "handle", _silent_once_answered),
        events=[_at(2.0, "press", site="master", target="*"), _at(2.03, "kill", node=LINK, after=0, torn=0.0)],
    ),
    "the age of the hand": _fault(
        "the age of the hand's sample behind a command is not looked at",
        "nothing_late safe_in_time felt_hand",
        _instead(Freshness, "age_s", lambda _: lambda self, now_ns, hand_t_ns, message_age_s=0.0: message_age_s),
        events=[_at(0.95, "narrow", direction="forward", bytes_per_s=20e3, for_s=0.8)],
    ),
    "a tip that is never withdrawn": _fault(
        "the tip is held for as long as nothing comes",
        "safe_in_time",
        _instead(tip_guard, "safety_step", _held_forever),
        events=[_at(2.0, "partition", direction="both", for_s=0.8)],
    ),
    "a tip without a deadline": _fault(
        "any command counts as fresh for the tip",
        "safe_in_time nothing_late felt_hand goes_on",
        _instead(tip_guard, "_fresh", lambda _: lambda params, inputs: True),
        events=[_at(2.0, "partition", direction="both", for_s=0.8)],
    ),
    "a hand without a deadline": _fault(
        "any command counts as fresh for the hand",
        "safe_in_time nothing_late",
        _instead(hand_guard, "step", _ageless),
        # In a process of a site the hand stands still with the half beside it, but not beside that of the other one.
        events=[
            _at(2.0, "stall", node="controller@master", for_s=0.5),
            _at(0.345, "stall", node="controller@slave", for_s=0.08),
            _at(0.366, "delay", forward_s=0.03, backward_s=0.03),
        ],
    ),
    "a push that does not end": _fault(
        "the hand goes on being pushed by a page that has gone silent",
        "safe_in_time",
        _instead(haptic_parts, "age_s", lambda _: lambda now_ns, then_ns: 0.0),
        events=[_at(2.0, "stall", node=PAGE, for_s=0.6)],
        operator="page",
    ),
    "a hand that begins armed": _fault(
        "a new process of the hand counts as armed",
        "stop_is_last",
        _instead(hand_guard, "SafetyState", _armed),
        events=[_at(2.0, "kill", node=HAND, after=0, torn=0.0)],
    ),
    "a hand that feels nothing": _fault(
        "a hand counts as one that feels the tip, whenever the last answer came",
        "felt_hand",
        _instead(master_half.MasterController, "_feels", lambda _: lambda self, message: True),
        events=[_at(2.0, "partition", direction="backward", for_s=1.5)],
    ),
    "a changed recording": _fault(
        "the recorder changes a bit of some messages",
        "recorded_as_sent delivered_was_sent",
        _instead(RecordingWriter, "write", _bytes_changed),
    ),
    "a loss that is not said": _fault(
        "the report keeps silent about what is missing",
        "recorded_as_sent",
        _instead(
            session_judge,
            "recording_facts",
            lambda facts: lambda *given: {**facts(*given), "missing": [], "complete": True},
        ),
        events=[_at(2.0, "kill", node="recorder@master", after=0, torn=0.0)],
    ),
    "a head that is no loss": _fault(
        "what a new process sends before a recorder hears it is not counted",
        "recorded_as_sent",
        _instead(SequenceTracker, "_restart", lambda restart: lambda self, seq, run: restart(self, 0, run)),
        events=[_at(2.0, "kill", node=TIP, after=0, torn=0.0, how="replaced")],
    ),
    "a silence taken for a loss": _fault(
        "a device that sent nothing for a while counts as one whose messages are missing",
        "recorded_as_sent",
        _instead(
            session_judge,
            "_lacking",
            lambda lacking: (
                lambda session, *rest: (
                    [*lacking(session, *rest), "it was silent"]
                    if session.context.interruptions
                    else lacking(session, *rest)
                )
            ),
        ),
        events=[_at(2.0, "stall", node=TIP, for_s=0.6)],
    ),
    "a law that is blamed": _fault(
        "a motion of a hold that something interrupted is put down to the law",
        "law_not_blamed",
        _instead(holds, "_judge_motion", _blaming),
        _instead(holds, "_guarded", lambda _: lambda session, away, verdict, first=None: verdict),
        _instead(holds, "_interrupted", lambda _: lambda session, span_s, lacking, share, verdict: verdict),
        events=[_at(2.0, "stall", node=TIP, for_s=0.15)],
    ),
    "energy out of nothing": _fault(
        "the waves that a half takes up are greater than those that arrived",
        "energy_granted law_not_blamed goes_on",
        _instead(wave, "drawn", _amplified),
    ),
    "a message changed on its way": _fault(
        "the link changes the place in some messages",
        "delivered_was_sent",
        _instead(VirtualBus, "send", _changed_on_the_way),
    ),
    "a link that miscounts": _fault(
        "the link counts more messages than it sent on",
        "counters_agree",
        _instead(Figures, "take", _miscounted),
    ),
    "a stop that is not kept": _fault(
        "an emergency stop is not kept in a file",
        "stop_kept stop_is_last",
        _instead(kept_stop, "keep", lambda _: lambda path, payload: ""),
        events=[
            _at(1.4, "partition", direction="both", for_s=6.5),
            _at(1.5, "press", site="master", target="*"),
            _at(7.0, "kill", node=LINK, after=0, torn=0.0),
        ],
        needs="press",
    ),
    "a stop that ends with its process": _fault(
        "a device that is started again does not look for the stop that is kept for it",
        "stop_is_last",
        _instead(EstopLatch, "kept", lambda _: lambda self: None),
        events=[
            _at(1.5, "press", site="slave", target="afm_node"),
            _at(2.0, "kill", node=TIP, after=0, torn=0.0),
        ],
        needs="press kill|site_restart",
    ),
    "a tip that follows again by itself": _fault(
        "a tip that was withdrawn follows as soon as fresh commands come",
        "stop_is_last",
        _instead(tip_guard, "is_wished", lambda _: lambda mode, reason: mode == tip_guard.MODE_RETRACTED),
        events=[_at(2.0, "partition", direction="forward", for_s=0.6)],
    ),
    "a half that keeps the law of its start": _fault(
        "a half that is started again does not take over the law that was changed in the session",
        "goes_on",
        _instead(ControllerHalf, "_joins", lambda _: lambda self, law: False),
        events=[
            _at(1.6, "law", law="virtual_impedance"),
            _at(2.5, "kill", node="controller@slave", after=0, torn=0.0),
        ],
        needs="law kill|site_restart",
    ),
    "a node that stays away": _fault(
        "a node whose process has ended is not started again",
        "goes_on",
        _instead(RestartTracker, "due", lambda _: lambda self: []),
        events=[_at(2.0, "kill", node="controller@slave", after=0, torn=0.0)],
    ),
}
