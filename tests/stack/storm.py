"""Nodes of a running rig that are killed, ended or stopped again and again, and what its recording has to show then."""

import os
import random
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from stack_rig import Rig

from telenano.recording.messages import RecordedChannel
from telenano.recording.reader import Recording
from telenano.recording.records import GAP_TOPIC, GapRecord

HAND, TIP, RECORDER = "haptic_node@master", "afm_node@slave", "recorder@master"
NODES = (HAND, "controller@master", "delay_node@master", "controller@slave", TIP, RECORDER)
RESTARTED = "was started again"
# five exits within half a minute end a rig
_MOST_EXITS, _WINDOW_S = 3, 32.0
# a hand that presses with one force and another, so that a long session has many holds
STEP_S, FORCES_N = 3.0, (1.0, 0.7)
# a recorder that is killed loses its last flush; a busy machine starts the next one late
MARGIN_S = 1.0


class Disturbance(NamedTuple):
    """What was done to a node, and the time [ns] from that until it was in operation again."""

    node: str
    number: int
    begin_ns: int
    end_ns: int


def steps(duration_s: float) -> str:
    """Return the setting of an operator who presses in steps."""
    points = [{"time_s": 0.2, "force_n": 0.0}]
    for step in range(round(duration_s / STEP_S)):
        force_n, begin_s = FORCES_N[step % 2], 0.4 + STEP_S * step
        points += [{"time_s": round(t, 3), "force_n": force_n} for t in (begin_s + 0.2, begin_s + STEP_S)]
    listed = ", ".join(f"{{time_s: {p['time_s']}, force_n: {p['force_n']}}}" for p in points)
    return f"haptic_node.operator.points=[{listed}]"


def disturb(rig: Rig, node: str, number: int, stop_s: float = 0.0) -> Disturbance:
    """Send a signal to a node, wait until it is back, and take the rig up again as an operator would."""
    process_id = rig.process_of(node)
    assert process_id is not None, f"{node} does not run"
    before = restarts(rig, node)
    begin_ns = time.time_ns()
    os.kill(process_id, number)
    if number == signal.SIGSTOP:
        time.sleep(stop_s)  # how long the node stands still is what is injected
        os.kill(process_id, signal.SIGCONT)
    else:
        rig.wait_until(lambda: restarts(rig, node) > before, f"the restart of {node}")
        rig.wait_until(lambda: rig.process_of(node) not in (None, process_id), f"the process of {node}")
    take_up(rig, anew=node == HAND and number != signal.SIGSTOP)
    if node == RECORDER:
        files = len(parts(rig))
        rig.wait_until(lambda: len(parts(rig)) >= files and parts(rig)[-1].stat().st_size > 20_000, "a next part")
    return Disturbance(node, number, begin_ns, time.time_ns())


def restarts(rig: Rig, node: str) -> int:
    return (rig.out / "logs" / "launcher@master.log").read_text().count(f"{node} {RESTARTED}")


def take_up(rig: Rig, *, anew: bool) -> None:
    """Arm what waits to be armed, and start the programme of a hand that was started again."""

    def done(*arguments: str) -> Callable[[], bool]:
        return lambda: rig.telenano("session", *arguments).returncode == 0

    rig.wait_until(done("arm", "--target", "afm_node"), "an AFM that can be armed again")
    if anew:
        rig.wait_until(done("start", "--target", "haptic_node"), "a hand whose programme can be started")
    rig.wait_until(done("arm", "--target", "haptic_node"), "a hand that can be armed again")


def plan(seed: int, numbers: Sequence[int]) -> Iterator[tuple[str, int, float]]:
    """Yield node, signal and the pause before it [s], at random; no node so often that the rig would be given up."""
    draw = random.Random(seed)
    numbers = draw.sample(list(numbers), len(numbers))
    exits: dict[str, deque[float]] = {node: deque() for node in NODES}
    for place, number in enumerate(numbers):
        # now and then long enough for holds that nothing disturbs
        pause_s = 9.0 if place % 8 == 0 else draw.uniform(0.3, 2.0)
        yield _next_node(draw, exits), number, pause_s


def _next_node(draw: random.Random, exits: dict[str, deque[float]]) -> str:
    while True:
        now = time.monotonic()
        for times in exits.values():
            while times and now - times[0] > _WINDOW_S:
                times.popleft()
        free = [node for node, times in exits.items() if len(times) < _MOST_EXITS]
        if free:
            node = draw.choice(free)
            exits[node].append(now)
            return node
        time.sleep(0.5)


def parts(rig: Rig) -> list[Path]:
    """Return the files of the recording in the order of their beginning."""
    return sorted(rig.out.glob("session*.mcap"), key=lambda path: int("0" + path.stem.partition("_")[2]))


def check_parts(rig: Rig, summary: dict[str, Any]) -> None:
    """Assert that figure and summary are made of every part, from the start of the programme on."""
    found = summary["recording"]["parts"] if len(parts(rig)) > 1 else []
    assert [part["file"] for part in found] == [path.name for path in parts(rig) if len(parts(rig)) > 1]
    assert not [text for text in summary["recording"]["missing"] if "after the operator's force profile" in text]
    for part in found[1:]:
        assert 0.0 < part["begins_s"] < summary["duration_s"], part


def check_gaps(paths: Iterable[Path]) -> int:
    """Assert that what gap records and numbers call missing is nowhere in the files; return how many it is."""
    missing = 0
    for path in paths:
        recording = Recording(path)
        runs: dict[tuple[str, str], list[set[int]]] = {}
        newest: dict[RecordedChannel, int] = {}
        records: list[GapRecord] = []
        for message in recording.select():
            if message.topic == GAP_TOPIC:
                decoded = message.decode()
                assert isinstance(decoded, GapRecord)
                records.append(decoded)
            elif message.channel.via == "direct":
                of_source = runs.setdefault((message.channel_topic, message.src), [set()])
                if message.seq <= newest.get(message.channel, -1):
                    of_source.append(set())
                of_source[-1].add(message.seq)
                newest[message.channel] = message.seq
        for gap in records:
            for run in runs.get((gap.channel_topic, gap.src), []):
                # of the process that sent on from there
                if gap.first_missing - 1 in run and gap.last_missing + 1 in run:
                    there = run & set(range(gap.first_missing, gap.last_missing + 1))
                    assert not there, f"{path.name}: {gap} although {sorted(there)[:5]} are there"
                    missing += gap.count
        recorded = sum(gap.count for gap in records)
        lost = sum(channel.lost for channel in recording.info().channels if channel.via == "direct")
        assert lost <= recorded, f"{path.name}: {lost} are missing by their numbers, {recorded} are recorded as missing"
    return missing


def untouched(hold: dict[str, Any], start_ns: int, disturbances: Sequence[Disturbance]) -> bool:
    """Return whether nothing was disturbed in a hold of a summary, or shortly before it."""
    begin_ns, end_ns = (start_ns + round(hold[name] * 1e9) for name in ("start_s", "end_s"))
    margin_ns = round(MARGIN_S * 1e9)
    return all(one.end_ns + margin_ns < begin_ns or one.begin_ns - margin_ns > end_ns for one in disturbances)


def verdicts_of(
    summary: dict[str, Any], start_ns: int, disturbances: Sequence[Disturbance]
) -> tuple[dict[str, int], dict[str, int]]:
    """Return how often each verdict was given on a hold that nothing disturbed, and on one that something did."""
    quiet: dict[str, int] = {}
    hit: dict[str, int] = {}
    for hold in summary["holds"]:
        counts = quiet if untouched(hold, start_ns, disturbances) else hit
        counts[hold["verdict"]] = counts.get(hold["verdict"], 0) + 1
    return quiet, hit


def start_of(paths: Sequence[Path]) -> int:
    """Return when the programme began, from the first sample of it [ns]."""
    for message in Recording(paths[0]).messages(["haptic/state"]):
        session_s = float(message.fields()["session_s"])
        if session_s >= 0.0:
            return message.publish_ns - round(session_s * 1e9)
    raise AssertionError("the programme never ran in the first part")
