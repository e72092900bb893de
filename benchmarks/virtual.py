"""How many times faster than real time a session in virtual time runs on one core, with what is recorded of it.

    python benchmarks/virtual.py [--rates 1000,250] [--session-s 4] [--repeats 5] [--one-recorder] [--json]

A session of Fig. 12 runs with the recorders of both sites, each with a file of its own in a new folder. A figure is the
processor time of a second of the session, without start and arming; the best of several stretches counts, as another
process on the core can only make it slower. `--one-recorder` records with one recorder, as `telenano simulate` does
unless it is asked for both sites.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

from telenano.virtual.request import SimulateRequest, plan_of
from telenano.virtual.session import SimulatedRig

# The aims as multiples of real time, by the rate of the loop [Hz].
AIMS = {1000: 2.0, 250: 7.0}
# The length of a stretch, whose processor time is one measurement [s].
_STRETCH_S = 0.25


def stretches_s(rate_hz: int, session_s: float, folder: Path, *, both_sites: bool) -> list[float]:
    """Return the processor time of a simulated second [s] for each stretch of a session."""
    request = SimulateRequest(
        scenario="fig12",
        out=folder,
        duration_s=session_s,
        settings=(f"realtime.rate_hz={rate_hz}",) if rate_hz != 1000 else (),
        both_sites=both_sites,
    )
    rig = SimulatedRig(plan_of(request, folder), 0, far=both_sites)
    times: list[float] = []
    begun = [0, time.process_time_ns()]

    def observe(launcher: object) -> None:
        now_ns = rig.clock.monotonic_ns()
        passed_ns = now_ns - begun[0]
        if begun[0] and passed_ns < _STRETCH_S * 1e9:
            return
        spent_ns = time.process_time_ns() - begun[1]
        if begun[0] and rig.launcher.ran and rig.launcher.elapsed_s > _STRETCH_S:
            times.append(spent_ns / passed_ns)
        begun[:] = [now_ns, time.process_time_ns()]

    outcome = rig.run(observe)
    assert outcome.recordings, outcome.failure
    return times


def main() -> None:
    """Print a row for each rate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rates", default="1000,250", help="rates of the loop [Hz]")
    parser.add_argument("--session-s", type=float, default=4.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--one-recorder", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    arguments = parser.parse_args()
    if arguments.smoke:
        arguments.session_s, arguments.repeats = 1.5, 1
    rows = {}
    for rate_hz in map(int, arguments.rates.split(",")):
        times = []
        for _ in range(arguments.repeats):
            with tempfile.TemporaryDirectory() as folder:
                both = not arguments.one_recorder
                times += stretches_s(rate_hz, arguments.session_s, Path(folder) / "session", both_sites=both)
        times.sort()
        best_s, median_s = times[0], times[len(times) // 2]
        rows[rate_hz] = {"best_us_per_ms": 1e3 * best_s, "median_us_per_ms": 1e3 * median_s, "times": 1.0 / best_s}
    if arguments.json:
        print(json.dumps(rows))
        return
    for rate_hz, row in rows.items():
        aim = f", aim {AIMS[rate_hz]:g}" if rate_hz in AIMS else ""
        best, median = row["best_us_per_ms"], row["median_us_per_ms"]
        print(f"{rate_hz:5d} Hz: {row['times']:.2f} times real time{aim}; {best:.0f} us a ms, median {median:.0f} us")


if __name__ == "__main__":
    main()
