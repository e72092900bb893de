"""Run a study of your own on a Dask cluster: gain against delay, a session of the rig in each cell.

Run it: python examples/dask_study.py [FOLDER]     takes: 40 s     needs: pip install 'telenano[viz,dask]'
You see: a map of verdicts: the greater the gain, the less delay it allows. LocalCluster starts workers on this machine,
at a port that its other users reach too; Client("tcp://HOST:8786") uses a cluster of machines.
scale.md of telenano-lab says how to start and to protect one.
"""

import sys
from pathlib import Path

from dask.distributed import Client, LocalCluster
from matplotlib.figure import Figure

import telenano

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
GAINS = (10.0, 20.0, 40.0)
DELAYS_MS = (0.0, 20.0, 40.0, 60.0)
COLOURS = {"stable": "#007a5a", "limit_cycle": "#c04e00", "diverged": "#000000"}


def verdict(gain: float, delay_ms: float) -> str:
    """Return the verdict of a session, on whichever worker runs it."""
    settings = {"controller.virtual_impedance.force_gain": gain}
    return telenano.simulate("fig12", round_trip_ms=delay_ms, settings=settings).verdict


if __name__ == "__main__":
    cells = [(gain, delay_ms) for gain in GAINS for delay_ms in DELAYS_MS]
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        verdicts = client.gather(client.map(verdict, *zip(*cells, strict=True)))
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for (gain, delay_ms), found in zip(cells, verdicts, strict=True):
        print(f"K_f {gain:g} delay_ms {delay_ms:g} verdict {found}")
        at = (delay_ms, GAINS.index(gain))
        axes.plot(*at, "s", ms=44, color=COLOURS.get(found, "0.4"))
        axes.annotate(found.replace("_", "\n"), at, ha="center", va="center", fontsize=9, color="white")
    axes.set(title="Fig. 12 in lockstep, law virtual_impedance", xlabel="round trip (ms)", ylabel="gain $K_f$")
    axes.set(xlim=(-10.0, 70.0), ylim=(-0.6, 2.6), xticks=DELAYS_MS)
    axes.set_yticks(range(len(GAINS)), [f"{gain:g}" for gain in GAINS])
    OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(OUT / "dask_study.png", dpi=80)
