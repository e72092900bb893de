"""Bring a haptic device of your own: a driver of five methods, in a real session of the rig, read from its recording.

Run it: python examples/own_device.py [FOLDER]     takes: 20 s     needs: pip install 'telenano[rig]' hatchling
You see: the force that your handle reads, and the force at the tip that answers it. `telenano new device` makes a
package; here one line of it is changed, so that the handle is pressed once, and then twice as hard. The calls of your
hardware go into its class `Hardware`. The processes of the rig find the package by its entry point.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from matplotlib.figure import Figure

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
LINE = "sample.velocity_m_per_s, sample.force_n, False"
PRESS = "sample.velocity_m_per_s, sample.force_n * ((session_time_s >= 1.0) + (session_time_s >= 4.0)), False"


with tempfile.TemporaryDirectory() as name:
    package, site = Path(name) / "my_handle", Path(name) / "site"
    subprocess.run([sys.executable, "-m", "telenano", "new", "device", "my_handle", "--out", package], check=True)
    source = package / "telenano_my_handle" / "__init__.py"
    text = source.read_text()
    assert LINE in text
    source.write_text(text.replace(LINE, PRESS))
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target"]
    subprocess.run([*pip, str(site), str(package)], check=True)
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    rig = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--headless", "--duration", "7"]
    rig += ["--set", "haptic_node.driver=my_handle", "--set", "haptic_node.my_handle.force_n=1.0"]
    rig += ["--set", "realtime.rate_hz=250", "--out", str(OUT / "own_device"), "--overwrite"]
    ended = subprocess.run(rig, env={**os.environ, "PYTHONPATH": path})
    if ended.returncode not in (0, 3):  # 3: the machine held the session up, and the last line says what is missing
        sys.exit(ended.returncode)

session = telenano.open(OUT / "own_device")
for begin_s, end_s in ((3.0, 3.9), (6.0, 6.9)):
    felt_n = session["scaled_tip_force_n"][(session["time_s"] > begin_s) & (session["time_s"] < end_s)].mean()
    print(f"from_s {begin_s:g} scaled_tip_force_n {felt_n:.3f}")
figure = Figure(figsize=(7.0, 3.6), layout="constrained")
axes = figure.subplots()
axes.plot(session["time_s"], session["operator_force_n"], "--", label="my handle, $F_m$")
axes.plot(session["time_s"], session["scaled_tip_force_n"], lw=1.0, label=r"tip, scaled, $\alpha_f F_s$")
axes.set(title="A session with your own device", xlabel="time (s)", ylabel="force (N)", xlim=(0.0, 7.0))
axes.legend()
figure.savefig(OUT / "own_device.png", dpi=80)
