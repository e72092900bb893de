"""Thirty conditions to a figure: five laws at six delays, by the real nodes in virtual time, and one table of all.

Run it: python examples/thirty_conditions.py [FOLDER]     takes: 1 min     needs: telenano[viz], telenano-laws, pandas
You see: the verdict of each law at each round trip, with the force that it holds for each newton of the hand. The
sessions stay in FOLDER/thirty, and a second run makes those alone that are missing.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path

from matplotlib.figure import Figure

import telenano
from telenano.analysis import VERDICT_COLOURS

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated")
ROUND_TRIPS_MS = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0)


def record(condition: tuple[str, float]) -> None:
    """Record a press of two newtons over one law and one delay, unless it is there."""
    law, round_trip_ms = condition
    folder = OUT / "thirty" / f"{law}_{round_trip_ms:g}ms"
    if not (folder / "session.mcap").exists():
        # a quarter of the usual rate, for four times as many sessions in a minute
        telenano.simulate(
            "fig12", law=law, round_trip_ms=round_trip_ms, duration_s=4.5, recording=folder, report=False,
            settings={"realtime.rate_hz": 250},
        )  # fmt: skip


if __name__ == "__main__":
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        list(pool.map(record, product(LAWS, ROUND_TRIPS_MS)))
    # a row a hold; what is judged is kept beside each recording
    table = telenano.open_all(OUT / "thirty" / "*" / "session.mcap")
    last = table[table["hand_force_n"] > 1.5].groupby(["law", "round_trip_ms"], as_index=False).last()
    print(f"conditions {len(last)}")
    for law in LAWS:
        rows = last[last["law"] == law]
        print(f"law {law} " + " ".join(f"{row.round_trip_ms:g}:{row.session_verdict}" for row in rows.itertuples()))
    figure = Figure(figsize=(7.5, 3.2), layout="constrained")
    axes = figure.subplots()
    for row in last.itertuples():
        x, y = ROUND_TRIPS_MS.index(row.round_trip_ms), LAWS.index(row.law)
        axes.barh(y, 0.96, left=x - 0.48, height=0.9, color=VERDICT_COLOURS[row.session_verdict])
        # what the hand holds for each newton at the tip, where the motion came to rest
        text = f"{row.hold_ratio:.2f}" if row.session_verdict == "stable" and row.hold_ratio > 0.0 else ""
        axes.text(x, y, text, ha="center", va="center", fontsize=8)
    for verdict in dict.fromkeys(last["session_verdict"]):
        axes.barh(0.0, 0.0, color=VERDICT_COLOURS[verdict], label=verdict.replace("_", " "))
    axes.set_xticks(range(len(ROUND_TRIPS_MS)), [f"{ms:g}" for ms in ROUND_TRIPS_MS])
    axes.set_yticks(range(len(LAWS)), [law.replace("_", " ") for law in LAWS])
    axes.set(xlabel="round trip (ms)", title="verdict, and newtons of the hand for each at the tip")
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(OUT / "thirty_conditions.png", dpi=80)
