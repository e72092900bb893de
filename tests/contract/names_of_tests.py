"""The contract of import-linter that no two modules of tests have one name."""

from collections import defaultdict
from pathlib import Path

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, output

ROOT = Path(__file__).resolve().parents[2]
# the modules that a run of all tests finds by their bare names
FOUND_BY_NAME = ("benchmarks/*.py", "tests/**/*.py", "packages/*/tests/**/*.py")
# pytest tells its own files apart by their folders, and a process gets the one `sitecustomize` of its path
ONE_A_FOLDER = {"__init__", "conftest", "sitecustomize"}


class NamesOfTests(Contract):
    """Each module of tests has a name of its own.

    Folders of tests are no packages, so that `make endurance`, which collects all of them in one process, imports the
    first module of a name and refuses the second. `make test` and `make check` collect them in parts.
    """

    type_name = "names_of_tests"

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        paths = defaultdict(list)
        for path in sorted(path for pattern in FOUND_BY_NAME for path in ROOT.glob(pattern)):
            if path.stem not in ONE_A_FOLDER:
                paths[path.stem].append(path.relative_to(ROOT).as_posix())
        found = [" and ".join(of_name) for of_name in paths.values() if len(of_name) > 1]
        return ContractCheck(kept=not found, metadata={"found": found})

    def render_broken_contract(self, check: ContractCheck) -> None:
        for text in check.metadata["found"]:
            output.print_error(f"{text} have one name: rename one of them.", bold=False)
