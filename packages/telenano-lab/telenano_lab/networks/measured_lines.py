"""Fit the packaged networks that others measured, and hold each fit against the half it has not seen.

    python -m telenano_lab.networks.measured_lines FOLDER [NAME ...] [--out DIR] [--write]

FOLDER has the checkouts that `CAMPAIGNS` names, each under the name and at the commit there; nothing is fetched. Each
line is fitted by `telenano link fit`, whose table goes into DIR/acceptance.md, a row for each line, and whose digest is
printed. `--write`, in a checkout, puts the profiles, and the twins without memory, into telenano/settings/networks;
only derived parameters are in them.
"""

import argparse
import hashlib
import json
import shlex
import sys
from pathlib import Path
from typing import NamedTuple

from telenano.signals import run as run_child

PROFILES = Path("telenano") / "settings" / "networks"


class Campaign(NamedTuple):
    """Logs that others have published: the folder of the checkout, and the citation."""

    folder: str
    cite: str


class Line(NamedTuple):
    """A line: its campaign, patterns of its logs, further options, and a description."""

    campaign: str
    patterns: tuple[str, ...]
    options: tuple[str, ...]
    about: str
    has_twin: bool = False


CAMPAIGNS = {
    "cicv5g": Campaign(
        "CICV5G",
        "X. Zhang et al., 5G communication delay dataset for cloud-based vehicle planning and control, Zenodo, doi"
        " 10.5281/zenodo.17475688, 2025 (repository zxr805/CICV5G, commit ea215aa9, measured in 2024; CC BY 4.0)",
    ),
    "nuwins": Campaign(
        "starlink-measurement",
        "NUWiNS, Northeastern University, ping on a drive through Maine, 27 to 30 May 2024 (repository"
        " NUWiNS/starlink-measurement, commit 4beb9fa1; no licence stated, so that derived parameters alone are here)",
    ),
    "det6g": Campaign(
        "deterministic6g_data",
        "DETERMINISTIC6G project, delay measurements (repository DETERMINISTIC6G/deterministic6g_data, commit 694effc0,"
        " of 9 September 2025; ",
    ),
}
CUMUCORE = "Cumucore, edge cloud delay measurements, ProcessingDelayDistribution1, CC BY-ND 4.0)"
URLLC = "PD-Wireless-5G-3a, CC BY-ND 4.0)"
URBAN = "data/Urban road"
PINGED = "ProcessingDelayDistribution1/raw/mmWave_delay"
LINES = {
    "cicv5g_n78_urban": Line(
        "cicv5g",
        tuple(f"{URBAN}/2-n78/{speed}" for speed in ("v20/*run0?.txt", "v30/*run0?.txt", "v40/west*.txt")),
        ("--round-trip",),
        "public 5G (n78) from a car in a city, 20 to 40 km/h, measured",
    ),
    "cicv5g_n78_arterial": Line(
        "cicv5g",
        ("data/Arterial road/n78/*/*.txt",),
        ("--round-trip",),
        "public 5G (n78) from a car on an arterial road, 50 to 80 km/h, measured",
        True,
    ),
    "cicv5g_n8_urban": Line(
        "cicv5g",
        tuple(f"{URBAN}/1-n8/{speed}/*run0?.txt" for speed in ("v20", "v30", "v40")),
        ("--round-trip",),
        "private 5G (n8) from a car in a city, 20 to 40 km/h, measured",
    ),
    "cicv5g_n8_arterial": Line(
        "cicv5g",
        tuple(f"data/Arterial road/n8/{speed}/*run0?.txt" for speed in ("v50", "v60", "v70", "v80")),
        ("--round-trip",),
        "private 5G (n8) from a car on an arterial road, 50 to 80 km/h, measured",
    ),
    **{
        f"{short}_driving": Line(
            "nuwins",
            (f"datasets/maine_starlink_trip/{short}/*/*/ping_*.out",),
            (),
            f"{name} from a car on a country road and in towns, measured",
            True,
        )
        for short, name in (
            ("starlink", "Starlink"),
            ("att", "LTE and 5G of AT&T"),
            ("verizon", "LTE and 5G of Verizon"),
        )
    },
    **{
        f"private_5g_{kind}": Line(
            "det6g", (f"{PINGED}/ping-cloud-{kind}.txt",), (), f"private 5G ({text}) to a public cloud, measured"
        )
        for kind, text in (("cmWave", "below 6 GHz"), ("mmWave", "millimetre waves"))
    },
    "urllc_mmwave": Line(
        "det6g",
        ("PD-Wireless-5G-3a/raw/5G-URLLC-mmW-Uplink_PD-Wireless-5G-3a.csv",),
        ("--histogram", "--unit", "ms"),
        "5G for low latency (URLLC) on millimetre waves, uplink, 32 bytes each 7 ms, measured",
    ),
}


def logs_of(line: Line, folder: Path) -> list[Path]:
    """Return the logs of a line, without those of a ping that did not start and has no packet."""
    campaign = folder / CAMPAIGNS[line.campaign].folder
    paths = sorted(path for pattern in line.patterns for path in campaign.glob(pattern))
    if not paths:
        sys.exit(f"{campaign}: has none of {', '.join(line.patterns)}; {CAMPAIGNS[line.campaign].cite}")
    return [path for path in paths if path.suffix != ".out" or "ping statistics" in path.read_text()]


def fitted(name: str, line: Line, folder: Path, out: Path, *extra: str) -> dict[str, object]:
    """Run `telenano link fit` and return the content of fit.json."""
    cite = CAMPAIGNS[line.campaign].cite
    if cite.endswith("; "):
        cite += URLLC if line.options else CUMUCORE
    patterns = " ".join(shlex.quote(pattern) for pattern in line.patterns)
    taken = " ".join(["telenano link fit", patterns, *line.options, *extra])
    logs = [str(path) for path in logs_of(line, folder)]
    about = line.about.replace("measured", "measured; each message drawn by itself") if extra else line.about
    command = [
        sys.executable,
        "-m",
        "telenano",
        "link",
        "fit",
        *logs,
        *line.options,
        *extra,
        "--anyway",
        "--out",
        str(out / name),
    ]
    done = run_child(
        [*command, "--about", about, "--cite", cite, "--taken", taken], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        sys.exit(f"{name}: {done.stderr.strip()}")
    return dict(json.loads((out / name / "fit.json").read_text(encoding="utf-8")))


def row(name: str, facts: dict[str, object]) -> str:
    """Return the row of a line: measured and generated value of each statistic, and whether they agree."""
    cells = [name]
    table = facts["agreement"]
    assert isinstance(table, list)
    if not table:
        return f"| {name} | no memory known |" + " – |" * 12
    for one in table:
        values = [one["measured"], one["generated"]]
        shown = " / ".join("–" if value is None else f"{float(f'{value:.3g}'):g}" for value in values)
        mark = "" if one["agrees"] else " **no**"
        # the star is escaped for Markdown
        cells.append(shown + (r"\*" if one["halves_differ"] else "") + mark)
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Fit the named lines, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", choices=[*LINES, []])
    parser.add_argument("--out", type=Path, default=Path("out/lines"))
    parser.add_argument("--write", action="store_true")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    heads = (
        "line", "q50", "q99", "q99.9 [ms]", "neighbours", "stalls/min", "stall [ms]", "in one go", "lost", "at 1 s",
        "at 10 s", "at 60 s", "windows with a fifth lost", "deviation of windows",
    )  # fmt: skip
    table = chosen.out / "acceptance.md"
    rows = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for name in chosen.names or LINES:
        line = LINES[name]
        rows.append(row(name.lower(), fitted(name.lower(), line, chosen.folder, chosen.out)))
        sys.stdout.write(f"{rows[-1]}\n")
        names = [name.lower()]
        if line.has_twin:
            names.append(f"{name}_no_memory")
            fitted(names[-1], line, chosen.folder, chosen.out, "--without-memory")
        for made in names if chosen.write else ():
            (PROFILES / f"{made}.yaml").write_bytes((chosen.out / made / "profile.yaml").read_bytes())
        table.write_text("\n".join([*rows, ""]), encoding="utf-8")
    sys.stdout.write(f"digest: {hashlib.sha256(table.read_bytes()).hexdigest()}\n")


if __name__ == "__main__":
    main()
