"""Two sites behind a cable that flips, cuts, delays and drops, by a seed, for as long as one likes; what came of it.

    python tests/stack/damaged_nights.py --minutes 5 --seed 1 --out nights

A person arms the tip again whenever it is withdrawn and both sites hear each other. It prints a line of JSON: what the
cable did, for how long each node was away at the most and how much of that the machine itself let it stand still, how
often it was started again, whether both launchers live, and for how long the tip followed though no sample of the hand
had come within its deadline.
"""

import argparse
import contextlib
import itertools
import json
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from stack_rig import CONSTANT_PUSH
from two_sites import Site, TwoSites
from wide_area_cable import WideAreaCable

NS_PER_S = 1_000_000_000
NODES = {
    "master": ("haptic_node", "controller", "delay_node", "recorder"),
    "slave": ("afm_node", "controller", "recorder"),
}
# Without commands a tip is held after 50 ms, and a turn of its node and a message later it says so.
HELD_NS = 80_000_000


def drawn(draw: random.Random) -> dict[str, float]:
    """Return what the cable does for the next seconds."""
    return {
        "flip_tcp": draw.choice([0.0, 0.01, 0.03, 0.3]),
        "loss": draw.choice([0.0, 0.0, 0.02, 0.1]),
        "delay_s": draw.choice([0.002, 0.01, 0.04]),
        "tamper": draw.choice([0.0, 0.0, 0.1]),
    }


def longest_pause_s(times_ns: Sequence[int]) -> float:
    """Return the longest distance of two times, one after the other [s]."""
    return max((after - before for before, after in itertools.pairwise(sorted(times_ns))), default=0) / NS_PER_S


def times_ns(site: Site, channel: str) -> list[int]:
    """Return when the messages of a channel were sent [ns]."""
    return [message.publish_ns for message in site.recording().messages(channel)]


def away_s(rig: TwoSites) -> dict[str, float]:
    """Return for how long no report of health came of each node at the most, by the recording of its own site [s]."""
    found = {}
    for site in (rig.master, rig.slave):
        for name in NODES[site.name]:
            node = f"{name}@{site.name}"
            reports = [one.publish_ns for one in site.recording().messages("node/health") if one.src == node]
            found[node] = round(longest_pause_s(reports), 2)
    return found


def stalled_s(folder: Path) -> dict[str, float]:
    """Return for how long the machine let each node stand still at the most, by its log [s]."""
    return {
        path.stem: max((int(found) for found in re.findall(r"this process stalled for (\d+) ms", text)), default=0)
        / 1e3
        for path in sorted(folder.rglob("logs/*.log"))
        if (text := path.read_text())
    }


def follows_alone_s(site: Site) -> float:
    """Return for how long the tip followed though no command of the controller was within its deadline [s].

    The recording grows meanwhile: the states are read first, so that all commands before them are there.
    """
    states = [(one.publish_ns, str(one.fields()["mode"])) for one in site.recording().messages("afm/state")]
    commands = sorted(times_ns(site, "afm/command"))
    total_ns, place = 0, 0
    for (at_ns, mode), (after_ns, _) in itertools.pairwise(states):
        while place + 1 < len(commands) and commands[place + 1] <= at_ns:
            place += 1
        if mode == "follow" and commands and at_ns - commands[place] > HELD_NS:
            total_ns += after_ns - at_ns
    return total_ns / NS_PER_S


def night(folder: Path, minutes: float, seed: int) -> dict[str, Any]:
    """Run both sites behind the cable; return what came of it."""
    draw = random.Random(seed)
    cable = WideAreaCable(0.002, 0.0, seed)
    with closing(TwoSites(folder, cable=cable)) as rig:
        rig.start("--duration", "36000", "--set", CONSTANT_PUSH)
        end_s, done, counts = time.monotonic() + 60.0 * minutes, Counter[str](), {}
        while time.monotonic() < end_s:
            cable.change(**drawn(draw))
            time.sleep(draw.uniform(2.0, 8.0))
            if draw.random() < 0.5:
                cable.change(cut=True)
                time.sleep(draw.choice([0.2, 0.7, 2.0]))
                cable.change(cut=False)
                done["cuts"] += 1
            if draw.random() < 0.3:
                counts = cable.change(flip_tcp=0.0, loss=0.0, delay_s=0.002, tamper=0.0)
                time.sleep(1.0)
                rig.rearm()
                done["arms"] += 1
        counts = cable.change(flip_tcp=0.0, loss=0.0, delay_s=0.002, tamper=0.0)
        time.sleep(2.0)
        logs = [path.read_text() for path in folder.rglob("logs/launcher@*.log")]
        launchers = [site.process for site in (rig.master, rig.slave)]
        return {
            "minutes": minutes, "seed": seed, **done,
            "flipped": sum(ways.get("flipped", 0) for ways in counts["attacks"]),
            "aborted": sum(text.count("killed by SIGABRT") for text in logs),
            "restarted": sum(text.count("restarted") for text in logs),
            "away_s": away_s(rig),
            "stalled_s": stalled_s(folder),
            "launchers_live": all(launcher is not None and launcher.poll() is None for launcher in launchers),
            "followed_without_command_s": round(follows_alone_s(rig.slave), 3),
            "modes": Counter(str(one.fields()["mode"]) for one in rig.slave.recording().messages("afm/state")),
        }  # fmt: skip


def main() -> int:
    """Print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder in which logs and recordings stay; otherwise they are removed")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        folder = options.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tn")))
        folder.mkdir(parents=True, exist_ok=True)
        sys.stdout.write(json.dumps(night(folder, options.minutes, options.seed)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
