"""Laws over a line of 1 Mbit/s, with the samples that its rate control lets through and what crosses beside them."""

from pathlib import Path

import pytest
from line_bench import MS, Bottleneck, run
from test_line import MBIT, TO_MASTER, TO_SLAVE

from telenano import simulate

pytestmark = [pytest.mark.endurance, pytest.mark.timeout(300)]

WARM_UP_S, DURATION_S = 8, 6
# Without a narrow line passivity comes to rest late in the hold, and wave soon.
AT_REST = {"passivity": {"stable"}, "wave": {"stable"}}


def write_traces(folder: Path, direction: str, beside: tuple[tuple[float, int], ...], seed_s: float) -> list[float]:
    """Write which samples cross a full line and how late, by number; return the delays of those that do [s]."""
    # Where in its rhythm the traffic beside the samples is when the session begins.
    begin = round((WARM_UP_S + seed_s) * 1000)
    found = run(Bottleneck(MBIT), WARM_UP_S + seed_s + DURATION_S + 1.0, size=142, beside=beside)
    waits = [found.waits_ns.get(tick * MS) for tick in range(begin, begin + DURATION_S * 1000)]
    late, delays, losses = 0, [], []
    for number, wait_ns in enumerate(waits):
        late = late if wait_ns is None else wait_ns
        delays.append(f"{number} {late * 1e-9:.6f}")
        losses.append(f"{number} {int(wait_ns is None)}")
    (folder / f"{direction}.delay").write_text("\n".join(delays) + "\n", encoding="utf-8")
    (folder / f"{direction}.loss").write_text("\n".join(losses) + "\n", encoding="utf-8")
    return [wait_ns * 1e-9 for wait_ns in waits if wait_ns is not None]


@pytest.mark.parametrize("law", ["passivity", "wave"])
@pytest.mark.parametrize("seed_s", [0.0, 0.37, 0.71])
def test_a_law_rests_in_contact_over_1_mbit_each_way(tmp_path: Path, law: str, seed_s: float) -> None:
    settings: dict[str, object] = {}
    for direction, beside in (("forward", TO_SLAVE), ("backward", TO_MASTER)):
        waits_s = write_traces(tmp_path, direction, beside, seed_s)
        assert sum(waits_s) / len(waits_s) < 0.010
        for trace in ("delay", "loss"):
            settings[f"delay_node.{direction}.{trace}_trace.file"] = str(tmp_path / f"{direction}.{trace}")
            settings[f"delay_node.{direction}.{trace}_trace.by"] = "number"
        settings[f"delay_node.{direction}.delay_trace.interpolation"] = "hold"
        settings[f"delay_node.{direction}.order"] = "link"
    session = simulate("fig12", law=law, round_trip_ms=40.0, duration_s=5.0, settings=settings)
    assert session.verdict in AT_REST[law]


def test_passivity_rests_with_few_samples_and_lands_later(tmp_path: Path) -> None:
    landed_s = []
    # with every sample, every third and every fifth; the same with pauses of 12 ms that take 24 ms to go
    for pauses in (False, True):
        for each in (1, 3, 5):
            settings: dict[str, object] = {}
            (tmp_path / "loss").write_text("".join(f"{n} {int(n % each != 0)}\n" for n in range(1001 - 1001 % each)))
            (tmp_path / "delay").write_text("0 0.012\n0.012 0.007\n0.024 0.003\n0.036 0\n0.0624 0\n")
            for direction in ("forward", "backward"):
                settings[f"delay_node.{direction}.loss_trace.file"] = str(tmp_path / "loss")
                settings[f"delay_node.{direction}.loss_trace.by"] = "number"
                settings[f"delay_node.{direction}.order"] = "link"
                if pauses:
                    settings[f"delay_node.{direction}.delay_trace.file"] = str(tmp_path / "delay")
            session = simulate("fig12", law="passivity", round_trip_ms=40.0, duration_s=5.0, settings=settings)
            assert session.verdict in {"stable", "cannot_say"}, session.reason
            assert session.holds[1].verdict == "stable"
            assert session.holds[1].peak_to_peak_n < 1e-3
            landed_s.append(float(session["time_s"][int(session["in_contact"].argmax())]))
    assert landed_s[0] < landed_s[1] < 2.4
    assert landed_s[3] < landed_s[4] < 2.4
