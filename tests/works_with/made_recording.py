"""A short recording whose numbers are known, for programs that read recordings or what is exported from them."""

from pathlib import Path

import numpy as np
from planted_errors import Numbers, planted

from telenano.recording import FileSettings, RecordingWriter
from telenano.testing import hand_state, numbered
from telenano.wire import encode

COUNT = 7
# Different in each component and message, of both signs, with digits to the last place of a double.
POSITION_M = np.array([[1e-3, -2e-3, 3e-3]]) * (1.0 + np.arange(COUNT)[:, None] / 3.0)
FORCE_N = np.array([[-0.1, 0.7, 1.3]]) / (1.0 + np.arange(COUNT)[:, None])
# Only one of the messages has an energy.
ENERGY_J = np.where(np.arange(COUNT) == 3, 1.0 / 3.0, np.nan)

WANTED: Numbers = {
    "position": POSITION_M,
    "force": FORCE_N,
    "limited": np.arange(COUNT) % 2,
    "late_ns": np.arange(COUNT) * 1_000_000,
    "energy": ENERGY_J,
}


def recording_in(folder: Path, error: str) -> Path:
    """Record messages of the hand and of a law, with an error of `planted_errors` in position and force."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    forward = writer.channel("teleop/forward", "controller@master", "master")
    position_m, force_n = planted(error, POSITION_M), planted(error, FORCE_N)
    for seq in range(COUNT):
        state = hand_state(seq, position_m=tuple(position_m[seq]), operator_force_n=tuple(force_n[seq]))
        writer.write(hand, state.t_ns, state.t_ns, seq, encode(state))
        energy_j = None if np.isnan(ENERGY_J[seq]) else float(ENERGY_J[seq])
        sent = numbered("teleop/forward", seq, src="controller@master", energy_j=energy_j)
        writer.write(forward, sent.t_ns, sent.t_ns, seq, encode(sent))
    writer.finish()
    return writer.path
