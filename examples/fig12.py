"""Reproduce Fig. 12 of Sitti and Hashimoto (1998): a hand presses a tip onto mica with 1 N, then 2 N, and lets go.

Run it: python examples/fig12.py [FOLDER]     takes: 3 s     needs: pip install 'telenano[viz]'
You see: the force of the hand and the force at the tip, which is a hundred million times smaller, the position of the
hand, and the force against the distance, with the jump of 5 nN where the water meniscus forms at 2.4 nm.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")

session = telenano.simulate("fig12")
time_s = session["time_s"]
ran = time_s >= 0.0
hold = (time_s > 2.2) & (time_s < 2.5)
ratio = np.mean(session["operator_force_n"][hold] / session["scaled_tip_force_n"][hold])
rest_cm = 100.0 * session["hand_position_m"][-1]
print(f"verdict {session.verdict}")
print(f"hand_per_tip_force {ratio:.4f} (the law's own steady state is 1 + 1/K_f = 1.05)")
print(f"rest_cm {rest_cm:.4f}")

figure = Figure(figsize=(7.0, 6.4), layout="constrained")
figure.suptitle(session.conditions.title(), fontsize=10)
forces, places, curve = figure.subplots(3, 1)
forces.plot(time_s[ran], session["operator_force_n"][ran], "--", label="hand, $F_m$")
forces.plot(time_s[ran], session["scaled_tip_force_n"][ran], lw=1.0, label=r"tip, scaled, $\alpha_f F_s$")
forces.set(xlabel="time (s)", ylabel="force (N)")
forces.legend(loc="upper right")
places.plot(time_s[ran], 100.0 * session["hand_position_m"][ran])
places.set(xlabel="time (s)", ylabel="hand, $x_m$ (cm)")
curve.plot(1e9 * session["separation_m"][ran], 1e9 * session["tip_force_n"][ran], lw=0.8)
curve.set(xlabel="distance of tip and sample, $h$ (nm)", ylabel="force at tip, $F_s$ (nN)", xlim=(None, 6.0))
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "fig12.png", dpi=80)
