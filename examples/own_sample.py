"""Feel a sample that you measured: a force curve becomes the contact, instead of the paper's mica.

Run it: python examples/own_sample.py [FOLDER [CURVE [N_PER_M]]]   takes: 5 s   needs: telenano[viz], telenano-lab
You see: the curve of the file, and on it what the hand felt: it goes in by the approach and out by the retraction,
which holds the tip with 5 nN. force_curve.txt is a table as an AFM exports it, of a soft sphere, computed with noise;
docs/instrument.md lists the formats of makers. N_PER_M is the stiffness of the cantilever that measured it.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
CURVE = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).with_name("force_curve.txt")
STIFFNESS_N_PER_M = float(sys.argv[3]) if len(sys.argv) > 3 else 2.0

OUT.mkdir(parents=True, exist_ok=True)
sample = OUT / "own_sample.npz"
words = ["sample", "import", str(CURVE), "--set", f"stiffness_n_per_m={STIFFNESS_N_PER_M}", "--out", str(sample)]
subprocess.run([sys.executable, "-m", "telenano", *words], check=True, stdout=subprocess.DEVNULL)
with np.load(sample) as grid:
    height_nm = 1e9 * grid["z"]
    approach_nn, retract_nn = 1e9 * np.moveaxis(grid["value"][0, 0], -1, 0)

# the base rests 10 nm above the height from which on the curve presses with more than its noise
touch_nm = height_nm[approach_nn > 0.02 * approach_nn.max()].max()
rest_m = 1e-9 * (touch_nm + 10.0)
points = [(0.5, 0.0), (1.0, 2.0), (4.5, 2.0), (5.5, -0.8), (8.0, -0.8)]
hand = {"kind": "force_profile", "points": [{"time_s": at_s, "force_n": force_n} for at_s, force_n in points]}
# At the usual scale the hand would come to the end of its travel before a soft sample pushes with 2 N.
settings = {
    "afm_node.sample.map": str(sample),
    "afm_node.rest_distance_m": rest_m,
    "controller.virtual_impedance.position_scale": 3e-6,
}
session = telenano.simulate("fig12", operator=hand, settings=settings)
time_s, ran = session["time_s"], session["time_s"] >= 0.0
hold = (time_s > 4.0) & (time_s < 4.5)
force_nn = 1e9 * session["tip_force_n"]
print(f"verdict {session.verdict}: {session.reason}")
print(f"held_nn {force_nn[hold].mean():.3f}")
print(f"least_nn {force_nn[ran].min():.3f}")

figure = Figure(figsize=(8.0, 3.6), layout="constrained")
curve, course = figure.subplots(1, 2)
curve.plot(height_nm, approach_nn, color="0.6", lw=2.5, label=f"{CURVE.name}, approach")
curve.plot(height_nm, retract_nn, color="0.8", lw=2.5, label="retraction")
curve.plot(1e9 * (rest_m - session["base_position_m"][ran]), force_nn[ran], lw=1.0, label="felt")
curve.set(xlabel="height of the base (nm)", ylabel="force at the tip (nN)")
curve.legend()
course.plot(time_s, session["operator_force_n"], "k--", lw=0.8, label="hand")
course.plot(time_s, session["scaled_tip_force_n"], lw=1.0, label="tip, at the hand's scale")
course.set(title=session.verdict, xlabel="time (s)", ylabel="force (N)", xlim=(0.0, 8.0))
course.legend()
figure.savefig(OUT / "own_sample.png", dpi=80)
