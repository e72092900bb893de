"""Sessions in virtual time in which nodes stand still, and recordings of them that lack what a plan takes away.

    session = InterruptedSession.of(seed)
    path = session.record(folder)

A plan is drawn from a seed, and says what is true of it: when hand or AFM sent nothing, and whether anything that was
sent is missing. What takes messages away knows nothing of how a report tells them apart.
"""

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from telenano.recording.reader import Recording
from telenano.recording.rewrite import CopyWriter
from telenano.virtual import LINK_NODE, STARTED_S, VirtualRig

HAND, TIP = "haptic_node@master", "afm_node@slave"
NODES = (HAND, TIP, "controller@master", "controller@slave", LINK_NODE)
SENDS = {HAND: "haptic/state", TIP: "afm/state"}
# a hold from 0.2 s to 1.5 s of the operator's force profile, whose end is the last thing that happens
HOLD_S = (0.2, 1.5)
SESSION_S = 1.7
SCENARIO: dict[str, Any] = {
    "name": "interrupted",
    "description": "A hand presses the tip onto mica, and holds it",
    "duration_s": SESSION_S,
    "realtime": {"rate_hz": 250.0},
    "haptic_node": {
        "operator": {
            "kind": "force_profile",
            "points": [
                {"time_s": time_s, "force_n": force_n}
                for time_s, force_n in ((0.1, 0.0), (HOLD_S[0], 1.0), (HOLD_S[1], 1.0), (1.6, 0.0))
            ],
        }
    },
    "afm_node": {"rest_distance_m": 10.0e-9},
}
# a source that stands still for longer than this is silent [s]; what is not much longer or shorter is drawn for none
LEAST_S = 0.05


class Stall(NamedTuple):
    """A node that stands still: which, from when in the session [s], and for how long [s]."""

    node: str
    at_s: float
    for_s: float


class Loss(NamedTuple):
    """What a recorder lacks: of which channel, every which message, from when to when in the session [s]."""

    channel: str
    every: int
    from_s: float
    to_s: float


class InterruptedSession(NamedTuple):
    """A session by its plan; cut: which end of it is not recorded."""

    seed: int
    law: str
    delay_s: float
    stalls: tuple[Stall, ...]
    losses: tuple[Loss, ...]
    cut: Literal["no", "beginning", "end"] = "no"

    @classmethod
    def of(cls, seed: int) -> "InterruptedSession":
        """Draw a session."""
        dice = random.Random(seed)
        kind = dice.choice(["whole", "stalls", "stalls", "losses", "both", "cut"])
        stalls, losses = [], []
        at_s = dice.uniform(0.0, 0.5)
        while kind in ("stalls", "both") and at_s < 1.4 and len(stalls) < 2:
            stalls.append(Stall(dice.choice(NODES), at_s, dice.choice([0.02, dice.uniform(0.08, 0.6)])))
            at_s += stalls[-1].for_s + dice.uniform(0.1, 0.6)
        for _ in range(dice.randrange(1, 3) if kind in ("losses", "both") else 0):
            from_s = dice.uniform(0.0, 1.6)
            channel = dice.choice(["haptic/state", "afm/state", "teleop/forward", "session/event", "link/status"])
            to_s = dice.choice([from_s + dice.uniform(0.01, 0.5), 9.0])
            losses.append(Loss(channel, dice.choice([1, 1, 2, 7]), from_s, to_s))
        cut: Literal["no", "beginning", "end"] = dice.choice(["beginning", "end"]) if kind == "cut" else "no"
        law, delay_s = dice.choice(["virtual_impedance", "wave"]), dice.choice([0.0, 0.01])
        return cls(seed, law, delay_s, tuple(stalls), tuple(losses), cut)

    @property
    def silent_s(self) -> list[tuple[str, float, float]]:
        """Topic of hand or AFM, and from when to when in the session it sent nothing [s]."""
        return [(SENDS[one.node], one.at_s, one.at_s + one.for_s) for one in self.stalls if self._is_silent(one)]

    @staticmethod
    def _is_silent(stall: Stall) -> bool:
        return stall.node in SENDS and stall.for_s > LEAST_S

    def record(self, folder: Path) -> tuple[Path, int]:
        """Write the recording to a folder; return it, and how many messages of the session it lacks."""
        document = {**SCENARIO, "controller": {"law": self.law}}
        document["delay_node"] = {way: {"delay_s": self.delay_s} for way in ("forward", "backward")}
        rig = VirtualRig(folder, self.seed, (), scenario=document)
        rig.run_until(0.15)
        rig.command("arm", "*", place="hand")
        rig.run_until(STARTED_S)
        rig.command("start", "haptic_node")
        for stall in self.stalls:
            rig.run_until(STARTED_S + stall.at_s)
            rig.stall(stall.node, stall.for_s)
        rig.run_until(STARTED_S + SESSION_S + (0.15 if self.cut == "no" else 0.0))
        whole = rig.finish()
        if not self.losses and self.cut == "no":
            return whole, 0
        return self._without(whole, folder / "lacking.mcap")

    def _without(self, whole: Path, target: Path) -> tuple[Path, int]:
        recording = Recording(whole)
        began_ns = self._began_ns(recording)
        last = {message.channel: place for place, message in enumerate(recording.raw())}
        counts: dict[Any, int] = {}
        lacks = 0
        with CopyWriter(target) as writer:
            writer.copy_attachments_and_metadata([recording])
            for place, message in enumerate(recording.raw()):
                at_s = 1e-9 * (message.log_ns - began_ns)
                number = counts[message.channel] = counts.get(message.channel, 0) + 1
                facts = dict(message.channel.metadata)
                # the last word of a publisher says how much it has sent, and without one nobody knows
                is_last = place == last[message.channel] and message.channel.topic.startswith("session/event")
                is_lost = (
                    not is_last and number > 1 and facts.get("via") == "direct" and self._loses(message, at_s, number)
                )
                if is_lost or self._is_cut(at_s):
                    lacks += 1
                    continue
                writer.add(message)
        return target, lacks

    def _loses(self, message: Any, at_s: float, number: int) -> bool:
        own: Sequence[Loss] = [one for one in self.losses if one.channel == message.channel.channel_topic]
        return any(one.from_s <= at_s < one.to_s and number % one.every == 0 for one in own)

    def _is_cut(self, at_s: float) -> bool:
        return (self.cut == "beginning" and at_s < 0.4) or (self.cut == "end" and at_s > 0.9)

    @staticmethod
    def _began_ns(recording: Recording) -> int:
        hand = recording.columns("haptic/state", ("t_ns", "session_s"))
        first = int((hand["session_s"] >= 0.0).argmax())
        return int(hand["t_ns"][first]) - round(1e9 * float(hand["session_s"][first]))
