"""Make many recordings of the real nodes in virtual time, each with its own seed, and compare how the loop rested.

Run it: python examples/many_recordings.py [FOLDER [COUNT]]     takes: 1 min     needs: pip install 'telenano[viz]'
You see: the force at the tip of every session under the mean, over a link with jitter and loss. The recordings stay in
FOLDER/many, one folder a seed: `telenano report`, `view` and `bag` open each of them.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
COUNT = int(sys.argv[2]) if len(sys.argv) > 2 else 100
LINE = {"delay_s": 0.01, "jitter": {"scale_s": 0.003}, "loss": {"probability": 0.02}}
SETTINGS = {
    "realtime.rate_hz": 250,  # a quarter of the usual rate, and so four times as many sessions in a minute
    "delay_node.forward": LINE,
    "delay_node.backward": LINE,
}


def recorded(seed: int) -> tuple[int, npt.NDArray[np.float64]]:
    """Record the press of Fig. 12 with a seed, unless it is there; return the seed and the forces at TIMES_S [N]."""
    folder = OUT / "many" / f"{seed:03d}"
    if not (folder / "session.mcap").exists():
        telenano.simulate("fig12", duration_s=2.0, settings=SETTINGS, recording=folder, seed=seed, report=False)
    session = telenano.open(folder)
    return seed, np.interp(TIMES_S, session["time_s"], session["tip_force_n"])


TIMES_S = np.arange(0.0, 2.0, 0.01)

if __name__ == "__main__":
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        forces_n = np.array([force_n for _, force_n in pool.map(recorded, range(COUNT))])
    held_n = forces_n[:, TIMES_S > 1.7].mean(axis=1)
    print(f"recordings {COUNT}")
    print(f"held_nn {1e9 * held_n.mean():.4f}")
    print(f"spread_nn {1e9 * held_n.std():.4f}")
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(TIMES_S, 1e9 * forces_n.T, color="#8a8f98", linewidth=0.4)
    axes.plot(TIMES_S, 1e9 * forces_n.mean(axis=0), color="#0059b3", label=f"mean of {COUNT} seeds")
    axes.set(xlabel="time [s]", ylabel="force at the tip [nN]")
    axes.legend(frameon=False, loc="upper left")
    OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(OUT / "many_recordings.png", dpi=110)
