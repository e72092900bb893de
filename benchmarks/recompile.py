"""What an edit costs: functions compiled again, and time of a small study, after edits in a copy of the sources.

python benchmarks/recompile.py
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from telenano.signals import children

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("services", "telenano", "packages/telenano-lab/telenano_lab")
STUDY = (
    *("study", "stability", "--law", "virtual_impedance", "--environment", "tip_sample", "--stiffness", "40"),
    *("--delay", "0,20", "--duration", "4.7", "--workers", "1", "--json", "--out"),
)
# Each edit: its name, the file, a text in it, and the text that replaces it.
LAW = "telenano/laws/virtual_impedance.py"
MODEL = "telenano/afm/contact/lennard_jones.py"
FIGURES = "telenano_lab/studies/pages/figures.py"
EDITS = (
    ("nothing", LAW, "", ""),
    ("a comment in the figures of studies", FIGURES, '"""\n\nfrom', '"""\n\n# a comment\nfrom'),
    ("the law of the study", LAW, "- scaled_force\n", "- 1.0 * scaled_force\n"),
    ("a model of the instrument", MODEL, "q8 = q2 * q2", "q8 = 1.0 * q2 * q2"),
)


def main() -> None:
    """Print a row for each edit."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--smoke", action="store_true", help="the first edit only")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        sources, cache = Path(folder) / "sources", Path(folder) / "cache"
        for name in PACKAGES:
            ignored = shutil.ignore_patterns("node_modules", "dist", "__pycache__")
            shutil.copytree(ROOT / name, sources / Path(name).name, ignore=ignored)
        environment = {**os.environ, "PYTHONPATH": str(sources), "XDG_CACHE_HOME": str(cache)}
        cold_s, compiled, _ = study(environment, Path(folder) / "cold")
        rows.append({"what": "cold", "compiled": compiled, "share": 1.0, "time_s": cold_s})
        for number, (what, file, old, new) in enumerate(EDITS[: 1 if given.smoke else None]):
            path = sources / file
            text = path.read_text()
            assert old in text, (file, old)
            path.write_text(text.replace(old, new, 1))
            took_s, compiled, size_mb = study(environment, Path(folder) / str(number))
            rows.append({"what": what, "compiled": compiled, "share": took_s / cold_s, "time_s": took_s, "mb": size_mb})
    if given.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        kept = f", {row['mb']:.0f} MB kept" if "mb" in row else ""
        share = f"{row['share']:.2f} of the time ({row['time_s']:.1f} s)"
        print(f"{row['what']:40s} {row['compiled']:4d} functions compiled, {share}{kept}")


def study(environment: dict[str, str], out: Path) -> tuple[float, int, float]:
    """Return the time of a study [s], the number of functions that it compiled, and the size of the cache [MB]."""
    cache = Path(environment["XDG_CACHE_HOME"])
    began_ns = time.time_ns()
    command = [sys.executable, "-m", "telenano", *STUDY, str(out)]
    children.run(command, env=environment, check=True, capture_output=True)
    took_s = (time.time_ns() - began_ns) * 1e-9
    files = [path.stat() for path in cache.rglob("*.nbc")]
    return took_s, sum(file.st_mtime_ns >= began_ns for file in files), sum(file.st_size for file in files) / 1e6


if __name__ == "__main__":
    main()
