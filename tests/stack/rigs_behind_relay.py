"""How many rigs one relay and this machine carry: pairs of sites behind routers, until the first misses a deadline.

    python tests/stack/rigs_behind_relay.py [--most N] [--rate HZ] [--seconds S]

runs 1, 2, 3 … rigs at once over one relay, each in network namespaces of its own, all on this machine, and prints for
each number how often a device stood for want of a command. Routers that take another port for each address keep
everything at the relay. It needs root and the command `nft`.
"""

import argparse
import contextlib
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from relayed_sites import RelayedSites
from two_sites import why_not


class Carried(NamedTuple):
    """What became of rigs that ran at once: by rig how often a deadline was missed, and the age of its loop [ms].

    `refused` is why one of them was not started, in its own words; then the others were not measured.
    """

    missed: tuple[int, ...] = ()
    age_p99_ms: tuple[float, ...] = ()
    refused: str = ""


def carried(count: int, rate_hz: float, seconds: float) -> Carried:
    """Run `count` rigs over one relay, all of them for a time [s] at once."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as opened:
        rigs: list[RelayedSites] = []
        for number in range(count):
            place = Path(folder) / f"rig{number}"
            place.mkdir()
            rig = RelayedSites(place, strict=True, beside=rigs[-1] if rigs else None)
            opened.callback(rig.close)
            rigs.append(rig)
            for site in rig.sites:
                site.lean, site.rate = True, ("--set", f"realtime.rate_hz={rate_hz:g}")
        rigs[0].start_relay()
        for rig in rigs:
            rig.slave.start()
            rig.master.start("--duration", "600")
            master = rig.master.process
            assert master is not None
            rig.wait_until(lambda rig=rig, master=master: rig.running() or master.poll() is not None, "a session")
            if master.poll() is not None:
                return Carried(refused=rig.master.log.read_text().splitlines()[-1])
        for rig in rigs:
            rig.rearm()
        # what the start of the last rig took of the processors is no matter of the relay
        begin_ns = time.time_ns() + 2_000_000_000
        time.sleep(2.0 + seconds)
        end_ns = time.time_ns()
        missed, ages_ms = [], []
        for rig in rigs:
            modes = [
                message.fields()["mode"]
                for site, topic in ((rig.master, "haptic/state"), (rig.slave, "afm/state"))
                for message in site.recording().messages(topic, begin_ns)
                if message.publish_ns < end_ns
            ]
            missed.append(sum(mode in ("hold", "off", "retracted") for mode in modes))
        for rig in rigs:
            rig.master.stop()
            rig.slave.stop()
        for rig in rigs:
            summary = rig.master.summary()
            ages_ms.append(float((summary["loop_age_ms"] or {"p99": float("nan")})["p99"]))
        return Carried(tuple(missed), tuple(ages_ms))


def main() -> int:
    """Run more and more rigs and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--most", type=int, default=8)
    parser.add_argument("--rate", type=float, default=125.0)
    parser.add_argument("--seconds", type=float, default=8.0)
    given = parser.parse_args()
    if reason := why_not():
        sys.stderr.write(f"{reason}\n")
        return 1
    sys.stdout.write(
        "| rigs | states in which a device stood, by rig | age of the loop, 99 % [ms], by rig |\n|---|---|---|\n"
    )
    for count in range(1, given.most + 1):
        found = carried(count, given.rate, given.seconds)
        if found.refused:
            sys.stdout.write(f"{count} rigs: {found.refused}\n")
            break
        ages = ", ".join(f"{age_ms:.0f}" for age_ms in found.age_p99_ms)
        sys.stdout.write(f"| {count} | {', '.join(map(str, found.missed))} | {ages} |\n")
        sys.stdout.flush()
        if any(found.missed):
            break
    return 0


if __name__ == "__main__":
    sys.exit(main())
