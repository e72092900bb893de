"""A rig on two machines with a bad network between them: the cable of tun_cable.py in the place of the ordinary one.

    python tests/stack/wide_area_cable.py --delay-ms 50 --loss 0.02 [--law passivity] [--transport auto] [--injected]

runs `fig12` once at both sites and prints what became of it as a line of JSON.

    python tests/stack/wide_area_cable.py --delay-ms 20 --loss 0 --rate-mbit 1 [--queue-bytes 64000]
    python tests/stack/wide_area_cable.py --delay-ms 20 --loss 0.05 --burst 30
    python tests/stack/wide_area_cable.py --delay-ms 20 --loss 0.02 --jitter-ms 10 [--in-order]

do so over a line of a rate, with losses in bursts, and with jitter. With a rate each site records its own, and the
slave's recording is fetched over a line of any width after the session. `--first-hold 1.8` gives the first hold of the
programme 1.8 s in the place of 1.4, which `passivity` needs to come to rest in it over a wide line.

    python tests/stack/wide_area_cable.py --table cells.jsonl --laws all --delays-ms 10,50 --losses 0,0.02,0.05

runs each law over the cable, over a perfect cable with the same network injected, and in lockstep with as many draws
of it as `study validate` takes, and prints what became of each, side by side. Cells that are in the file are not run
again, so a table may be made in parts; `--cells N` ends after N sessions. A session in which the cable itself was late
is no measurement: it is named below the table, and run again the next time.
"""

import argparse
import contextlib
import itertools
import json
import secrets
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import telenano_lab.studies.option_values
import yaml
from telenano_lab.networks.network_trace import QUANTILES
from tun_cable import DEVICE
from two_sites import MASTER, SLAVE, Cable, TwoSites

from telenano.recording.reader import Recording
from telenano.settings.config import flatten

# both recorders would have the topics of the loop cross the network a second time, over TCP
EXCLUDED = {"master": ["law/*", "link/fates", "teleop/*", "afm/command"], "slave": ["law/*", "teleop/*"]}
# which node has the end of the link's datagrams at a site
ENDS = {"master": "delay_node@master", "slave": "controller@slave"}
TUN_CABLE = Path(__file__).with_name("tun_cable.py")
# the programme of fig12 lets go at 4.6 s
DURATION_S = 5.0
# Where the hand's force changes in it before its first hold, and after it [s, N]; and how long it takes after it.
BEFORE_HOLD, AFTER_HOLD = ((0.8, 0.0), (1.2, 1.0)), ((0.0, 1.0), (0.3, 2.0), (1.9, 2.0), (2.0, 0.0))
AFTER_HOLD_S = 2.3
# a cable that was later than this is no measurement of the link: of the packets that it handed over more than 1 ms
# late, and of the time for which it got no processor [ms]
LATE_SHARE, HELD_UP_MS = 0.01, 10.0


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


def lateness(counts: dict[str, Any], before: dict[str, Any], begin_ns: int, end_ns: int) -> dict[str, Any]:
    """Give how late the cable was itself between two times [ns], from its counts then and at the first."""
    held_up_ms = [ms for at_ns, ms in counts["held_up"] if begin_ns <= at_ns < end_ns]
    delivered = counts["delivered"] - before["delivered"]
    return {
        "delivered": delivered,
        "late": counts["late"] - before["late"],
        "held_up": len(held_up_ms),
        "held_up_ms": round(max(held_up_ms, default=0.0), 1),
        "cpu_percent": round(100.0 * (counts["cpu_s"] - before["cpu_s"]) * 1e9 / (end_ns - begin_ns), 1),
    }


def distorted(cable: dict[str, Any]) -> str:
    """Say how the cable itself was late in a session; empty when it was not."""
    late, delivered, held_up_ms = cable["late"], cable["delivered"], cable["held_up_ms"]
    if late <= LATE_SHARE * delivered and held_up_ms <= HELD_UP_MS:
        return ""
    return f"the cable handed over {late} of {delivered} packets late, and was held up by {held_up_ms} ms at most"


def events_of_session(recording: Path) -> list[dict[str, Any]]:
    """Give the events of the slave's recording until the master's site was ended, which cuts its connections."""
    found = [message.fields() for message in Recording(recording).messages() if message.topic == "session/event"]
    ended = min((event["t_ns"] for event in found if event["data"].get("connection") == "down"), default=2**63)
    # its nodes stop one after the other in the half second before
    return [event for event in found if event["t_ns"] < ended - 500_000_000]


def recording_of(folder: Path) -> Path:
    """Give what a site recorded of the session: a recorder that is fetched from begins a file with it."""
    return max(folder.glob("session*.mcap"), key=lambda path: path.stat().st_size)


def one_way_ms(folder: Path, begin_ns: int, end_ns: int) -> dict[str, float]:
    """Give what the end at a site measured of the direction that it receives, between two times."""
    recording = recording_of(folder)
    # the master's recorder has what the slave's end reports as well
    found = [message for message in Recording(recording).messages() if message.topic == "link/network"]
    own: list[tuple[int, Any]] = [(m.publish_ns, m.decode()) for m in found if m.src == ENDS[folder.name]]
    own = [(at_ns, report) for at_ns, report in own if begin_ns <= at_ns < end_ns]
    if len(own) < 2:
        return {}
    reports = [report for _, report in own]
    rows = [report.delay_ns.to_numpy()[report.lost_flag.to_numpy() == 0] for report in reports]
    delays = np.concatenate(rows) * 1e-6
    if not delays.size:
        # over a line that is full, reports that cross it come without the fate of each datagram
        delays = np.array([report.delay_mean_s * 1e3 for report in reports])
    p50, p99 = np.percentile(delays, (50, 99))
    (first_ns, first), (last_ns, last) = own[0], own[-1]
    return {
        "p50": round(float(p50), 2),
        "p99": round(float(p99), 2),
        "max": round(float(delays.max()), 2),
        "means_max": round(max(report.delay_mean_s for report in reports) * 1e3, 2),
        "per_s": round((last.sent - first.sent) * 1e9 / (last_ns - first_ns)),
        "sent": last.sent,
        "lost": last.lost,
        "late": last.late,
        "repeats": max(report.repeats for report in reports),
        "uncertainty": round(last.clock.uncertainty_s * 1e3, 2),
    }


def tip_of(recording: Path, begin_ns: int, end_ns: int) -> dict[str, Any]:
    """Give what became of the tip between two times, by the slave's recording.

    `stood_ms`: the longest time for which it followed no newer sample of the hand [ms]; `withdrawn`: whether it was.
    """
    stood_ms, newest, since_ns, modes = 0.0, 0, 0, set()
    for message in Recording(recording).messages(("afm/state",)):
        fields = message.fields()
        if not begin_ns <= message.publish_ns < end_ns:
            continue
        modes.add(fields["mode"])
        if fields["hand_t_ns"] > newest:
            if since_ns:
                stood_ms = max(stood_ms, (message.publish_ns - since_ns) * 1e-6)
            newest, since_ns = fields["hand_t_ns"], message.publish_ns
    return {
        "stood_ms": round(stood_ms, 1),
        "withdrawn": bool(modes & {"retracting", "retracted"}),
        "modes": sorted(modes),
    }


def injected_ms(folder: Path) -> dict[str, list[float]]:
    """Give by direction the quantiles of the delays that the link applied to the samples of the loop [ms]."""
    recording = recording_of(folder)
    found: dict[str, list[float]] = {}
    for message in Recording(recording).messages():
        if message.topic == "link/fates":
            report: Any = message.decode()
            fates = [fate for fate in report.fates if fate.topic == f"teleop/{report.direction}" and not fate.dropped]
            found.setdefault(report.direction, []).extend(fate.delay_ns * 1e-6 for fate in fates)
    return {way: [round(float(q), 3) for q in np.quantile(delays, QUANTILES)] for way, delays in found.items()}


def programme(first_hold_s: float) -> tuple[dict[str, Any], float]:
    """Give the hand of fig12 with another length of its first hold, and the duration of such a session [s]."""
    held_s = BEFORE_HOLD[-1][0] + first_hold_s
    corners = [*BEFORE_HOLD, *((held_s + time_s, force_n) for time_s, force_n in AFTER_HOLD)]
    points = [{"time_s": time_s, "force_n": force_n} for time_s, force_n in corners]
    return {"kind": "force_profile", "points": points}, held_s + AFTER_HOLD_S


def fig12(
    folder: Path,
    delay_ms: float,
    loss: float,
    law: str,
    transport: str = "auto",
    *,
    injected: bool = False,
    seed: int = 1,
    probe_into: Path | None = None,
    measured: Path | None = None,
    duration_s: float = DURATION_S,
    rules: Mapping[str, float | bool] | None = None,
    first_hold_s: float | None = None,
    rate_hz: float | None = None,
    changes: Sequence[tuple[float, Mapping[str, float | bool]]] = (),
) -> dict[str, Any]:
    """Run fig12 at both sites and give what became of it.

    Parameters: injected, the network is perfect and the link injects delay and loss in its place; seed, of the losses;
    probe_into, folder for what `telenano link probe` makes meanwhile; measured, such a folder, injected in their place;
    rules, further ones of the cable; first_hold_s, a length of the programme's first hold, None is its own; rate_hz,
    the rate of all nodes; changes, rules that hold from a time of the session on [s], in order.
    """
    injected = injected or measured is not None
    folder.mkdir(parents=True, exist_ok=True)
    cable = WideAreaCable(0.0 if injected else delay_ms * 1e-3, 0.0 if injected else loss, seed)
    rig = TwoSites(folder, cable=cable, transport=transport)
    # over a network that loses packets TCP would take a minute to fetch what the slave recorded
    rules = dict(rules or {})
    far = "fetch" if rules.get("rate_bit_per_s") else "stream"
    law_of = ["--set", f"controller.law={law}", "--set", f"recorder.far={far}"]
    if rate_hz is not None:
        law_of += ["--set", f"realtime.rate_hz={rate_hz:g}"]
    chosen = {site: [*law_of, "--set", f"recorder.exclude={json.dumps(EXCLUDED[site])}"] for site in EXCLUDED}
    if first_hold_s is not None:
        operator, programme_s = programme(first_hold_s)
        chosen["master"][:0] = ["--set", f"haptic_node.operator={json.dumps(operator)}"]
        duration_s = max(duration_s, programme_s)
    cable.change(**rules)
    network = {
        f"{way}.{key}": value
        for way in ("forward", "backward")
        for key, value in (("delay_s", delay_ms * 1e-3), ("loss.probability", loss))
    }
    if measured is not None:
        section = yaml.safe_load((measured / "delay_node.yaml").read_text())
        network = {
            key: measured.absolute() / value if key.endswith(".file") else value
            for key, value in flatten(section).items()
        }
        chosen["master"][-1] = f"recorder.exclude={json.dumps([t for t in EXCLUDED['master'] if t != 'link/fates'])}"
    if probe_into is not None:
        # its imports take longer than the programme where the rig has the processors
        assert rig.master.keys_command("show").returncode == 0
    rig.slave.rate = rig.master.rate = ()
    try:
        rig.slave.start(*chosen["slave"])
        rig.master.start(
            *chosen["master"],
            *("--duration", str(duration_s)),
            *("--set", f"delay_node.seed={seed}"),
            *([f"--set=delay_node.{key}={value}" for key, value in network.items()] if injected else []),
        )
        rig.wait_until(rig.running, "a running session", 60.0)
        before, begin_ns = cable.change(), time.time_ns()
        for at_s, change in changes:
            time.sleep(max(0.0, at_s - (time.time_ns() - begin_ns) * 1e-9))
            cable.change(**change)
        if probe_into is not None:
            done = rig.master.telenano("link", "probe", "--duration", "3", "--out", str(probe_into))
            assert done.returncode == 0, done.stderr
        assert rig.master.process is not None
        # What follows, such as the fetch of a recording, is no part of the measurement.
        rig.wait_until(lambda: "\nstopping\n" in rig.master.log.read_text(), "the end of the session", 60.0)
        counts, end_ns = cable.change(), time.time_ns()
        if far == "fetch":
            rig.wait_until(lambda: "fetching what" in rig.master.log.read_text(), "the nodes to have stopped", 60.0)
            cable.change(rate_bit_per_s=0.0)
        rig.master.process.wait(timeout=60.0)
        cable_late = lateness(counts, before, begin_ns, end_ns)
        rig.slave.stop()
        summary = rig.master.summary()
        # Where the slave's recording was fetched, that of both sites has the instrument.
        recording, both = recording_of(rig.slave.out), rig.master.out / "both.mcap"
        events = events_of_session(recording)
        deadlines = [event for event in events if "command_deadline" in str(event["data"].get("reason", ""))]
        delays = {site.name: one_way_ms(site.out, begin_ns, end_ns) for site in (rig.master, rig.slave)}
        return {
            "delay_ms": delay_ms,
            "loss": loss,
            "rules": rules,
            "law": law,
            "seed": seed,
            "network": "injected" if injected else transport,
            "hold_ratio": summary["hold_ratio"],
            "verdict": summary["verdict"],
            "reason": summary["reason"],
            "holds": [hold["verdict"] for hold in summary["holds"]],
            **{key: summary.get(key) for key in ("loop_age_ms", "loop_age_parts_ms", "loop_age_largest")},
            "one_way_ms_at": delays,
            "injected_ms": injected_ms(rig.master.out) if measured is not None else {},
            "deadlines_missed": len(deadlines),
            "lines": summary.get("lines", []),
            "tip": tip_of(both if both.exists() else recording, begin_ns, end_ns),
            "cable": cable_late,
            "distorted": distorted(cable_late),
            "sent_bytes": counts["bytes_taken"],
            "events": [event["text"] for event in events if event["kind"] == "network" and event["level"] != "info"],
        }
    finally:
        rig.close()


def draws(law: str, delay_ms: float, loss: float, first_hold_s: float | None = None) -> list[str]:
    """Give the verdicts of lockstep on the same programme over the same network, one for each draw of the losses."""
    from telenano_lab.studies.loops.validate import SEEDS

    from telenano.lockstep.simulation import simulate_scenario

    verdicts = []
    chosen: dict[str, Any] = {}
    duration_s = DURATION_S
    if loss:
        chosen |= {f"delay_node.{way}.loss.probability": loss for way in ("forward", "backward")}
    if first_hold_s is not None:
        chosen["haptic_node.operator"], duration_s = programme(first_hold_s)
    for seed in range(SEEDS if loss else 1):
        settings = {**chosen, "delay_node.seed": seed}
        run = simulate_scenario(
            "fig12", law=law, round_trip_ms=2.0 * delay_ms, duration_s=duration_s, settings=settings
        )
        verdicts.append(run.verdict)
    return verdicts


def table(path: Path, cells: list[tuple[str, float, float]], networks: list[str], most: int) -> None:
    """Run what is not yet in a file, at most so many sessions, and print all that is, side by side."""
    lines = path.read_text().splitlines() if path.exists() else []
    found = [json.loads(line) for line in lines]
    known = {(row["law"], row["delay_ms"], row["loss"], row["network"]) for row in found if not row.get("distorted")}
    for network in networks:
        for law, delay_ms, loss in cells:
            if (law, delay_ms, loss, network) in known or (network != "lockstep" and most <= 0):
                continue
            if network == "lockstep":
                cell = {"law": law, "delay_ms": delay_ms, "loss": loss, "network": network}
                row = {**cell, "verdicts": draws(law, delay_ms, loss)}
            else:
                most -= 1
                with tempfile.TemporaryDirectory() as folder:
                    row = fig12(Path(folder), delay_ms, loss, law, injected=network == "injected")
            found.append(row)
            with path.open("a") as out:
                out.write(json.dumps(row) + "\n")
    for line in table_lines(found):
        sys.stdout.write(line + "\n")


def table_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Give the rows of a table in Markdown: a law over a network, real, injected and in lockstep."""
    cells: dict[tuple[str, float, float], dict[str, list[dict[str, Any]]]] = {}
    for row in rows:
        ways = cells.setdefault((row["law"], row["delay_ms"], row["loss"]), {})
        ways.setdefault("real" if row["network"] == "auto" else row["network"], []).append(row)
    with_injected = any(row["network"] == "injected" for row in rows)
    heads = ["law", "each way, loss", "over the cable", *(["injected"] if with_injected else []), "lockstep, draws", ""]
    lines = [_row(heads), "|" + "---|" * len(heads)]
    for (law, delay_ms, loss), ways in sorted(cells.items()):
        real, injected = ([row for row in ways.get(way, []) if not row["distorted"]] for way in ("real", "injected"))
        if not real:
            continue
        drawn = Counter(verdict for row in ways.get("lockstep", []) for verdict in row["verdicts"])
        shown = [", ".join(map(_live, runs)) or "-" for runs in ((real, injected) if with_injected else (real,))]
        counted = ", ".join(f"{count} {verdict}" for verdict, count in drawn.most_common())
        among = {row["verdict"] for row in injected} | set(drawn)
        other = sum(row["verdict"] not in among for row in real)
        same = f"{other} of {len(real)} differs" if other else "same"
        lines.append(_row([law, f"{delay_ms:g} ms, {loss:.0%}", *shown, counted, same if among else ""]))
    left_out = [row for row in rows if row.get("distorted")]
    lines += [f"{len(left_out)} sessions left out because the cable was late itself:"] if left_out else []
    for row in left_out:
        name = f"{row['law']}, {row['delay_ms']:g} ms, {row['loss']:.0%}, {row['network']}"
        lines.append(f"{name}: {_live(row)}; {row['distorted']}")
    return lines


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _live(row: dict[str, Any]) -> str:
    ratio = "" if row["hold_ratio"] is None else f" {row['hold_ratio']:.3f}"
    missed = f", {row['deadlines_missed']} deadlines missed" if row["deadlines_missed"] else ""
    return f"{row['verdict']}{ratio}{missed}"


def main() -> None:
    """Run once and print, or make a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--delay-ms", type=float, default=50.0)
    parser.add_argument("--loss", type=float, default=0.02)
    parser.add_argument("--law", default="passivity")
    parser.add_argument("--rate-mbit", type=float, default=0.0, help="what the line carries each way [Mbit/s]")
    parser.add_argument("--queue-bytes", type=int, default=64_000)
    parser.add_argument("--jitter-ms", type=float, default=0.0)
    parser.add_argument("--in-order", action="store_true")
    parser.add_argument("--burst", type=float, default=1.0, help="mean run of losses in packets")
    parser.add_argument("--duration", type=float, default=DURATION_S)
    parser.add_argument("--first-hold", type=float, help="length of the programme's first hold [s]")
    parser.add_argument("--transport", default="auto")
    parser.add_argument("--injected", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder to keep what both sites wrote in; must not exist")
    parser.add_argument("--table", type=Path, help="file of the cells of a table, one JSON object a line")
    parser.add_argument("--laws", default="all")
    parser.add_argument("--delays-ms", type=numbers, default=[10.0, 50.0])
    parser.add_argument("--losses", type=numbers, default=[0.0, 0.02, 0.05])
    parser.add_argument("--networks", default="auto,injected,lockstep", help="which columns of the table to run now")
    parser.add_argument("--cells", type=int, default=1000, help="most sessions to run now")
    given = parser.parse_args()
    if given.table is not None:
        laws = telenano_lab.studies.option_values.laws(given.laws)
        cells = list(itertools.product(laws, given.delays_ms, given.losses))
        table(given.table, cells, given.networks.split(","), given.cells)
        return
    if given.out is not None:
        given.out.mkdir(parents=True)
    with tempfile.TemporaryDirectory() if given.out is None else contextlib.nullcontext(given.out) as folder:
        found = fig12(
            Path(folder),
            given.delay_ms,
            given.loss,
            given.law,
            given.transport,
            injected=given.injected,
            seed=given.seed,
            duration_s=given.duration,
            first_hold_s=given.first_hold,
            rules={
                "rate_bit_per_s": given.rate_mbit * 1e6,
                "queue_bytes": given.queue_bytes,
                "jitter_s": given.jitter_ms * 1e-3,
                "in_order": given.in_order,
                "burst": given.burst,
            },
        )
    sys.stdout.write(json.dumps(found) + "\n")


def numbers(text: str) -> list[float]:
    """Return numbers separated by commas."""
    return [float(word) for word in text.split(",")]


if __name__ == "__main__":
    main()
