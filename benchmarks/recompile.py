"""What an edit costs: functions compiled again, and time of a small study, after edits in a copy of the sources.

python benchmarks/recompile.py
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("proto", "presets", "recording", "services", "analysis", "studies", "telenano")
STUDY = (
    *("study", "stability", "--law", "virtual_impedance", "--environment", "contact", "--stiffness", "40"),
    *("--delay", "0,20", "--duration", "4.7", "--workers", "1", "--json", "--out"),
)
# what is done, the file, a text in it and what takes its place
LAW = "services/controller/laws/virtual_impedance.py"
MODEL = "services/afm_node/physics/contact/lennard_jones.py"
EDITS = (
    ("nothing", LAW, "", ""),
    ("a comment in the figures of studies", "studies/pages/figures.py", '"""\n\nfrom', '"""\n\n# a comment\nfrom'),
    ("the law of the study", LAW, "- scaled_force\n", "- 1.0 * scaled_force\n"),
    ("a model of the instrument", MODEL, "q8 = q2 * q2", "q8 = 1.0 * q2 * q2"),
)


def main() -> None:
    """Print a row for each edit."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sources, cache = Path(folder) / "sources", Path(folder) / "cache"
        for name in PACKAGES:
            ignored = shutil.ignore_patterns("node_modules", "dist", "__pycache__")
            shutil.copytree(ROOT / name, sources / name, ignore=ignored)
        environment = {**os.environ, "PYTHONPATH": str(sources), "XDG_CACHE_HOME": str(cache)}
        cold_s, compiled, _ = study(environment, Path(folder) / "cold")
        print(f"{'cold':40s} {compiled:4d} functions compiled, 1.00 of the time ({cold_s:.1f} s)")
        for number, (what, file, old, new) in enumerate(EDITS):
            path = sources / file
            text = path.read_text()
            assert old in text, (file, old)
            path.write_text(text.replace(old, new, 1))
            took_s, compiled, size_mb = study(environment, Path(folder) / str(number))
            share = f"{took_s / cold_s:.2f} of the time"
            print(f"{what:40s} {compiled:4d} functions compiled, {share}, {size_mb:.0f} MB kept")


def study(environment: dict[str, str], out: Path) -> tuple[float, int, float]:
    """Return the time of a study [s], the functions that it compiled, and the size of the cache [MB]."""
    cache = Path(environment["XDG_CACHE_HOME"])
    began_ns = time.time_ns()
    command = [sys.executable, "-m", "telenano", *STUDY, str(out)]
    # the current folder comes before PYTHONPATH: it has to be that of the copy
    subprocess.run(command, env=environment, cwd=environment["PYTHONPATH"], check=True, capture_output=True)
    took_s = (time.time_ns() - began_ns) * 1e-9
    files = [path.stat() for path in cache.rglob("*.nbc")]
    return took_s, sum(file.st_mtime_ns >= began_ns for file in files), sum(file.st_size for file in files) / 1e6


if __name__ == "__main__":
    main()
