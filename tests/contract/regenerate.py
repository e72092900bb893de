"""All committed files that are made from the code: `make regenerate` writes them, `--check` names those that are stale.

    python tests/contract/regenerate.py            # write each file that differs, and print its name
    python tests/contract/regenerate.py --check    # write nothing; exit 1 and name each file that differs

A new kind of derived file is a function from the code to its text and one line in `of_everything` or `of_the_core`.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_DOUBLES = Path(__file__).resolve().parents[1] / "doubles"
_WITHOUT_PACKAGES = "TELENANO_WITHOUT_PACKAGES"


def of_everything() -> dict[Path, str]:
    """Return the path and the text of each file that does not depend on the packages that are installed."""
    import command_page
    import command_table
    import wire_contract

    from telenano.analysis.summary import markdown, summary_schema
    from telenano.settings.included import SCHEMA_DIRECTORY

    files = wire_contract.artefacts(ROOT)
    files[command_table.PAGE] = command_table.with_table(command_table.PAGE.read_text(encoding="utf-8"))
    files[command_page.PAGE] = command_page.with_page(command_page.PAGE.read_text(encoding="utf-8"))
    files[SCHEMA_DIRECTORY / "summary.json"] = json.dumps(summary_schema(), indent=2) + "\n"
    files[ROOT / "docs" / "summary.md"] = markdown()
    felt = importlib.import_module("telenano_lab.studies.pages.felt_page")
    files[ROOT / "packages" / "telenano-lab" / "docs" / "felt-measured.md"] = felt.markdown()
    return files


def of_the_core() -> dict[Path, str]:
    """Return the path and the text of each file that has the keys of an installation without packages."""
    import scenario_page

    from telenano.launcher.scenario_keys import scenario_schema, site_schema
    from telenano.settings.included import SCHEMA_DIRECTORY

    return {
        SCHEMA_DIRECTORY / "scenario.json": json.dumps(scenario_schema(), indent=2) + "\n",
        SCHEMA_DIRECTORY / "site.json": json.dumps(site_schema(), indent=2) + "\n",
        scenario_page.PAGE: scenario_page.page(),
    }


def files() -> dict[Path, str]:
    """Return the path and the text of each derived file; the keys of the core come from a process without packages."""
    program = "import json, regenerate; print(json.dumps({str(p): t for p, t in regenerate.of_the_core().items()}))"
    path = os.pathsep.join([str(Path(__file__).parent), str(_DOUBLES), str(ROOT)])
    environment = {**os.environ, _WITHOUT_PACKAGES: "1", "PYTHONPATH": path}
    with subprocess.Popen([sys.executable, "-c", program], env=environment, stdout=subprocess.PIPE, text=True) as core:
        found = of_everything()
        printed, _ = core.communicate()
    if core.returncode:
        raise SystemExit(core.returncode)
    return found | {Path(name): text for name, text in json.loads(printed).items()}


def stale(made: dict[Path, str]) -> list[Path]:
    """Return the files that are missing, differ, or describe a message that is gone."""
    wrong = [path for path, text in made.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    return sorted({*wrong, *set((ROOT / "proto" / "schemas").glob("*")) - made.keys()})


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the derived files, or only name those that are stale; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is stale")
    is_check = parser.parse_args(arguments).check
    made = files()
    for path in (wrong := stale(made)):
        name = path.relative_to(ROOT)
        if is_check:
            sys.stderr.write(f"{name} is not what the code makes: run `make regenerate` and read the difference\n")
        elif path in made:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(made[path], encoding="utf-8")
            sys.stdout.write(f"wrote {name}\n")
        else:
            path.unlink()
            sys.stdout.write(f"removed {name}: its message is gone\n")
    return 1 if is_check and wrong else 0


if __name__ == "__main__":
    sys.path[:0] = [str(_DOUBLES)]
    sys.exit(main())
