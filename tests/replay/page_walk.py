"""A walk through the page without a browser, against a rig in virtual time.

    with PageWalk(seed=3) as walk:
        walk.disturb()
        presses = walk.presses_to_touch()

What the page offers is decided by the page's own code, bundled for Node.js (`web/test/walker.ts`); what it is told are
the frames that the server makes of the messages of the rig. A generator draws what happens: stops, withdrawals, losses,
laws, programs, a hand that is pressed by somebody else, keys at the page, and reloads, in any order.
"""

import base64
import json
import random
import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any, Self

import msgpack
from reset_rig import ResetRig

from services.viz_node.feed import Feed, seen
from services.viz_node.source import TOPICS_SHOWN
from services.viz_node.streams import described
from telenano.console.coupling import TOPICS, couple
from telenano.runtime.loop.commands import Command
from telenano.wire.errors import RigError
from telenano.wire.messages import Message
from telenano.wire.nodes import HAND, TIP

STEP_S = 0.05
MOST_PRESSES = 8
# A button is waited for as long as the slowest way of a tip, or a program, takes.
PATIENCE_S = 60.0
LAWS = ("virtual_impedance", "position_force", "wave", "passivity")
# What may happen; the keys of a person are drawn more often.
THINGS = ("withdraw", "stop", "stop one", "law", "press", "program", "reload", "silence", "couple", "lose", "restart")
THINGS += ("keys",) * 3
# A page that pressed and is not heard for so long has lost the hand, and its server withdraws the tip.
SILENT_S = 1.2


class WalkRig(ResetRig):
    """The rig, whose messages a feed makes into frames for the page."""

    def __init__(self, law: str, seed: int) -> None:
        self.feed = Feed()
        self.heard: list[Any] = []
        super().__init__(law, seed, rate_hz=250)

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        if topic in TOPICS_SHOWN:
            self.feed.record(seen(topic, message.src, message.t_ns, message))
        if topic in TOPICS:
            self.heard.append(message)
        super().carry(topic, message, payload, sent_ns)


class PageWalk:
    """A page beside a rig; `trace` is what happened, for the report of a failure."""

    def __init__(self, seed: int, bundle: Path, node: str = "node") -> None:
        self._draw = random.Random(seed)
        self.rig = WalkRig(self._draw.choice(LAWS), seed)
        self.trace: list[str] = []
        self._bundle, self._node = bundle, node
        self._answers: list[dict[str, Any]] = []
        self._pending: Callable[[], bool] | None = None
        self._pending_s = 0.0
        self._force_n = 0.0
        self.seen: dict[str, Any] = {}

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(closing(self.rig))
            self._page = stack.enter_context(
                subprocess.Popen(
                    [self._node, str(self._bundle)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
                )
            )
            stack.callback(self._page.kill)
            self.rig.begin()
            self._say(reload=True)
            self._open = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def wait(self, time_s: float) -> None:
        """Let time pass [s], in which the page is told what happens, and presses as it means to."""
        for _ in range(round(time_s / STEP_S)):
            self._step()

    def key(self, key: str) -> None:
        """Press a key at the page."""
        offer = self.seen.get("offer" if key == "n" else "other") or {}
        self.trace.append(
            f"{self.rig.now_s:.1f} s: key {key}, {offer.get('label', 'nothing')}: {self.seen.get('says', '')}"
        )
        self._say(key=key)

    def disturb(self) -> None:
        """Let one thing happen that the generator draws, and wait a little."""
        rig, draw = self.rig, self._draw
        what = draw.choice(THINGS)
        self.trace.append(f"{rig.now_s:.1f} s: {what}")
        match what:
            case "withdraw":
                rig.command("stop", "afm_node")
            case "stop":
                rig.estop("*")
            case "stop one":
                rig.estop(draw.choice((HAND, TIP)))
            case "law":
                rig.command("set", "controller", law=draw.choice(LAWS))
            case "press":
                with suppress(AssertionError):
                    rig.press(draw.choice((0.3, 1.0, 2.0)), draw.choice((-3.0, 1.5, 4.0)))
            case "program":
                rig.command("set", "afm_node", program=draw.choice(("curve", "scan")))
                self.wait(draw.choice((0.2, 2.0)))
                rig.command("set", "afm_node", program="abort")
            case "reload":
                self._say(reload=True)
            case "silence":
                rig.wait(SILENT_S)
                if self.seen.get("held"):
                    rig.command("stop", "afm_node")
                self._say(reload=True)
            case "keys":
                for _ in range(draw.randint(1, 5)):
                    self.key(draw.choice("nnnd"))
                    self.wait(draw.choice((0.1, 0.5, 2.0)))
            case "couple":
                self.couple()
            case "lose":
                device = draw.choice((HAND, TIP))
                rig.lose(device, lost=True)
                self.wait(draw.choice((0.1, 0.4)))
                rig.lose(device, lost=False)
            case "restart":
                rig.kill(draw.choice((HAND, TIP)))
                rig.forget()
        self.wait(draw.choice((0.1, 0.5, 1.5)))

    def presses_to_touch(self) -> int:
        """Press the filled button until the tip touches a hand that is held; return how often.

        Raises AssertionError if there is no button to press, or it is pressed too often.
        """
        for presses in range(MOST_PRESSES + 1):
            self._until_ready()
            if self.touches:
                return presses
            assert presses < MOST_PRESSES, f"{presses} presses lead to no touch: {self.report()}"
            self.key("n")
            self.wait(1.0)
        raise AssertionError

    @property
    def touches(self) -> bool:
        """Whether the tip touches the sample, and the page holds the hand."""
        return bool(self.seen["touches"] and self.seen["held"])

    def report(self) -> str:
        """Return the end of what happened, as sentences."""
        state, hand = self.rig.states[-1], self.rig.hands[-1]
        now = f"tip {state.mode}, {1e9 * state.separation_m:.1f} nm, hand {1e3 * hand.place_m:.1f} mm {hand.mode}"
        return "\n".join([*self.trace[-25:], f"now {self.seen.get('says')!r} {self.seen.get('offer')}; {now}"])

    def _until_ready(self) -> None:
        end_s = self.rig.now_s + PATIENCE_S
        while not (self.seen.get("offer") or {}).get("isReady") and not self.touches:
            assert self.rig.now_s < end_s, f"nothing can be pressed: {self.report()}"
            self._step()

    def _step(self) -> None:
        begin_s = self.rig.now_s
        while self.rig.now_s < begin_s + STEP_S - 1e-9:
            if self.seen.get("held"):
                self.rig.page.publish("operator/force", force_n=(0.0, 0.0, -self._force_n))
            self.rig.wait(0.0125)
        if self._pending is not None and (self._pending() or self.rig.now_s > self._pending_s):
            self._answers.append({"ok": self._pending(), "text": "done"})
            self._pending = None
        self._say()

    def _say(self, *, key: str = "", reload: bool = False) -> None:
        """Tell the page what came, press a key or load it again, and carry out what it asks for."""
        at_s = self.rig.now_s
        frames = []
        if reload:
            self._pending = None
            self._answers.clear()
            frames.append(
                {"k": "snapshot", "at_s": at_s, "role": "operator", "me": "walker", "window": "A", "commands": True}
            )
            frames[0] |= {"hand": True, "streams": described(), "forms": {}, "source": {"kind": "live", "name": ""}}
            frames[0] |= self.rig.feed.snapshot()
        frames.append({"k": "tick", "at_s": at_s, **self.rig.feed.take()})
        step: dict[str, Any] = {
            "now_ms": 1e3 * at_s,
            "frames": [base64.b64encode(msgpack.packb(each)).decode() for each in frames],
        }
        step |= {"key": key} if key else {}
        step |= {"reload": True} if reload else {}
        step["answers"], self._answers = self._answers, []
        assert self._page.stdin is not None and self._page.stdout is not None
        self._page.stdin.write(json.dumps(step) + "\n")
        self._page.stdin.flush()
        self.seen = json.loads(self._page.stdout.readline())
        self._force_n = self.seen["force_n"]
        if not self.seen["held"]:
            self.rig.page.publish("operator/force", force_n=(0.0, 0.0, 0.0))
        for asked in self.seen["asked"]:
            self._carry_out(asked)

    def _carry_out(self, asked: dict[str, Any]) -> None:
        """Do what a page asks of its server."""
        rig, parameters = self.rig, asked.get("parameters", {})
        self.trace.append(f"{rig.now_s:.1f} s: asks {asked['command']} {parameters}")
        if self._pending is not None:
            # The command that comes ends the one before it, whose page is told so.
            self._answers.append({"ok": False, "text": "going back was ended"})
            self._pending = None
        if asked["command"] == "arm":
            kinds = rig.arm(HAND, TIP)
            if parameters and "refused" not in kinds.values():
                kinds |= rig.arm(TIP, **parameters)
            self._pending = lambda: "refused" not in kinds.values() and bool(rig.states[-1].placed)
            self._pending_s = rig.now_s + 20.0
        else:
            rig.command(asked["command"], HAND if asked["command"] == "start" else asked["target"], **parameters)
            self._answers.append({"ok": True, "text": "done"})

    def couple(self) -> None:
        """Let hand and tip meet again, as the key of the page does, and note where that ended."""
        before = self.rig.states[-1].in_contact
        try:
            self.trace.append(couple(_Console(self)))
        except RigError as error:
            self.trace.append(str(error))
        self.wait(0.2)
        is_held = self.seen["held"]
        assert before or is_held or not self.rig.states[-1].in_contact, f"it ended in contact: {self.report()}"


class _Console:
    """What `couple` asks of a rig."""

    def __init__(self, walk: PageWalk) -> None:
        self._walk = walk

    def look(self, duration_s: float) -> Iterable[Any]:
        rig = self._walk.rig
        rig.heard.clear()
        self._walk.wait(max(duration_s, STEP_S))
        return sorted(rig.heard, key=lambda message: int(message.t_ns))

    def send(self, command: Command, retry_s: float = 0.0) -> str:
        rig = self._walk.rig
        end_s = rig.now_s + retry_s
        while True:
            if command.name == "arm":
                refused = rig.arm(TIP, **dict(command.parameters))[TIP] != "ack"
            else:
                rig.command(command.name, TIP, **dict(command.parameters))
                refused = False
            if not refused:
                for _ in range(400):
                    if not command.placed or rig.states[-1].placed:
                        return "done"
                    self._walk.wait(STEP_S)
                raise RigError("it was not placed")
            if rig.now_s >= end_s:
                raise RigError("not armed")
            self._walk.wait(0.1)


def walks(seeds: Iterable[int], bundle: Path, node: str) -> Iterator[tuple[int, int]]:
    """Carry out a walk for each seed; yield the seed and the number of presses."""
    for seed in seeds:
        with PageWalk(seed, bundle, node) as walk:
            for _ in range(random.Random(seed).randint(2, 6)):
                walk.disturb()
            yield seed, walk.presses_to_touch()
