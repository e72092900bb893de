"""Record the live sessions of the corpus: `python tests/releases/make_corpus.py [NAME ...]`.

Each is a session of real processes on one machine, which no later run repeats bit by bit. `tests/releases/corpus` keeps
the recordings with the verdict that each had, so that a later version has to read them, to judge them alike, and to
make the same messages again from what their nodes took in.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).with_name("corpus")
VERDICTS = CORPUS / "verdicts.yaml"
# a quarter of the loop's usual rate, so that a file is small
COMMON = ("--set", "realtime.rate_hz=250")


class Session(NamedTuple):
    """A session: options of `telenano up`, and what it is there for."""

    options: tuple[str, ...]
    about: str


SESSIONS = {
    "fig12": Session((), "Fig. 12 of the paper, by its law"),
    "late": Session(("--round-trip-ms", "60"), "the same over 60 ms, which the law does not hold"),
    "mobile": Session(
        ("--set", "controller.law=passivity", "--set", "delay_node.profile=cicv5g_n78_urban"), "a measured line of 5G"
    ),
    "real": Session(
        ("--set", "controller.law=wave", "--round-trip-ms", "40", "--instrument", "real"),
        "an instrument with noise, hysteresis, creep and drift",
    ),
}


def record(name: str) -> None:
    """Run a session and keep its recording, with its verdict and holds.

    Raises:
        SystemExit: It came to no summary.
    """
    with tempfile.TemporaryDirectory() as made:
        out = Path(made) / name
        command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--out", str(out)]
        done = subprocess.run([*command, *COMMON, *SESSIONS[name].options], stdout=subprocess.PIPE, text=True, cwd=ROOT)
        summary = json.loads(done.stdout or "{}")
        if "verdict" not in summary:
            sys.exit(f"{name}: {summary.get('error', 'no summary')}")
        CORPUS.mkdir(exist_ok=True)
        shutil.copyfile(out / "session.mcap", CORPUS / f"{name}.mcap")
    verdicts = yaml.safe_load(VERDICTS.read_text()) if VERDICTS.exists() else {}
    verdicts[name] = {
        "about": SESSIONS[name].about,
        "options": " ".join([*COMMON, *SESSIONS[name].options]),
        "verdict": summary["verdict"],
        "holds": [
            {"hand_force_n": hold["hand_force_n"], "verdict": hold["verdict"], "hold_ratio": hold["hold_ratio"]}
            for hold in summary["holds"]
        ],
    }
    VERDICTS.write_text(yaml.safe_dump(verdicts, sort_keys=True), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(SESSIONS), metavar="NAME")
    for chosen in parser.parse_args().names:
        record(chosen)
