"""Made-up recordings of sessions: Fig. 12 as with a perfect law, with chosen clocks, delays, losses and faults."""

import functools
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import numpy as np

from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.testing.filled_messages import examples
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire import encode
from telenano.wire.ends import end_data
from telenano.wire.topics import TOPICS

SCENARIO = Path(__file__).resolve().parents[2] / "telenano/settings/scenarios/fig12.yaml"
HAND, TIP, LINK, CONTROLLER = "haptic_node@master", "afm_node@slave", "delay_node@master", "controller@master"
BEGAN_NS = 1_750_000_000_000_000_000
MS, NS = 1_000_000, 1_000_000_000
STEP_S = 5e-3
SESSION_S = 8.0
FORCE_SCALE = 1e8
# Force profile of the hand, from the scenario.
HAND_TIMES_S, HAND_FORCES_N = (0.8, 1.2, 2.6, 2.9, 4.5, 4.6), (0.0, 1.0, 1.0, 2.0, 2.0, 0.0)


@functools.cache
def example(topic: str) -> Any:
    """Return an ordinary message of a topic."""
    return examples(TOPICS[topic])["ordinary"]


def hand_force_n(time_s: float) -> float:
    """Return F_m [N] at a time of the session [s]."""
    return float(np.interp(time_s, HAND_TIMES_S, HAND_FORCES_N))


@dataclass
class Made:
    """The properties of a made-up session; all times are session times [s].

    ahead_s, drift: the slave's clock is ahead by ahead_s when the session begins, and gains drift; there_s, back_s: the
    delays of both directions [s], with jitter_s; tip_n: alpha_f F_s at a time [N], by default the hand's force there_s
    ago; mode, in_contact: those of the instrument at a time; without: whether the recorder missed messages of a topic
    at a time; answers: time until which the hand gets answers; events: times and data of the instrument's reports;
    incidents: times and texts of the slave's launcher; end_s: end of the recording, None if the programme ended
    normally; set_s: time at which the tip acknowledged a setting; queue_s: growth of the forward delay per second [s];
    told_s: error of the offset that the link reports [s]; full_s: constant queue of the backward direction [s];
    blocked_s: begin and end of a time in which UDP is blocked from the slave to the master; hand_mode: mode of the
    device at a time; killed_s: time at which the hand's process is killed: its numbers then restart, and its programme
    does not run, or restarts at anew_s; set_back_s: time at which the one clock of both sites is set back, and by how
    much; silent: whether messages of a topic are not sent at a time; anew_tip_s: time at which the instrument's process
    is restarted, so that its numbers restart; longer_s: time and amount of a permanent increase of the forward delay,
    which the link of two machines reports.
    """

    ahead_s: float = 0.0
    drift: float = 0.0
    there_s: float = 0.02
    back_s: float = 0.02
    tip_n: Callable[[float], float] | None = None
    mode: Callable[[float], str] = lambda time_s: "follow"
    in_contact: Callable[[float], bool] | None = None
    without: Callable[[str, float], bool] = lambda topic, time_s: False
    answers: float = SESSION_S
    events: tuple[tuple[float, dict[str, Any]], ...] = ()
    end_s: float | None = None
    jitter_s: float = 2e-4
    incidents: tuple[tuple[float, str], ...] = ()
    set_s: float | None = None
    queue_s: float = 0.0
    told_s: float = 0.0
    full_s: float | None = None
    blocked_s: tuple[float, float] | None = None
    hand_mode: Callable[[float], str] = lambda time_s: "position"
    killed_s: float | None = None
    anew_s: float | None = None
    set_back_s: tuple[float, float] | None = None
    silent: Callable[[str, float], bool] = lambda topic, time_s: False
    anew_tip_s: float | None = None
    longer_s: tuple[float, float] | None = None

    def hand_at(self, time_s: float) -> tuple[float, float]:
        """Return session_s [s], and F_m [N], of the hand at a session time."""
        programme_s = time_s
        if self.killed_s is not None and time_s >= self.killed_s:
            programme_s = -1.0 if self.anew_s is None else time_s - self.anew_s
        session_s = programme_s if 0.0 <= programme_s <= SESSION_S and time_s <= SESSION_S else -1.0
        return session_s, hand_force_n(session_s) if session_s >= 0.0 else 0.0

    def slave_ns(self, time_s: float) -> int:
        """Return the time on the slave's clock at a session time [ns]."""
        return BEGAN_NS + round((time_s + self.ahead_s + self.drift * time_s) * NS)

    def write(self, folder: Path, site: str = "master") -> Path:
        """Write the recording of a site's recorder, which receives messages of the other site after their delay."""
        dice = random.Random(5)
        name = "session.mcap" if site == "master" else f"{site}.mcap"
        writer = RecordingWriter.create(f"recorder@{site}", FileSettings(directory=folder, file_name=name))
        writer.attach("scenario.yaml", "application/yaml", SCENARIO.read_bytes(), BEGAN_NS)
        writer.add_metadata("recording", {"node": f"recorder@{site}"})
        rows: list[tuple[int, int, str, str, int, int, bytes]] = []
        counts: dict[tuple[str, str], int] = {}

        def add(topic: str, src: str, time_s: float, **fields: Any) -> None:
            if self.silent(topic, time_s):
                return
            of_slave = src.endswith("@slave")
            t_ns = self.slave_ns(time_s) if of_slave else BEGAN_NS + round(time_s * NS)
            seq = counts.get((topic, src), 0)
            counts[topic, src] = seq + 1
            if self.without(topic, time_s) or (self.end_s is not None and time_s > self.end_s):
                return
            model = TOPICS[topic].model
            made = msgspec.structs.replace(example(topic), seq=seq, t_ns=t_ns, src=src, **fields)
            if "v" not in fields:
                made = msgspec.structs.replace(made, v=model.version)
            if site == "master":
                log_ns = BEGAN_NS + round((time_s + (self.back_s if of_slave else 0.0)) * NS)
            else:
                log_ns = self.slave_ns(time_s + (0.0 if of_slave else self.there_s))
            rows.append((log_ns + 50_000, len(rows), topic, src, t_ns, seq, encode(made)))

        steps = round((SESSION_S + 0.3) / STEP_S)
        trip_s = self.there_s + self.back_s
        for step in range(-round(0.3 / STEP_S), steps):
            time_s = step * STEP_S
            session_s, pressed_now_n = self.hand_at(time_s)
            if self.killed_s is not None and abs(time_s - self.killed_s) < 0.5 * STEP_S:
                counts.pop(("haptic/state", HAND), None)
            if self.anew_tip_s is not None and abs(time_s - self.anew_tip_s) < 0.5 * STEP_S:
                counts.pop(("afm/state", TIP), None)
            answered_s = min(time_s, self.answers) - trip_s
            is_answered = self.answers > 0.0
            add(
                "haptic/state",
                HAND,
                time_s,
                session_s=session_s,
                operator_force_n=(0.0, 0.0, -pressed_now_n),
                mode=self.hand_mode(time_s),
                position_m=(0.0, 0.0, -1e-3 * time_s),
                answered_seq=round(answered_s / STEP_S) + 1000 if is_answered else 0,
                answered_t_ns=BEGAN_NS + round(answered_s * NS) if is_answered else 0,
                answered_at_ns=BEGAN_NS + round((answered_s + trip_s) * NS) if is_answered else 0,
            )
            add("haptic/command", CONTROLLER, time_s, position_m=(0.0, 0.0, -1e-3 * time_s))
            pressed_n = self.hand_at(time_s - self.there_s)[1]
            tip_n = pressed_n if self.tip_n is None else self.tip_n(time_s)
            touches = pressed_n > 0.0 if self.in_contact is None else self.in_contact(time_s)
            mode = self.mode(time_s)
            add(
                "afm/state",
                TIP,
                time_s,
                tip_force_n=(0.0, 0.0, tip_n / FORCE_SCALE),
                in_contact=touches,
                mode=mode,
                hand_t_ns=BEGAN_NS + round((time_s - self.there_s) * NS),
                hand_seq=max(0, step + 1000),
            )
        self._clock(add, dice)
        for time_s, data in self.events:
            src, text = TIP, f"the AFM is in mode {data['mode']}: {data.get('reason')}"
            if data["mode"] == "off":
                src, text = HAND, "no command within the deadline: off until commands are fresh"
            add("session/event", src, time_s, kind="mode", level="warning", id="", text=text, data=data)
        if self.set_s is not None:
            text = "set afm_node.safety.force_limit_n to 3e-08"
            add("session/event", TIP, self.set_s, kind="ack", level="info", id="a", text=text, data={})
        for time_s, text in self.incidents:
            ended = {"about_node": text.partition(" ")[0], "exit_code": -9} if "was killed" in text else {}
            ended |= {"outside": "drift", "law": "wave"} if "was shown to hold" in text else {}
            add("session/event", "launcher@slave", time_s, kind="node", level="warning", id="", text=text, data=ended)
        if self.end_s is None:
            for src in (CONTROLLER, TIP, HAND):
                own = {topic: count for (topic, source), count in counts.items() if source == src}
                data = end_data({**own, "session/event": own.get("session/event", 0) + 1})
                add("session/event", src, SESSION_S + 0.3, kind="node", level="info", id="", text="ended", data=data)
        channels: dict[tuple[str, str], int] = {}
        for log_ns, _, topic, src, t_ns, seq, payload in sorted(rows):
            if (topic, src) not in channels:
                channels[topic, src] = writer.channel(topic, src, src.partition("@")[2])
            channel = channels[topic, src]
            if self.set_back_s is not None:
                fields = self._set_back(msgpack.unpackb(payload))
                log_ns, t_ns, payload = self._set_back(log_ns), fields["t_ns"], msgpack.packb(fields)
            writer.write(channel, log_ns, t_ns, seq, payload)
        writer.finish()
        return writer.path

    def _set_back(self, value: Any) -> Any:
        """Return a time stamp, or a message with all its time stamps, by the clock that is set back."""
        assert self.set_back_s is not None
        at_s, by_s = self.set_back_s
        if isinstance(value, dict):
            return {key: self._set_back(one) if key.endswith("_ns") else one for key, one in value.items()}
        return value - round(by_s * NS) if isinstance(value, int) and value >= BEGAN_NS + round(at_s * NS) else value

    def _clock(self, add: Callable[..., None], dice: random.Random) -> None:
        """Add the link's reports on the other clock, ten times a second, computed by the link's own filter."""
        found = OffsetFilter(64)
        for tenth in range(-3, round(10 * (SESSION_S + 0.3))):
            asked_s = 0.1 * tenth - 0.08 - self.there_s - self.back_s
            there, back = (way + dice.expovariate(1.0 / self.jitter_s) for way in (self.there_s, self.back_s))
            there += self.queue_s * (asked_s + 1.0)
            if self.longer_s is not None and asked_s >= self.longer_s[0]:
                there += self.longer_s[1]
            stamps = (self.slave_ns(asked_s + there), self.slave_ns(asked_s + there + 1e-4))
            back_ns = BEGAN_NS + round((asked_s + there + 1e-4 + back) * NS)
            asked_ns = BEGAN_NS + round(asked_s * NS)
            found.record(asked_ns, *stamps, back_ns)
            answered_s = asked_s + there + 1e-4
            add("clock/pong", TIP, answered_s, ping_t_ns=asked_ns, received_ns=stamps[0])
            estimate = found.estimate()
            assert estimate is not None and math.isfinite(estimate.offset_s)
            told = {**estimate._asdict(), "offset_s": estimate.offset_s + self.told_s, "valid": True}
            clock = msgspec.structs.replace(example("link/status").clock, **told)
            clock = clock if self.longer_s is None else found.report()
            answer = {"answer_sent_ns": stamps[1], "answer_received_ns": back_ns}
            # An earlier version does not report the answers.
            add("link/status", LINK, 0.1 * tenth, clock=clock, **({} if self.told_s else answer))
            if self.full_s is not None and tenth % 5 == 0:
                counts = {"sent": 50 * (tenth + 10), "settled": 50 * tenth + 200, "lost": 5 * tenth + 20}
                line = {"queue_s": self.full_s, "queue_low_s": 0.8 * self.full_s, "queue_high_s": 1.2 * self.full_s}
                line |= {"capacity_bit_per_s": 1_000_000, "capacity_low_bit_per_s": 900_000}
                # Both directions have the same queue, but only the slave reports its own as full.
                for source, way, sends in ((LINK, "backward", "free"), ("controller@slave", "forward", "full")):
                    add("link/network", source, 0.1 * tenth, direction=way, **counts, **line, line=sends)
            if self.blocked_s is not None and tenth % 5 == 0:
                begin_s, end_s = self.blocked_s
                since = {"blocked_since_ns": BEGAN_NS + round(begin_s * NS)} if begin_s < 0.1 * tenth < end_s else {}
                # The queue is unknown if no datagram was ever answered.
                unknown = {"queue_s": None, "capacity_bit_per_s": None, "line": "free"}
                add("link/network", LINK, 0.1 * tenth, direction="backward", **{**unknown, **since})
