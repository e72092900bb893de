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
from fault_schedule import LINK, TIP, Event, Schedule

import services.controller.master_half as master_half
import services.delay_node.far_stop as far_stop
from services.controller.half import ControllerHalf
from telenano.afm import safety as tip_guard
from telenano.analysis import holds, session_judge
from telenano.hand import safety as hand_guard
from telenano.launcher.restart_policy import RestartTracker
from telenano.laws import wave
from telenano.link.fate import Figures
from telenano.recording.writer import RecordingWriter
from telenano.runtime.loop import commands, kept_stop
from telenano.runtime.loop.estop_latch import EstopLatch
from telenano.timing.freshness import Freshness
from telenano.virtual.bus import VirtualBus

Patch = contextlib.AbstractContextManager[Any]


class Fault(NamedTuple):
    """A planted fault: its effect, the invariants that it breaks, its patches, and the events that show it."""

    about: str
    breaks: frozenset[str]
    patches: Callable[[], list[Patch]]
    events: tuple[Event, ...] = ()

    @property
    def schedule(self) -> Schedule:
        """A schedule that shows the fault, and breaks nothing without it."""
        return Schedule(seed=1, law="wave", delay_s=0.02, link_s=0.0, events=self.events)

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


def _fault(about: str, breaks: str, *patches: Callable[[], Patch], events: Sequence[Event] = ()) -> Fault:
    return Fault(about, frozenset(breaks.split()), lambda: [patch() for patch in patches], tuple(events))


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


PLANTED: dict[str, Fault] = {
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
    ),
    "a stop that expires": _fault(
        "an emergency stop whose stamp is old, or of a clock that differs, is refused",
        "stop_kept goes_on stop_is_last",
        lambda: mock.patch.object(commands, "_OBEYED_AT_ANY_AGE", ("stop",)),
        events=[_at(0.0, "clock", ahead_s=-7.0, drift_ppm=0), _at(2.0, "press", site="master", target="*")],
    ),
    "the window of a late stop": _fault(
        "the link lets samples of the hand pass while the instrument has not obeyed a stop",
        "stop_is_last",
        _instead(far_stop.FarStop, "holds_back", lambda _: lambda self, message: False),
        events=[_at(2.0, "press", site="master", target="afm_node")],
    ),
    "a stale place": _fault(
        "an arming lets the base go to where the hand stands",
        "stop_is_last",
        _instead(tip_guard, "_begun", _going_on_its_own),
        events=[_at(2.0, "press", site="slave", target="afm_node"), _at(3.7, "arm", target="both", place=False)],
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
        events=[_at(2.0, "stall", node="controller@master", for_s=0.5)],
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
    ),
    "a stop that ends with its process": _fault(
        "a device that is started again does not look for the stop that is kept for it",
        "stop_is_last",
        _instead(EstopLatch, "kept", lambda _: lambda self: None),
        events=[
            _at(1.5, "press", site="slave", target="afm_node"),
            _at(2.0, "kill", node=TIP, after=0, torn=0.0),
        ],
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
    ),
    "a node that stays away": _fault(
        "a node whose process has ended is not started again",
        "goes_on",
        _instead(RestartTracker, "due", lambda _: lambda self: []),
        events=[_at(2.0, "kill", node="controller@slave", after=0, torn=0.0)],
    ),
}
