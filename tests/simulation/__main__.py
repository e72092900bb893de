"""Sessions to which faults happen, from one seed, and what they break.

    python -m tests.simulation --seed 7 --hours 0.05
    python -m tests.simulation --replay failure.json
    python -m tests.simulation --seed 7 --planted

The first writes each failure to a file, prints the tables of invariants and situations, reduces the failures, and
prints the command that repeats each. SIGINT or SIGTERM ends it with its tables at any time. `--replay` runs one
schedule, and prints the broken invariants and a digest of all messages sent and recorded. `--planted` plants one fault
after the other, and prints the number of schedules that found each.
"""

import argparse
import contextlib
import hashlib
import json
import statistics
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "doubles"))

import campaign
from fault_schedule import PROCESSES, Schedule
from planted import PLANTED, Fault
from reached import SITUATIONS
from shrunk import shrunk

from telenano.analysis import wilson
from telenano.recording.reader import Recording
from telenano.signals import interrupts


def main() -> int:
    """Run the program; return 1 if an invariant is broken, or a planted fault is not found."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=1, help="the first seed; each schedule has the next one")
    parser.add_argument("--hours", type=float, default=0.05, help="simulated hours")
    parser.add_argument("--replay", type=Path, help="run the schedule of this file once")
    parser.add_argument("--keep", type=Path, help="leave the files of the replayed session in this folder")
    parser.add_argument("--planted", nargs="*", metavar="NAME", help="plant faults, all or the named ones")
    parser.add_argument("--processes", choices=PROCESSES, help="of the loop, in the place of those that are drawn")
    parser.add_argument("--most", type=int, default=40, help="give a planted fault up after so many schedules")
    parser.add_argument("--rounds", type=int, default=1, help="look for each planted fault from so many first seeds")
    parser.add_argument("--out", type=Path, default=Path("out/simulation"), help="the folder of shrunk failures")
    given = parser.parse_args()
    interrupts.handle()
    if given.replay:
        return _replay(given.replay, given.keep)
    if given.planted is not None:
        names = given.planted or list(PLANTED)
        with contextlib.suppress(KeyboardInterrupt):
            return _plant(given.seed, names, given.most, given.rounds, given.processes)
        return interrupts.exit_code()
    return _campaign(given.seed, given.hours, given.out, given.processes)


def _replay(path: Path, keep: Path | None) -> int:
    schedule = Schedule.of(json.loads(path.read_text(encoding="utf-8")))
    bits = hashlib.sha256()
    with campaign.session_folder() as scratch:
        folder = keep or scratch
        campaign.keep(schedule, folder)
        # The other content of a file depends on its folder and on the machine.
        bits.update((folder / "ledger.msgpack").read_bytes())
        for part in sorted([*folder.glob("session*.mcap"), *folder.glob("far/*.mcap")]):
            for message in Recording(part).raw():
                bits.update(b"%d %d " % (message.log_ns, message.seq) + message.payload)
        found = campaign.outside_judge.judged(campaign.outside_judge.Session(folder))
    for one in found:
        print(f"{one.invariant} at {one.at_s:.3f} s: {one.text}")
    print(f"{len(found)} invariants are broken; sha256 of all that was sent and recorded: {bits.hexdigest()}")
    return bool(found)


def _campaign(seed: int, hours: float, out: Path, processes: str | None) -> int:
    tally, paths = campaign.Tally([]), dict[str, tuple[Path, Schedule]]()
    is_whole = False
    with contextlib.suppress(KeyboardInterrupt):
        print(f"schedules from the seed {seed}; SIGINT or SIGTERM ends them with their tables", flush=True)
        for one in campaign.campaign(seed, hours, processes=processes):
            tally.schedules.append(one)
            for found in one.breaks:
                print(f"seed {one.schedule.seed}: {found.invariant} at {found.at_s:.3f} s: {found.text}", flush=True)
            if one.breaks:
                out.mkdir(parents=True, exist_ok=True)
                path = out / f"{one.breaks[0].invariant}-{one.schedule.seed}.json"
                path.write_text(one.schedule.text(), encoding="utf-8")
                paths.setdefault(one.breaks[0].invariant, (path, one.schedule))
        is_whole = True
    print(f"\n{campaign.speed(tally)}\n")
    _print_table("invariant", campaign.INVARIANTS, tally, tally.broken(), "broken in")
    _print_table("situation", tuple(SITUATIONS), tally, tally.reached(), "reached in")
    rare = ", ".join(tally.rare()) or "none"
    print(f"less than {campaign.OFTEN} times in {campaign.NIGHT_H:g} hours of processor time: {rare}\n", flush=True)
    for name, (path, schedule) in paths.items():
        events = len(schedule.events)
        with contextlib.suppress(KeyboardInterrupt):
            # An ended campaign leaves its failures as they were drawn, because reducing one takes minutes.
            if is_whole:
                small = shrunk(schedule, lambda one, name=name: _breaks(one, name))  # type: ignore[misc]
                path.write_text(small.text(), encoding="utf-8")
                events = len(small.events)
        print(f"{name}: {events} events: python -m tests.simulation --replay {path}", flush=True)
    return bool(paths)


def _breaks(schedule: Schedule, invariant: str) -> bool:
    return any(found.invariant == invariant for found in campaign.tried(schedule).breaks)


def _print_table(
    head: str, names: tuple[str, ...], tally: campaign.Tally, counts: "campaign.Counter[str]", what: str
) -> None:
    width, total = max(map(len, names)), len(tally.schedules)
    print(f"{head:{width}}  {what:>10}  {'in an hour':>10}  {'in a night':>10}  95 % interval of the share")
    for name in names:
        low, high = wilson(counts[name], total) if total else (0.0, 1.0)
        hourly = counts[name] / max(tally.simulated_h, 1e-9)
        nightly = tally.nightly(counts[name])
        print(f"{name:{width}}  {counts[name]:>10}  {hourly:>10.1f}  {nightly:>10.0f}  {low:.4f} to {high:.4f}")
    print()


def _plant(seed: int, names: list[str], most: int, rounds: int, processes: str | None) -> int:
    width, lost = max(map(len, names)), 0
    print(f"{'planted fault':{width}}  found in  median of schedules, simulated hours  broke")
    for name in names:
        found = [
            one
            for turn in range(rounds)
            if (one := found_by(PLANTED[name], seed + 1000 * turn, most, processes)) is not None
        ]
        lost += not found
        if not found:
            print(f"{name:{width}}  0 of {rounds}    not within {most} schedules", flush=True)
            continue
        tries = statistics.median(number for number, _, _ in found)
        hours = statistics.median(passed for _, passed, _ in found)
        broke = sorted({invariant for _, _, broken in found for invariant in broken})
        others = sorted(set(broke) - PLANTED[name].breaks)
        text = f"{', '.join(broke)}{f' (not named: {chr(44).join(others)})' if others else ''}"
        print(f"{name:{width}}  {len(found)} of {rounds}    {tries:g}, {hours:.4f}  {text}", flush=True)
    return bool(lost)


def found_by(
    fault: Fault, first_seed: int, most: int, processes: str | None = None
) -> tuple[int, float, set[str]] | None:
    """Return the schedules and simulated hours that found a planted fault, and the broken invariants; None if not.

    Schedules that cannot show the fault are counted, and not run.
    """
    passed_s = 0.0
    with fault.planted():
        for number in range(most):
            schedule = Schedule.drawn(first_seed + number, processes)
            if not fault.may_show(schedule):
                continue
            one = campaign.tried(schedule, reports=fault.is_of_report)
            passed_s += one.simulated_s
            broken = {found.invariant for found in one.breaks}
            if broken & fault.breaks:
                return number + 1, passed_s / 3600.0, broken
    return None


if __name__ == "__main__":
    sys.exit(main())
