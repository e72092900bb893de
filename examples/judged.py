"""Judge your own recording: the verdict of each hold, from which of its seconds, and why.

Run it: python examples/judged.py [RECORDING [FOLDER]]     takes: 3 s     needs: pip install 'telenano[viz]'
You see: the hand and the tip over time, and under each hold the colour of its verdict. RECORDING is a file, or the
folder of one session; without it the recording of telenano is judged. The verdict is kept beside the file.
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import telenano
from telenano.analysis import VERDICT_COLOURS
from telenano.settings import DEMO_RECORDING

RECORDING = Path(sys.argv[1]) if len(sys.argv) > 1 else DEMO_RECORDING
OUT = Path(sys.argv[2] if len(sys.argv) > 2 else "out/examples")

session = telenano.open(RECORDING)
set_to = session.conditions
print(f"law {set_to.law} round_trip_ms {set_to.round_trip_ms} sample {set_to.sample}")
print(f"verdict {session.verdict}: {session.reason}")

figure = Figure(figsize=(7.0, 3.8), layout="constrained")
axes = figure.subplots()
axes.plot(session["time_s"], session["operator_force_n"], "k--", lw=0.8, label="hand")
axes.plot(session["time_s"], session["scaled_tip_force_n"], lw=1.0, label="tip, at the hand's scale")
for number, hold in enumerate(session.holds, start=1):
    facts = "".join(f", {fact.text}" for fact in hold.facts)
    print(f"hold {number} {hold.start_s:.2f}..{hold.end_s:.2f} s {hold.verdict}: {hold.reason}{facts}")
    # a hold that nothing could be judged of has its colour from end to end
    begin_s, end_s = hold.judged_from_s or hold.start_s, hold.judged_to_s or hold.end_s
    axes.axvspan(begin_s, end_s, color=VERDICT_COLOURS[hold.verdict], alpha=0.4, lw=0)
    axes.text(hold.start_s, axes.get_ylim()[0], f" {hold.verdict.replace('_', ' ')}", fontsize=8, va="bottom")
axes.set(title=f"{RECORDING.name}: {session.verdict}", xlabel="time (s)", ylabel="force (N)")
axes.legend(frameon=False)
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "judged.png", dpi=80)
