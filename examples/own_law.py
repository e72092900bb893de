"""Write a control law of your own, try it against the rules of the rig, and compare it with another law under delay.

Run it: python examples/own_law.py [FOLDER]     takes: 10 s     needs: pip install 'telenano[viz]' hatchling
You see: the force at the tip at 60 ms. `telenano new law` makes a package; here one line of it is changed, so that the
hand is braked while the tip presses. The paper's law does not come to rest; yours strikes first, and then does.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from matplotlib.figure import Figure

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
LINE = "mass = moved(p, mass, hand.force_n - force)"
BRAKE = "mass = moved(p, mass, hand.force_n - force - (300.0 * mass.velocity_m_per_s if force > 0.05 else 0.0))"

with tempfile.TemporaryDirectory() as name:
    package, site = Path(name) / "my_law", Path(name) / "site"
    subprocess.run([sys.executable, "-m", "telenano", "new", "law", "my_law", "--out", package], check=True)
    source = package / "telenano_my_law" / "__init__.py"
    text = source.read_text()
    assert LINE in text
    source.write_text(text.replace(LINE, BRAKE))
    # `pip install -e telenano-my-law` does so for good; --target keeps this example out of your environment
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target"]
    subprocess.run([*pip, str(site), str(package)], check=True)
    sys.path.insert(0, str(site))

    broken = {rule: faults for rule, faults in telenano.check_law("my_law").items() if faults}
    print(f"rules_broken {len(broken)}", *broken)
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for law, style in (("virtual_impedance", ":"), ("my_law", "-")):
        session = telenano.simulate("fig12", law=law, round_trip_ms=60.0)
        print(f"law {law} verdict {session.verdict}: {session.reason}")
        label = f"{law}: {session.verdict.replace('_', ' ')}"
        axes.plot(session["time_s"], session["scaled_tip_force_n"], style, lw=1.0, label=label)
axes.plot(session["time_s"], session["operator_force_n"], "k--", lw=0.8, label="force of the hand")
axes.set(title="Fig. 12 at a round trip of 60 ms", xlabel="time (s)", ylabel="force at the hand's scale (N)")
axes.set(xlim=(0.0, 8.0))
axes.legend()
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "own_law.png", dpi=80)
