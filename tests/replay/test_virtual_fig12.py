"""What the commands at a glance say of Fig. 12 over a delay, on the nodes in virtual time.

No machine holds these loops up, so each session is judged without a condition.
"""

import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from telenano.analysis import Session, summary_of
from telenano.recording.multi_file import open_recordings
from telenano.settings import find_scenario
from telenano.settings.network_profiles import PROFILES
from telenano.virtual import record_session

PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto.md"
# until the hand has started
BEFORE_S = 0.35


def settings_of(option: str) -> list[str]:
    """Return the settings of the command in the first block of the page that has an option."""
    block = PAGE.read_text("utf-8").partition("```sh\n")[2].partition("```")[0]
    (line,) = [text for text in block.splitlines() if option in text and "telenano up" in text]
    words = shlex.split(line, comments=True)
    assert words[1:3] == ["up", "fig12"]
    found: list[str] = []
    for name, value in zip(words[3::2], words[4::2], strict=True):
        if name == "--round-trip-ms":
            found += [f"delay_node.{way}.delay_s={0.5e-3 * float(value)}" for way in ("forward", "backward")]
        else:
            assert name == "--set"
            found.append(value)
    return found


def run(folder: Path, duration_s: float, *settings: str) -> dict[str, Any]:
    """Run a session and give its summary."""
    scenario = yaml.safe_load(find_scenario("fig12").read_text("utf-8"))
    path = record_session(folder, 1, settings, BEFORE_S + duration_s, {**scenario, "duration_s": duration_s})
    recording = open_recordings([path])
    session = Session.of(recording)
    return summary_of(session, recording)


@pytest.mark.endurance("takes 7.6 s")
def test_forty_milliseconds_round_trip_stay_stable_and_without_the_meniscus_the_contact_is_nearer(
    tmp_path: Path,
) -> None:
    found = run(tmp_path, 6.5, *settings_of("--round-trip-ms 40"), "afm_node.meniscus=false")
    assert found["loop_age_ms"]["p50"] > 40.0
    assert found["stable"] is True, found["holds"]
    # beside its edge the loop has not come wholly to rest when a hold ends
    assert found["hold_ratio"] == pytest.approx(1.050, abs=0.020)
    assert found["contact_x_cm"] == pytest.approx(0.672, abs=0.010)


@pytest.mark.check("takes 5.9 s")
def test_sixty_milliseconds_round_trip_are_a_limit_cycle(tmp_path: Path) -> None:
    # beyond the last hold of the hand
    found = run(tmp_path, 4.7, *settings_of("--round-trip-ms 60"))
    assert found["verdict"] == "limit_cycle"
    swings = [hold["peak_to_peak_n"] for hold in found["holds"] if hold["hand_force_n"] == pytest.approx(2.0, abs=0.1)]
    # 7.3 N at 62 ms, and 0.06 N more for each millisecond
    assert max(swings) == pytest.approx(7.3 + 0.06 * (found["loop_age_ms"]["p50"] - 62.0), abs=1.0)


@pytest.mark.check("takes 2.0 s")
def test_the_satellite_of_the_page_is_as_far_away_as_it_is(tmp_path: Path) -> None:
    found = run(tmp_path, 1.5, *settings_of("delay_node.profile=satellite"))
    round_trip_s = sum(PROFILES["satellite"].settings[way]["delay_s"] for way in ("forward", "backward"))
    assert found["law"] == ["wave"]
    # its jitter takes off a few milliseconds as often as it adds some
    assert found["loop_age_ms"]["p50"] > 950.0 * round_trip_s
