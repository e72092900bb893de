"""What a message costs the engine of the link, network by network, as a ratio to the engine of another checkout.

    python benchmarks/link_engine.py [--before FOLDER] [--rounds N] [--smoke] [--json] [NETWORK ...]

Each network carries the same messages, 2000 a second on three topics for ten seconds, through this engine and, in turn
and in a process of its own, through that of FOLDER, a checkout of an earlier version. A network that FOLDER lacks is
compared with `lte` there: jitter in order, a rate and losses in bursts. A figure is the mean over the rounds of the
ratio of one round, in which both ran one after the other, with the interval in which those of all networks are with
95 % (`versions.py`), from ten rounds on.
"""

import argparse
import json
import statistics
import sys
from pathlib import Path

from versions import compared, shown

from telenano.signals import children

HERE = Path(__file__).resolve().parents[1]
NETWORKS = ("clean", "wifi", "lte", "cicv5g_n78_arterial", "starlink_driving", "verizon_driving")
REFERENCE = "lte"
CARRY = """
import sys, time
from telenano.settings.link_settings import LinkSettings
from telenano.link.direction import DirectionEngine
from telenano.settings.network_profiles import PROFILES
name = sys.argv[1] if sys.argv[1] in PROFILES else sys.argv[2]
engine = DirectionEngine("forward", LinkSettings.of({"profile": name, "seed": 3}), 0)
topics, payload, best = ("teleop/forward", "law/status", "node/health"), bytes(300), 1e9
now = 0
for part in range(20):
    begin = time.process_time()
    for seq in range(1000):
        now += 500_000
        engine.submit(now, topics[seq % 3], payload, seq)
        engine.due(now)
    engine.take_fates()
    best = min(best, time.process_time() - begin)
print(best * 1e3)
"""


def cost_us(folder: Path, network: str) -> float:
    """Return the least processor time for a message [us], over parts of a thousand messages."""
    command = [sys.executable, "-c", CARRY, network, REFERENCE]
    own = {"PYTHONPATH": str(folder)}
    done = children.run(command, cwd=folder, capture_output=True, text=True, check=True, env=own)
    return float(done.stdout)


def main() -> None:
    """Print the cost of each network and its ratio; `--smoke` takes one round of two networks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", nargs="*", default=NETWORKS)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    if chosen.smoke:
        chosen.networks, chosen.rounds = ("clean", "starlink_driving"), 1
    measured: dict[str, list[tuple[float, float]]] = {}
    for network in chosen.networks:
        before = (HERE, REFERENCE) if chosen.before is None else (chosen.before.resolve(), network)
        pairs = []
        for number in range(chosen.rounds):
            order = ((HERE, network), before) if number % 2 else (before, (HERE, network))
            costs = [cost_us(*one) for one in order]
            pairs.append((costs[0], costs[1]) if number % 2 else (costs[1], costs[0]))
        measured[network] = pairs
    ratios = compared(measured)
    us = {network: statistics.median(mine for mine, _ in pairs) for network, pairs in measured.items()}
    if chosen.json:
        rows = {network: {"us": us[network], **shown(ratio)} for network, ratio in ratios.items()}
        print(json.dumps({"networks": rows}))
        return
    name = f"before, {REFERENCE} where it has none" if chosen.before else REFERENCE
    for network, ratio in ratios.items():
        print(f"{network}: {us[network]:.1f} us a message, {ratio.told()} of {name}")


if __name__ == "__main__":
    main()
