"""What returns stays where it was made safe: drawn losses, returns and commands, judged by the emulated instrument.

The truth is where the emulated base stands, and what a person has said; neither driver nor messages are asked.
"""

import random
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from telenano_devices.doubles.controller_line import PARAMS, Gwyscope, Nanonis
from telenano_devices.t7.stage_line import StageLine

from telenano.testing import InstrumentRig, afm_node
from telenano.wire import RefusedError

# Way towards the sample that a slow controller may still carry out after the tip was made safe [m]: 4 ms of the guard.
STANDS_M = 4e-3 * PARAMS.safety.base_speed_m_per_s
# Greatest way of a base towards the sample in a tick of 1 ms [m]: twice the speed of the guard, over the 8 ms for which
# a slow controller catches up at most.
TICK_M = 2.0 * PARAMS.safety.base_speed_m_per_s * 8e-3
NEAR_M = -70e-9
# Time for which a slow controller still carries out what the process before has sent [ms].
GRACE_MS = 20


def cut(line: Any) -> None:
    line.reachable = False


def silence(line: Any) -> None:
    line.running = False


def reset(line: Any) -> None:
    line.close()


def delay(line: Any) -> None:
    line.latency_ms = 70.0


LOSSES: dict[str, Callable[[Any], None]] = {"cut": cut, "silent": silence, "reset": reset, "late": delay}


def mend(line: Any) -> None:
    line.reachable = line.running = True
    line.latency_ms = 0.0
    if hasattr(line, "mend"):
        line.mend()


def t7_base_m(line: StageLine) -> float:
    return float(line.driver.calibration.base_m(line.model.output_v))


class Kind(NamedTuple):
    """An emulated instrument: how it is made, where its base is [m], and its section for a new process."""

    line: Callable[[], Any]
    base_m: Callable[[Any], float]


KINDS = {
    "gwyscope": Kind(Gwyscope, lambda line: float(line.base_m)),
    "nanonis": Kind(Nanonis, lambda line: float(line.base_m)),
    "t7": Kind(StageLine, t7_base_m),
}


class Walk:
    """A node with an emulated instrument, and the judge of where its base goes."""

    def __init__(self, bench_of: Any, kind: str, seed: int) -> None:
        self.kind, self.line, self.rng = KINDS[kind], KINDS[kind].line(), random.Random(f"{kind} {seed}")
        self.bench_of, self.lost_ms, self.said = bench_of, 0, False
        self.rig = InstrumentRig(bench_of("afm_node@slave"), self.line)
        self.base_m = self.furthest_m = self.kind.base_m(self.line)
        self.worst_m, self.step_m, self.done, self.grace_ms = 0.0, 0.0, list[str](), 0

    def begin_again(self) -> None:
        """Let the process of the node end without a word, and start another one on the same instrument."""
        self.line.close()
        mend(self.line)
        old = self.line.driver
        self.line.driver = type(old)(*self._arguments(old), **self.line.clock)
        self.rig.node = afm_node(self.rig.bench, self.line.driver, None)
        # What the old process had sent is still carried out.
        self.lost_ms, self.grace_ms = 0, GRACE_MS

    @staticmethod
    def _arguments(driver: Any) -> tuple[Any, ...]:
        registers = (driver.registers,) if hasattr(driver, "registers") else ()
        return driver.calibration, *registers, PARAMS.safety

    def act(self) -> None:
        """Let something happen that makes the tip safe: a loss of a drawn length, a stop, or the end of the process."""
        what = self.rng.choice((*LOSSES, "estop", "process"))
        self.done.append(what)
        if what == "process":
            self.begin_again()
        elif what == "estop":
            self.rig.control(what)
            self.said = False
        elif not self.lost_ms:
            self.lost_ms = self.rng.choice((5, 30, 90, 300))
            LOSSES[what](self.line)

    def speak(self) -> None:
        """Let a person arm the tip, with or without the permission to go."""
        try:
            self.rig.control("arm", **self.rng.choice(({"place": "hand"}, {})))
            self.said, self.grace_ms = True, 0
            self.done.append("armed")
        except RefusedError:
            self.done.append("not armed")

    def tick(self) -> None:
        self.rig.tick(1, NEAR_M)
        if self.lost_ms:
            self.lost_ms -= 1
            if not self.lost_ms:
                mend(self.line)
        if self.grace_ms:
            self.grace_ms -= 1
            self.said = self.said and self.grace_ms > 0
        state = self.rig.bench.take("afm/state")[-1]
        if state.mode not in ("follow", "hold") and not state.armed and not self.grace_ms:
            self.said = False
        base_m = self.kind.base_m(self.line)
        # Without a word the base may only go away from the sample, and stays where it has been furthest.
        self.furthest_m = base_m if self.said else min(self.furthest_m, base_m)
        self.worst_m = max(self.worst_m, base_m - self.furthest_m)
        self.step_m, self.base_m = max(self.step_m, base_m - self.base_m), base_m


def walked(bench_of: Any, kind: str, seed: int, rounds: int = 3) -> Walk:
    walk = Walk(bench_of, kind, seed)
    for _ in range(rounds):
        walk.speak()
        for _ in range(walk.rng.choice((5, 60, 300))):
            walk.tick()
        # Something happens, and something else while the tip is away.
        for wait in (walk.rng.choice((10, 40, 400)), 250):
            walk.act()
            for _ in range(wait):
                walk.tick()
    return walk


def broken(bench_of: Any, kind: str, seeds: range) -> list[tuple[int, list[str], float, float]]:
    found = []
    for seed in seeds:
        walk = walked(bench_of, kind, seed)
        if walk.worst_m > STANDS_M or walk.step_m > TICK_M:
            found.append((seed, walk.done, walk.worst_m, walk.step_m))
    return found


@pytest.mark.check("takes some seconds")
@pytest.mark.drawn(1.0)
@pytest.mark.parametrize("kind", KINDS)
def test_no_order_of_losses_returns_and_words_drives_a_base_without_a_word(bench_of: Any, kind: str) -> None:
    assert broken(bench_of, kind, range(4)) == []


@pytest.mark.endurance
@pytest.mark.parametrize("part", range(20))
@pytest.mark.parametrize("kind", KINDS)
def test_two_thousand_orders_drive_no_base_without_a_word(bench_of: Any, kind: str, part: int) -> None:
    assert broken(bench_of, kind, range(100 + 34 * part, 134 + 34 * part)) == []
