"""Two sites between which one way, or one transport of it, is blocked: how long tip and hand go on without an answer.

    python tests/stack/blocked_ways.py cable            # a cable between the sites
    python tests/stack/blocked_ways.py direct           # a relay, and datagrams that go past it
    python tests/stack/blocked_ways.py relayed          # a relay, and datagrams that go through it

runs one session of two sites, injects each fault in it, and prints what became of hand and tip as lines of JSON. What
is blocked is dropped where it arrives, so that its sender learns nothing. `--faults all_back,tcp_back` chooses some.
"""

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from relayed_sites import RelayedSites
from two_sites import Site, TwoSites

NS_PER_S = 1_000_000_000
# What is dropped of what arrives at a site: there, at the slave's; back, at the master's.
_DROPPED = """
table inet block {{
  chain in {{ type filter hook input priority 0; iifname "{device}" {what}drop; }}
}}
"""
_PROTOCOLS = {"all": "", "tcp": "meta l4proto tcp ", "udp": "meta l4proto udp "}
_ARRIVES_AT = {"there": ("slave",), "back": ("master",), "both": ("slave", "master")}
BLOCKED = tuple(f"{what}_{way}" for what in _PROTOCOLS for way in _ARRIVES_AT)
RELAY_KILLED = "relay_killed"
WAYS = ("cable", "direct", "relayed")
# The faults that a topology can have.
FAULTS_OF = {way: BLOCKED if way == "cable" else (*BLOCKED, RELAY_KILLED) for way in WAYS}
ENDS = {"master": "delay_node@master", "slave": "controller@slave"}
# How long a fault lasts [s]. Where datagrams cross, the loop goes on until the ends miss the connection over TCP, for
# five seconds over a network that has lost datagrams.
_FAULT_S, _CONNECTION_S = 2.5, 6.5
_PUSH = "haptic_node.operator.points=[{time_s: 0.2, force_n: 0.0}, {time_s: 0.6, force_n: 1.0}]"


class Outcome(NamedTuple):
    """What became of hand and tip in a fault [s].

    tip_s, hand_s: from its beginning to the first tip that does not follow, and the first hand that is off, None where
    there is none; tip_unanswered_s, hand_unanswered_s: the longest time since the last answer that reached the hand for
    which the tip followed, and the hand was driven; late_s: the longest time between two states of hand or tip, because
    a busy machine lets each of them decide later.
    """

    tip_s: float | None
    hand_s: float | None
    tip_unanswered_s: float
    hand_unanswered_s: float
    late_s: float


def sites_of(way: str, folder: Path) -> TwoSites:
    """Return both sites with the network between them."""
    return TwoSites(folder) if way == "cable" else RelayedSites(folder, strict=way == "relayed")


def both_log(rig: TwoSites, text: str, times: int = 1) -> bool:
    """Return whether both ends have said a text so many times."""
    return all(site.has_log(ENDS[site.name], text, times) for site in (rig.master, rig.slave))


def started(rig: TwoSites, way: str) -> None:
    """Start a session that presses, and wait for the datagrams to take their way."""
    for site in (rig.master, rig.slave):
        site.lean = True
    if isinstance(rig, RelayedSites):
        rig.start_relay()
    rig.start("--duration", "3600", "--set", _PUSH)
    rig.wait_until(lambda: both_log(rig, "as datagrams"), "datagrams both ways")
    if way == "direct":
        rig.wait_until(lambda: both_log(rig, "go directly to"), "the direct way")


@contextmanager
def fault(rig: TwoSites, name: str) -> Iterator[None]:
    """Let a fault last while the block runs."""
    if name == RELAY_KILLED:
        assert isinstance(rig, RelayedSites)
        rig.stop_relay()
        try:
            yield
        finally:
            rig.start_relay()
        return
    what, _, way = name.partition("_")
    places = _ARRIVES_AT[way]
    for place in places:
        text = _DROPPED.format(device=rig.cable.ends[place], what=_PROTOCOLS[what])
        subprocess.run(rig.cable.inside(place, ["nft", "-f", "-"]), input=text, text=True, check=True)
    try:
        yield
    finally:
        for place in places:
            subprocess.run(rig.cable.inside(place, ["nft", "delete", "table", "inet", "block"]), check=True)


def _states(site: Site, topic: str, first_ns: int, last_ns: int) -> list[Any]:
    """Return the states that a device sent between two times, by the clock of their stamps."""
    found: list[Any] = [message.decode() for message in site.recording().messages(topic, first_ns)]
    return sorted((state for state in found if first_ns <= state.t_ns < last_ns), key=lambda state: state.t_ns)


def outcome(rig: TwoSites, begin_ns: int, end_ns: int) -> Outcome:
    """Return what became of hand and tip between two times [ns], by the recordings of both sites."""
    for site, topic in ((rig.master, "haptic/state"), (rig.slave, "afm/state")):
        rig.wait_until(
            lambda s=site, t=topic: bool(s.recording().messages(t, end_ns)),  # type: ignore[misc]
            f"the recording of {topic} up to the end of a fault",
        )
    hands = _states(rig.master, "haptic/state", begin_ns - NS_PER_S // 2, end_ns)
    tips = _states(rig.slave, "afm/state", begin_ns, end_ns)
    # The samples of the hand whose newest answer is newer than that of the sample before.
    answers = [now.t_ns for before, now in itertools.pairwise(hands) if now.answered_t_ns > before.answered_t_ns]
    driven = [hand.t_ns for hand in hands if hand.mode != "off"]
    following = [tip.t_ns for tip in tips if tip.mode == "follow"]
    return Outcome(
        _first_s(begin_ns, [tip.t_ns for tip in tips if tip.mode != "follow"]),
        _first_s(begin_ns, [hand.t_ns for hand in hands if hand.mode == "off" and hand.t_ns > begin_ns]),
        _longest_s(following, answers),
        _longest_s([at_ns for at_ns in driven if at_ns > begin_ns], answers),
        max(now.t_ns - before.t_ns for states in (hands, tips) for before, now in itertools.pairwise(states))
        / NS_PER_S,
    )


def _first_s(begin_ns: int, times_ns: list[int]) -> float | None:
    return (times_ns[0] - begin_ns) / NS_PER_S if times_ns else None


def _longest_s(times_ns: list[int], answers_ns: list[int]) -> float:
    """Return the longest time from an answer to one of these times that comes before the next answer [s]."""
    longest_ns, place = 0, 0
    for at_ns in times_ns:
        while place + 1 < len(answers_ns) and answers_ns[place + 1] <= at_ns:
            place += 1
        longest_ns = max(longest_ns, at_ns - answers_ns[place])
    return longest_ns / NS_PER_S


def _mode_lately(rig: TwoSites) -> str:
    found = rig.slave.recording().messages("afm/state", time.time_ns() - NS_PER_S)
    return str(found[-1].fields()["mode"]) if found else ""


def coupled_again(rig: TwoSites) -> None:
    """Arm what was withdrawn, until hand and tip have been coupled for a second."""
    since_ns = time.time_ns()

    def coupled() -> bool:
        nonlocal since_ns
        if _mode_lately(rig) in ("retracting", "retracted"):
            rig.rearm()
            since_ns = time.time_ns()
        tips = rig.slave.recording().messages("afm/state", since_ns)
        modes = {message.fields()["mode"] for message in tips if message.publish_ns > time.time_ns() - NS_PER_S}
        return modes == {"follow"} and time.time_ns() - since_ns > 2 * NS_PER_S

    rig.wait_until(coupled, "hand and tip that are coupled")


def injected(rig: TwoSites, name: str) -> Outcome:
    """Inject a fault into a coupled rig, and return what became of hand and tip meanwhile."""
    coupled_again(rig)
    begin_ns = time.time_ns()
    with fault(rig, name):
        time.sleep(_CONNECTION_S if name.startswith("tcp") or name == RELAY_KILLED else _FAULT_S)
        end_ns = time.time_ns()
    return outcome(rig, begin_ns, end_ns)


def main() -> None:
    """Run one session and print what became of hand and tip in each fault."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("way", choices=WAYS)
    parser.add_argument("--faults", default="")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rig = sites_of(given.way, Path(folder))
        try:
            started(rig, given.way)
            for name in given.faults.split(",") if given.faults else FAULTS_OF[given.way]:
                found = injected(rig, name)
                rounded = {key: value if value is None else round(value, 3) for key, value in found._asdict().items()}
                sys.stdout.write(json.dumps({"way": given.way, "fault": name, **rounded}) + "\n")
                sys.stdout.flush()
        finally:
            rig.close()


if __name__ == "__main__":
    main()
