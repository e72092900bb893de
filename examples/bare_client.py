"""Read a running rig without the library, by a socket and msgpack alone, as a program in any language may do.

Run it: telenano up examples/pressing.yaml --headless --out out/pressing, and in a second terminal
        python examples/bare_client.py [FOLDER [SECONDS]]     takes: 10 s   needs: pip install pyzmq msgpack matplotlib
You see: the force at the tip twice a second, then its picture. proto/SPEC.md describes the wire; nothing here imports
telenano. A reader that only looks connects to .fan, so that the node does not notice how many readers there are.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import msgpack
import zmq
from matplotlib.figure import Figure

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 10.0
PATIENCE_MS = 5000

usual = Path(tempfile.gettempdir()) / f"telenano-{os.getuid()}"
if home := os.environ.get("XDG_RUNTIME_DIR"):
    usual = Path(home) / "telenano"
runtime = Path(os.environ.get("TELENANO_RUNTIME_DIR", usual))

socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.SUB)
socket.subscribe("afm/state")
socket.connect(f"ipc://{runtime}/afm_node@slave.fan")
stamps_ns: list[int] = []
numbers: list[int] = []
forces_nn: list[float] = []
shown_ns = 0
end_s = time.monotonic() + SECONDS
while time.monotonic() < end_s and socket.poll(PATIENCE_MS):
    topic, payload = socket.recv_multipart()
    if topic != b"afm/state":  # ZeroMQ subscribes by prefix, and another topic may begin in the same way
        continue
    state = msgpack.unpackb(payload)
    stamps_ns.append(state["t_ns"])
    numbers.append(state["seq"])
    forces_nn.append(1e9 * state["tip_force_n"][2])
    if stamps_ns[-1] >= shown_ns + 500_000_000:
        shown_ns = stamps_ns[-1]
        print(f"{1e-9 * (shown_ns - stamps_ns[0]):6.2f} s  {forces_nn[-1]:7.3f} nN", flush=True)
if not numbers:
    sys.exit(f"{runtime}: no rig of this user publishes there; start one, or set TELENANO_RUNTIME_DIR as it has it")
print(f"messages {len(numbers)} lost {numbers[-1] - numbers[0] + 1 - len(numbers)}")
print(f"greatest_nn {max(forces_nn):.2f}")

figure = Figure(figsize=(7.0, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot([1e-9 * (stamp_ns - stamps_ns[0]) for stamp_ns in stamps_ns], forces_nn, lw=1.0)
axes.set(title="afm/state of a running rig", xlabel="time since the first message (s)", ylabel="force at the tip (nN)")
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "bare_client.png", dpi=80)
