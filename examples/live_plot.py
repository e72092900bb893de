"""Plot a running rig while it runs, and keep the last picture.

Run it: telenano up examples/pressing.yaml --headless --out out/pressing, and in a second terminal
        python examples/live_plot.py [FOLDER [SECONDS]]     takes: 10 s     needs: pip install 'telenano[viz]'
You see: the last ten seconds of the hand and the tip in a window; without a display only the last picture. The tip
presses with 1/1.05 of the hand's force. A node publishes hundreds of messages a second: read them often, draw seldom.
"""

import sys
import time
from collections import deque
from pathlib import Path

import matplotlib.pyplot as plt

import telenano
from telenano.wire import AfmState, HapticState

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 10.0
DRAWN_EVERY_S = 0.25
SHOWN_S = 10.0
FORCE_SCALE = 1e8  # from the tip to the hand, that of the paper; z points away from the sample
CHANNELS = {"haptic/state": "hand, $F_m$", "afm/state": r"tip, scaled, $\alpha_f F_s$"}

figure, axes = plt.subplots(figsize=(7.0, 3.6))
styles = zip(CHANNELS, ("--", "-"), strict=True)
lines = {channel: axes.plot([], [], style, label=CHANNELS[channel])[0] for channel, style in styles}
axes.set(title="A running rig", xlabel="time since the first message (s)", ylabel="force (N)", ylim=(-0.2, 1.4))
figure.subplots_adjust(bottom=0.15)  # a constrained layout would be made again for each frame
axes.legend(loc="upper left", ncols=2)
points: dict[str, deque[tuple[float, float]]] = {channel: deque() for channel in CHANNELS}
counts = dict.fromkeys(CHANNELS, 0)
start_ns = 0

with telenano.live() as rig:
    end_s = time.monotonic() + SECONDS
    while time.monotonic() < end_s:
        for channel, message in rig.messages(duration_s=DRAWN_EVERY_S):
            if isinstance(message, AfmState):
                force_n = FORCE_SCALE * message.tip_force_n[2]
            elif isinstance(message, HapticState):
                force_n = -message.operator_force_n[2]
            else:
                continue
            start_ns = start_ns or message.t_ns
            points[channel].append((1e-9 * (message.t_ns - start_ns), force_n))
            counts[channel] += 1
        newest_s = max((series[-1][0] for series in points.values() if series), default=0.0)
        for channel, series in points.items():
            while series and series[0][0] < newest_s - SHOWN_S:
                series.popleft()
            lines[channel].set_data([at_s for at_s, _ in series], [force_n for _, force_n in series])
        axes.set_xlim(newest_s - SHOWN_S, newest_s)
        plt.pause(0.01)

OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "live_plot.png", dpi=80)
for channel, series in points.items():
    print(f"{channel} messages {counts[channel]} greatest_n {max(force_n for _, force_n in series):.3f}")
