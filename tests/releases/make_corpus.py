"""Make the recordings that the project comes with, and the corpus of this version that every later one has to open.

    python tests/releases/make_corpus.py

The nodes of the rig run in virtual time, so that the same commit gives the same messages. `presets/demo.mcap` is the
session that `telenano view --demo` shows; tests/releases/VERSION has what `test_corpus.py` tries. A corpus of a version
that is out is never made again.
"""

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "replay")]
RELEASES = ROOT / "tests" / "releases"
DEMO = ROOT / "presets" / "demo.mcap"
# a quarter of the loop's usual rate, so that a file is small
SETTINGS = (
    "realtime.rate_hz=250",
    "delay_node.forward.delay_s=0.01",
    "delay_node.backward.delay_s=0.01",
)
# also given by test_corpus.py, which continues the map
MAP = ("--environment", "spring", "--law", "position_force", "--delay", "0,20", "--stiffness", "10,20")


def recorded(path: Path, duration_s: float, settings: Sequence[str]) -> None:
    """Record a session of Fig. 12 over a link of 20 ms, there and back."""
    from virtual_rig import record_session

    from presets import find_scenario

    scenario = yaml.safe_load(find_scenario("fig12").read_text())
    folder = path.with_suffix("")
    folder.mkdir(parents=True)
    record_session(folder, 12, (*SETTINGS, *settings), duration_s, scenario).replace(path)
    shutil.rmtree(folder)


def corpus(folder: Path) -> None:
    """Make recordings, two of them damaged, a scenario, a site, an experiment, a map and a law in a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    recorded(folder / "sound.mcap", 2.0, ("controller.law=wave",))
    whole = (folder / "sound.mcap").read_bytes()
    # a machine that lost power, and a disk with a fault
    (folder / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    half = len(whole) // 2
    (folder / "flipped.mcap").write_bytes(whole[:half] + bytes([whole[half] ^ 0x55]) + whole[half + 1 :])
    scenario = yaml.safe_load((ROOT / "presets" / "scenarios" / "fig12.yaml").read_text())
    scenario |= {"name": "of_a_release", "controller": {"law": "wave"}, "delay_node": {"profile": "satellite"}}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario, sort_keys=False))
    shutil.copy(ROOT / "presets" / "sites" / "two_sites.yaml", folder / "site.yaml")
    telenano(folder, "experiment", "run", "delay_and_law", "--apparatus", "lockstep", "--out", "experiment")
    telenano(folder, "study", "stability", *MAP, "--out", "map")
    for picture in (*folder.glob("map/*.png"), *folder.glob("map/*.html")):
        picture.unlink()
    telenano(folder, "new", "law", "law_of_a_release")
    # the tests of this version would be collected with those of a later one
    shutil.rmtree(folder / "telenano-law-of-a-release" / "tests")


def telenano(folder: Path, *words: str) -> None:
    """Run a command in the folder."""
    subprocess.run([sys.executable, "-P", "-m", "telenano", *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    recorded(DEMO, 8.5, ())
    corpus(RELEASES / tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])
