"""A rig in virtual time that is stopped, lost, started again and armed, and a judge of it that sees only its states.

    rig = ResetRig("virtual_impedance")
    rig.begin()
    rig.press(0.4, 2.4)
    rig.estop("*")
    rig.arm()
    assert not rig.faults()

The judge knows the places of tip and hand and what a person has said, and nothing of guards, laws and offsets: a base
that withdraws or waits goes nowhere else, and one that follows without a word goes no further towards the sample than
the hand has gone since.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

from telenano.virtual import LINK_NODE, VirtualRig, constant_timing
from telenano.wire.messages import Message
from telenano.wire.nodes import HAND, LAUNCHER, TIP

MASTER_HALF, SLAVE_HALF = "controller@master", "controller@slave"
POSITION_SCALE = 1.5e-6
# What a hand that nobody touches may move by noise and attraction [m].
STILL_M = 2e-5
# What the place of a hand between two of its samples is not known by, at the tip [m].
SAME_M = 1e-11
# A command of the hand takes no longer until the tip has acted on it, or holds [s].
LATEST_S = 0.06
# A law of waves goes a little before its hand, by the impulse that is on its line.
LEADS = 1.02
# A law's reference is before the sample of the hand that has followed it by less than this [s].
LEAD_S = 0.01
# The devices have obeyed a stop after this time [s].
OBEYED_S = 0.03
_SAYS_S = 0.016
_TIMING = constant_timing(1_000_000)


class At(NamedTuple):
    """A place at a time: where the base or the hand is towards the sample [m], and the mode of the device.

    reference_m: where the motor of the hand drives it [m].
    """

    time_s: float
    place_m: float
    mode: str
    estop: bool = False
    reference_m: float = 0.0

    @property
    def farthest_m(self) -> float:
        """How far the hand is, or is driven by its motor [m]."""
        return self.place_m if self.mode == "off" else max(self.place_m, self.reference_m)


class Stretch(NamedTuple):
    """What a person has said from a time on: whether the tip has a word to go, and whether both devices are stopped."""

    from_s: float
    goes: bool
    stopped: tuple[str, ...] = ()


class ResetRig(VirtualRig):
    """The rig, with a person at a page for a hand."""

    def __init__(
        self, law: str = "virtual_impedance", seed: int = 1, *, rate_hz: int | None = None, **controller: Any
    ) -> None:
        """Build a rig under a law, whose link delays nothing but by a millisecond."""
        self.tips: list[At] = []
        self.hands: list[At] = []
        self.answers: dict[str, Any] = {}
        self.events: list[Any] = []
        self.states: list[Any] = []
        document = {
            "name": "reset",
            "description": "A hand presses, and the rig is stopped",
            "duration_s": 3600.0,
            "haptic_node": {"operator": {"kind": "interactive"}},
            "controller": {"law": law, **controller},
            "afm_node": {"rest_distance_m": 10.0e-9},
        }
        settings = () if rate_hz is None else (f"realtime.rate_hz={rate_hz}",)
        super().__init__(None, seed, settings, _TIMING, document)
        self.page = self.endpoint("viz_node@master")
        self.said = [Stretch(0.0, False)]
        self._to_hand = False
        # An instrument that is started again begins at its safe place, wherever the one before it was killed.
        self.begun_s: list[float] = []
        self.now_s = 0.0
        self._count = 0

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        """Note what the devices say."""
        said: Any = message
        time_s = (message.t_ns - self.clock.epoch_offset_ns) * 1e-9
        if topic == "afm/state":
            self.tips.append(At(time_s, -said.base_position_m[2], said.mode))
            self.states.append(said)
        elif topic == "haptic/state":
            self.hands.append(At(time_s, -said.position_m[2], said.mode, said.estop, -said.reference_m[2]))
        elif topic == "session/event":
            self.events.append(said)
            if said.id:
                self.answers[f"{said.src} {said.id}"] = said
        super().carry(topic, message, payload, sent_ns)

    def wait(self, time_s: float) -> None:
        """Let time pass [s]."""
        self.now_s += time_s
        self.run_until(self.now_s)

    def press(self, time_s: float, force_n: float) -> None:
        """Press with a force [N] for a time [s], and let go."""
        end_s = self.now_s + time_s
        while self.now_s < end_s:
            self.page.publish("operator/force", force_n=(0.0, 0.0, -force_n))
            self.wait(_SAYS_S)
        self.page.publish("operator/force", force_n=(0.0, 0.0, 0.0))

    def begin(self) -> None:
        """Begin a session: the tip goes to the hand."""
        self.wait(0.1)
        assert self.arm(place="hand") == {HAND: "ack", TIP: "ack"}
        self.wait(0.15)
        self._send("start", HAND)

    def contact(self) -> None:
        """Press until the tip is in contact, and let go there."""
        for _ in range(8):
            self.press(0.3, 2.4)
            if self.states[-1].in_contact:
                break
        self.wait(0.1)
        assert self.states[-1].in_contact

    def estop(self, target: str) -> None:
        """Give an emergency stop."""
        stopped = {"*": (HAND, TIP)}.get(target, (target,))
        self._send("estop", target)
        self._say(goes=False, stopped=tuple({*self.said[-1].stopped, *stopped}))

    def command(self, command: str, target: str, seen: Message | None = None, **parameters: Any) -> None:
        """Send a command that is none of arm and estop, which ends the word of the tip."""
        self._send(command, target, **parameters)
        if target in (TIP, "afm_node", "*"):
            self._say(goes=False)

    def arm(self, *targets: str, quotes: bool = True, **parameters: Any) -> dict[str, str]:
        """Arm devices as a person does who knows of all stops; return the kinds of the answers."""
        kinds = {}
        for target in targets or (HAND, TIP):
            word = parameters if target == TIP else {}
            goes, stopped = self.said[-1].goes, self.said[-1].stopped
            # A law may take the tip to the hand at a speed of its own, for as long as it follows.
            keeps = self._to_hand and self.tips[-1].mode in ("follow", "hold")
            # Where the arm is obeyed, it is from now on.
            others = tuple(each for each in stopped if each != target)
            self._say(goes=goes or bool(word), stopped=others)
            answer = self._send("arm", target, **word)
            if answer is not None and answer.kind == "refused" and "latch" in answer.data and quotes:
                self.wait(0.002)
                proof = {"node_latch": {target: answer.data["latch"]}, "node_t_ns": {target: answer.t_ns}}
                answer = self._send("arm", target, proof, **word)
            kinds[target] = "" if answer is None else answer.kind
            if kinds[target] != "ack":
                self._say(goes=goes, stopped=stopped)
            elif target == TIP:
                self._to_hand = "place" in word or (keeps and not word)
                self._say(goes=bool(word) or keeps, stopped=others)
        return kinds

    def lose(self, device: str, *, lost: bool) -> None:
        """Let a device be lost to its node, or be there again."""
        node: Any = self.loops[device].node
        node.is_lost = lost
        if lost:
            self._say(goes=self.said[-1].goes and device != TIP)

    def kill(self, key: str, away_s: float = 0.4) -> None:
        """End a node as a kill does, and start it again after a time [s]."""
        if key == TIP:
            self._say(goes=False)
        self.restart(key, round(away_s * 1e9))
        self.now_s += away_s
        if key == TIP:
            self.begun_s.append(self.clock.monotonic_ns() * 1e-9)
        if key in (HAND, TIP):
            # The stop of a virtual rig is not kept in a file.
            self._say(goes=self.said[-1].goes, stopped=tuple(each for each in self.said[-1].stopped if each != key))

    def halt(self, key: str, time_s: float) -> None:
        """Let a node stand still for a time [s], and wait for it."""
        self.stall(key, time_s)
        self.wait(time_s)

    def _send(self, command: str, target: str, proof: dict[str, Any] | None = None, **parameters: Any) -> Any:
        """Send a command, and return its answer, or the newest one where it has several."""
        self._count += 1
        name = f"c{self._count}"
        fields = {"id": name, "command": command, "target": target, "parameters": parameters, **(proof or {})}
        for _ in range(2):
            self.endpoint(LAUNCHER).publish("session/control", **fields)
        self.wait(0.006)
        found = [answer for key, answer in self.answers.items() if key.endswith(f" {name}")]
        return found[-1] if found else None

    def _say(self, *, goes: bool, stopped: tuple[str, ...] | None = None) -> None:
        now_s = self.clock.monotonic_ns() * 1e-9
        self.said.append(Stretch(now_s, goes, self.said[-1].stopped if stopped is None else stopped))

    @property
    def base_m(self) -> float:
        """Where the base is, towards the sample [m]."""
        return self.tips[-1].place_m

    def forget(self) -> None:
        """Forget what was seen until now."""
        del self.tips[:-1], self.hands[:-200], self.states[:-1]
        self.said = [Stretch(self.tips[-1].time_s, self.said[-1].goes, self.said[-1].stopped)]

    def faults(self) -> list[str]:
        """Return in sentences where the tip went towards the sample by itself, and which stop was not obeyed."""
        return [*_of_tip(self, self._said_at(), POSITION_SCALE), *_of_stops(self)]

    def _said_at(self) -> Callable[[float], Stretch]:
        said = self.said

        def at(time_s: float) -> Stretch:
            # What was said lately may still be on its way, in either direction.
            near = [each for each in said if time_s - LATEST_S <= each.from_s <= time_s]
            before = next((each for each in reversed(said) if each.from_s < time_s - LATEST_S), said[0])
            return Stretch(before.from_s, before.goes or any(each.goes for each in near), before.stopped)

        return at


def _of_tip(rig: ResetRig, said_at: Callable[[float], Stretch], scale: float) -> list[str]:
    """Return where the tip went towards the sample without a word, by itself."""
    tips, hands = rig.tips, rig.hands
    found: list[str] = []
    first, begin = 0, None
    for before, now in pairwise(tips):
        if now.time_s > hands[-1].time_s - LEAD_S:
            break
        is_begun = any(before.time_s < begun_s <= now.time_s for begun_s in rig.begun_s)
        if is_begun or said_at(now.time_s).goes or said_at(before.time_s).goes:
            begin = None
            continue
        if now.mode not in ("follow", "hold") or before.mode not in ("follow", "hold"):
            begin = None
            if now.place_m > before.place_m + SAME_M and now.mode not in ("follow", "hold"):
                found.append(
                    f"{now.time_s:.3f} s: {now.mode}, and went by {1e9 * (now.place_m - before.place_m):.3g} nm"
                )
                continue
            if now.mode not in ("follow", "hold"):
                continue
        if begin is None:
            begin = before
            while first < len(hands) - 1 and hands[first].time_s < begin.time_s - LATEST_S:
                first += 1
            lowest = min((at.place_m for at in hands[first:] if at.time_s <= begin.time_s + LATEST_S), default=0.0)
            highest, last = lowest, first
        # The reference of the motor goes a little before the hand, and what it commands comes with the next sample.
        while last < len(hands) and hands[last].time_s <= now.time_s + LEAD_S:
            highest = max(highest, hands[last].farthest_m)
            last += 1
        if now.place_m > begin.place_m + LEADS * scale * (highest - lowest) + SAME_M:
            away_nm = 1e9 * (now.place_m - begin.place_m)
            hand_nm = 1e9 * scale * (highest - lowest)
            found.append(
                f"{now.time_s:.3f} s: {now.mode}, {away_nm:.3g} nm towards the sample, by the hand {hand_nm:.3g}"
            )
            begin = None
    return found


def _of_stops(rig: ResetRig) -> list[str]:
    """Return which stop was not obeyed, or not to the end."""
    found = []
    for device, seen in ((TIP, rig.tips), (HAND, rig.hands)):
        number, since_s = 0, None
        for at in seen:
            while number < len(rig.said) and rig.said[number].from_s <= at.time_s:
                is_stopped = device in rig.said[number].stopped
                since_s = (since_s if since_s is not None else rig.said[number].from_s) if is_stopped else None
                number += 1
            obeys = at.mode == "estop" if device == TIP else at.estop
            if since_s is not None and at.time_s > since_s + OBEYED_S and not obeys:
                found.append(f"{at.time_s:.3f} s: {device} was stopped at {since_s:.3f} s, and is in {at.mode}")
                break
    return found


NODES_TO_RESTART = (HAND, MASTER_HALF, SLAVE_HALF, TIP)
LINKS = (LINK_NODE,)
