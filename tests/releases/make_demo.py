"""Make the recording that the project comes with.

    python tests/releases/make_demo.py

The nodes of the rig run in virtual time, so that the same commit gives the same messages. `telenano/settings/demo.mcap`
is the session that `telenano view --demo` shows.
"""

import shutil
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "replay")]
DEMO = ROOT / "telenano" / "settings" / "demo.mcap"
# a quarter of the loop's usual rate, so that a file is small
SETTINGS = (
    "realtime.rate_hz=250",
    "delay_node.forward.delay_s=0.01",
    "delay_node.backward.delay_s=0.01",
)


def recorded(path: Path, duration_s: float) -> None:
    """Record a session of Fig. 12 over a link of 20 ms, there and back."""
    from telenano.settings import find_scenario
    from telenano.virtual import record_session

    scenario = yaml.safe_load(find_scenario("fig12").read_text())
    folder = path.with_suffix("")
    folder.mkdir(parents=True)
    record_session(folder, 12, SETTINGS, duration_s, scenario).replace(path)
    shutil.rmtree(folder)


if __name__ == "__main__":
    recorded(DEMO, 8.5)
