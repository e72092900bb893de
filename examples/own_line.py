"""Fit a network of your own to a log of ping, and see which law holds the contact over it.

Run it: ping -D -i 0.2 -c 1500 HOST > ping.txt
        python examples/own_line.py [FOLDER [ping.txt]]     takes: 40 s     needs: telenano[viz] and telenano-lab
You see: the log, and the force at the tip with each law that is installed. Without a name the example makes a log of
75 ms. Over that line two laws keep swinging. The others come to rest, but tdpa at a force that is not the hand's.
"""

import json
import random
import subprocess
import sys
from pathlib import Path

from matplotlib.figure import Figure

import telenano
from telenano.sections import LAWS

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
OUT.mkdir(parents=True, exist_ok=True)
log = Path(sys.argv[2]) if len(sys.argv) > 2 else OUT / "ping.txt"
if len(sys.argv) < 3:  # a line of 70 ms whose delay wanders over two seconds, with one packet in a hundred lost
    draw, wander_ms, rows = random.Random(1), 0.0, ["PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data."]
    for number in range(1, 1501):
        wander_ms = 0.9 * wander_ms + draw.gauss(0.0, 3.0)
        trip_ms = 70.0 + abs(wander_ms) + draw.expovariate(1.0)
        stamp = f"[{1.7e9 + 0.2 * number + 1e-3 * trip_ms:.6f}]"
        if draw.random() > 0.01:
            rows.append(f"{stamp} 64 bytes from 192.0.2.1: icmp_seq={number} ttl=57 time={trip_ms:.1f} ms")
    log.write_text("\n".join([*rows, f"1500 packets transmitted, {len(rows) - 1} received, time 299800ms", ""]))
fit = [sys.executable, "-m", "telenano", "link", "fit", str(log), "--out", str(OUT / "own_line"), "--json"]
ended = subprocess.run(fit, stdout=subprocess.PIPE, text=True)
if ended.returncode:
    sys.exit(f"{log}: no settings were made of it (exit code {ended.returncode}); see {OUT / 'own_line' / 'fit.html'}")
line = json.loads(ended.stdout)
for what in ("usual delay, q50 [ms]", "usual delay, q99 [ms]", "lost"):
    print(f"{what} {line['parameters'][what]['value']:.4g}")

figure = Figure(figsize=(8.4, 7.0), layout="constrained")
grid = figure.add_gridspec(1 - (-len(LAWS) // 4), 4)
axes = figure.add_subplot(grid[0, :])
trips_ms = [float(row.partition("time=")[2].split()[0]) for row in log.read_text().splitlines() if "time=" in row]
axes.plot(trips_ms, ".", ms=1.5)
axes.set(title=f"{log.name}: the round trip of each answer", xlabel="answer", ylabel="round trip (ms)")
for number, law in enumerate(LAWS):
    session = telenano.simulate("fig12", law=law, settings={"delay_node": line["ways"]})
    facts = sorted({fact.kind for hold in session.holds for fact in hold.facts} - {"arrived_late"})
    verdict = ", ".join([session.verdict, *facts])
    print(f"law {law} verdict {verdict}: {session.reason}, {session['scaled_tip_force_n'].max():.2f} N at most")
    axes = figure.add_subplot(grid[1 + number // 4, number % 4])
    axes.plot(session["time_s"], session["scaled_tip_force_n"], lw=0.8)
    axes.plot(session["time_s"], session["operator_force_n"], "k--", lw=0.6)
    axes.set(xlim=(0.0, 8.0), ylim=(-2.0, 8.0), yticks=(0, 2, 4, 6))
    axes.set_title(f"{law}: {session.verdict.replace('_', ' ')}{', off force' * ('off_force' in facts)}", fontsize=8)
figure.supxlabel("time (s)", fontsize=9)
figure.supylabel("force at the hand's scale (N), hand dashed", fontsize=9)
figure.savefig(OUT / "own_line.png", dpi=70)
