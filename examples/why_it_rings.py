"""Change the gain K_f and the delay, and see why the loop rings: the sessions beside the Nyquist curve of their loop.

Run it: python examples/why_it_rings.py [FOLDER]     takes: 10 s     needs: telenano[viz] and telenano-lab
You see: above, the force at the tip while the hand holds 1 N, then 2 N. Below, the loop L(j omega) of the same gain and
delay on a spring. Delay turns the curve about 0; once it encloses -1, what returns is larger than what was sent, so
each swing is larger than the last. The nearer it passes to -1, the longer the force rings. K_f is `force_gain`.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from telenano_lab.studies.loops.linear_loop import theory

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
KEY = "virtual_impedance.force_gain"  # in a scenario controller.virtual_impedance.force_gain
CASES = ((20.0, 0.0), (20.0, 40.0), (20.0, 60.0), (8.0, 60.0))
STIFFNESS_N_PER_M = 20.0  # of the spring of the theory, about that of the paper's contact

figure = Figure(figsize=(10.0, 5.4), layout="constrained")
axes = figure.subplots(2, len(CASES))
omega = np.geomspace(2.0, 3000.0, 4000)
for column, (gain, delay_ms) in enumerate(CASES):
    session = telenano.simulate(round_trip_ms=delay_ms, settings={f"controller.{KEY}": gain})
    loop = theory(stiffness_n_per_m=STIFFNESS_N_PER_M, round_trip_ms=delay_ms, settings={KEY: gain})
    margin_ms = 1e3 * (loop.critical_delay_s - loop.delay_s)
    root = loop.roots()[0]
    print(f"K_f {gain:g} delay_ms {delay_ms:g} verdict {session.verdict} margin_ms {margin_ms:.2f} root {root:.2f}")

    upper, lower = axes[0, column], axes[1, column]
    upper.plot(session["time_s"], session["scaled_tip_force_n"], lw=0.8)
    upper.plot(session["time_s"], session["operator_force_n"], "k--", lw=0.8)
    upper.set(xlim=(0.0, 8.0), ylim=(-2.0, 8.0), xlabel="time (s)")
    upper.set_title(f"$K_f$ = {gain:g}, {delay_ms:g} ms: {session.verdict.replace('_', ' ')}", fontsize=9)
    response = loop.response(omega)
    lower.plot(response.real, response.imag, lw=1.0)
    lower.plot([-1.0], [0.0], "r+", ms=12, mew=2)
    lower.set(xlim=(-2.5, 1.0), ylim=(-2.0, 1.5), xlabel="real part of L")
    lower.set_title(f"delay left to the edge: {margin_ms:.1f} ms", fontsize=9)
axes[0, 0].set_ylabel("force (N), hand dashed")
axes[1, 0].set_ylabel("imaginary part of L; + is -1")
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "why_it_rings.png", dpi=75)
