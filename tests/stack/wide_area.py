"""A rig on two machines with a bad network between them: the cable of tun_cable.py in the place of the ordinary one.

    python tests/stack/wide_area.py --delay-ms 50 --loss 0.02 [--law passivity] [--transport auto] [--injected]

runs `fig12` once at both sites and prints what became of it as a line of JSON.
"""

import argparse
import contextlib
import json
import secrets
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from tun_cable import DEVICE
from two_sites import MASTER, SLAVE, Cable, TwoSites

from recording.reader import Recording

# both recorders would have the topics of the loop cross the network a second time, over TCP
EXCLUDED = {"master": ["law/*", "link/fates", "teleop/*", "afm/command"], "slave": ["law/*", "teleop/*"]}
TUN_CABLE = Path(__file__).with_name("tun_cable.py")


class WideAreaCable(Cable):
    """Two namespaces, and between them a process that delays and drops each packet by itself."""

    def __init__(self, delay_s: float, loss: float, seed: int = 1) -> None:
        token = secrets.token_hex(3)
        self.names = {"master": f"tnm{token}", "slave": f"tns{token}"}
        self.ends = dict.fromkeys(self.names, DEVICE)
        for name in self.names.values():
            subprocess.run(["ip", "netns", "add", name], check=True)
        addresses = [self.names["master"], f"{MASTER}/24", self.names["slave"], f"{SLAVE}/24"]
        options = ["--delay-s", str(delay_s), "--loss", str(loss), "--seed", str(seed)]
        command = [sys.executable, str(TUN_CABLE), *addresses, *options]
        self._wire = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._wire.stdout is not None
        assert self._wire.stdout.readline() == "ready\n"

    def change(self, **rules: float | bool) -> dict[str, Any]:
        """Change what holds for each packet from now on, and give the counts up to now."""
        assert self._wire.stdin is not None
        assert self._wire.stdout is not None
        self._wire.stdin.write(json.dumps(rules) + "\n")
        self._wire.stdin.flush()
        found: dict[str, Any] = json.loads(self._wire.stdout.readline())
        return found

    def close(self) -> None:
        self._wire.kill()
        self._wire.wait()
        for pipe in (self._wire.stdin, self._wire.stdout):
            if pipe is not None:
                pipe.close()
        super().close()


def events_of_session(recording: Path) -> list[dict[str, Any]]:
    """Give the events of the slave's recording until the master's site was ended, which cuts its connections."""
    found = [message.fields() for message in Recording(recording).messages() if message.topic == "session/event"]
    ended = min((event["t_ns"] for event in found if event["data"].get("connection") == "down"), default=2**63)
    # its nodes stop one after the other in the half second before
    return [event for event in found if event["t_ns"] < ended - 500_000_000]


def one_way_ms(folder: Path) -> dict[str, float]:
    """Give what the end at a site measured of the direction that it receives."""
    (recording,) = sorted(folder.glob("session*.mcap"))
    # at the master the copy of what the slave's end reports is named for the site
    own: list[Any] = [
        message.decode() for message in Recording(recording).messages() if message.channel_topic == "link/network"
    ]
    if not own:
        return {}
    delays = np.concatenate([report.delay_ns.to_numpy()[report.lost_flag.to_numpy() == 0] for report in own]) * 1e-6
    p50, p99 = np.percentile(delays, (50, 99))
    last = own[-1]
    return {
        "p50": round(float(p50), 2),
        "p99": round(float(p99), 2),
        "max": round(float(delays.max()), 2),
        "sent": last.sent,
        "lost": last.lost,
        "late": last.late,
        "repeats": max(report.repeats for report in own),
        "uncertainty": round(last.clock.uncertainty_s * 1e3, 2),
    }


def fig12(
    folder: Path, delay_ms: float, loss: float, law: str, transport: str = "auto", *, injected: bool = False
) -> dict[str, Any]:
    """Run fig12 at both sites and give what became of it.

    Parameters: injected, the network is perfect and the link injects delay and loss in its place.
    """
    cable = WideAreaCable(0.0 if injected else delay_ms * 1e-3, 0.0 if injected else loss)
    rig = TwoSites(folder, cable=cable, transport=transport)
    law_of = ["--set", f"controller.law={law}"]
    chosen = {site: [*law_of, "--set", f"recorder.exclude={json.dumps(EXCLUDED[site])}"] for site in EXCLUDED}
    network = [
        f"{way}.{key}"
        for way in ("forward", "backward")
        for key in (f"delay_s={delay_ms * 1e-3}", f"loss.probability={loss}")
    ]
    try:
        rig.slave.start(*chosen["slave"])
        rig.master.start(
            *chosen["master"],
            *([word for key in network for word in ("--set", f"delay_node.{key}")] if injected else []),
        )
        rig.wait_until(rig.running, "a running session", 60.0)
        assert rig.master.process is not None
        rig.master.process.wait(timeout=60.0)
        rig.slave.stop()
        summary = rig.master.summary()
        (recording,) = sorted(rig.slave.out.glob("session*.mcap"))
        events = events_of_session(recording)
        deadlines = [event for event in events if "command_deadline" in str(event["data"].get("reason", ""))]
        counts = cable.change()
        delays = {site.name: one_way_ms(site.out) for site in (rig.master, rig.slave)}
        return {
            "delay_ms": delay_ms,
            "loss": loss,
            "law": law,
            "network": "injected" if injected else transport,
            "hold_ratio": summary["hold_ratio"],
            "verdict": summary["verdict"],
            "reason": summary["reason"],
            "loop_age_ms": summary["loop_age_ms"],
            "one_way_ms_at": delays,
            "deadlines_missed": len(deadlines),
            "sent_bytes": counts["bytes_taken"],
            "events": [event["text"] for event in events if event["kind"] == "network" and event["level"] != "info"],
        }
    finally:
        rig.close()


def main() -> None:
    """Run once and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--delay-ms", type=float, default=50.0)
    parser.add_argument("--loss", type=float, default=0.02)
    parser.add_argument("--law", default="passivity")
    parser.add_argument("--transport", default="auto")
    parser.add_argument("--injected", action="store_true")
    parser.add_argument("--out", type=Path, help="folder to keep what both sites wrote in; must not exist")
    given = parser.parse_args()
    if given.out is not None:
        given.out.mkdir(parents=True)
    with tempfile.TemporaryDirectory() if given.out is None else contextlib.nullcontext(given.out) as folder:
        found = fig12(Path(folder), given.delay_ms, given.loss, given.law, given.transport, injected=given.injected)
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
