"""Analyse a recording in your own way: the mean stiffness of a contact, and the greatest pull on the tip.

Run it: python examples/own_analysis.py [RECORDING [FOLDER]]     takes: 3 s     needs: pip install 'telenano[viz]'
You see: force against the position of the base. A contact is no spring: where the tip begins to touch, the points leave
the line, whose slope is the mean over all samples in contact. Without a name the recording of telenano is read.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import telenano
from telenano.settings import DEMO_RECORDING

RECORDING = Path(sys.argv[1]) if len(sys.argv) > 1 else DEMO_RECORDING
OUT = Path(sys.argv[2] if len(sys.argv) > 2 else "out/examples")

session = telenano.open(RECORDING)
assert (session.units["base_position_m"], session.units["tip_force_n"]) == ("m", "N")
touches = session["in_contact"]
# towards the sample, and repulsive, is positive here; session.table("afm/state") has what was sent, z away from it
base_nm, force_nn = 1e9 * session["base_position_m"], 1e9 * session["tip_force_n"]
slope, offset = np.polyfit(base_nm[touches], force_nn[touches], 1)
residual_nn = np.std(force_nn[touches] - slope * base_nm[touches] - offset)
print(f"samples_in_contact {np.count_nonzero(touches)}")
print(f"slope_n_per_m {slope:.3f}")
print(f"residual_nn {residual_nn:.3f}")
print(f"least_force_nn {np.nanmin(force_nn):.3f}")

figure = Figure(figsize=(7.0, 3.8), layout="constrained")
axes = figure.subplots()
axes.plot(base_nm, force_nn, ".", ms=2, color="0.6", label="recorded")
axes.plot(base_nm[touches], force_nn[touches], ".", ms=3, label="in contact")
ends = np.array([base_nm[touches].min(), base_nm[touches].max()])
axes.plot(ends, slope * ends + offset, "k-", lw=1.0, label=f"fit: {slope:.1f} N/m")
axes.set(title=f"Contact in {RECORDING.name}", xlabel="base, towards the sample (nm)", ylabel="force at the tip (nN)")
axes.legend()
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "own_analysis.png", dpi=80)
