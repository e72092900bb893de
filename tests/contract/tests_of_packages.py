"""The contract of import-linter that the tests of a package can leave with the package."""

from pathlib import Path

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, output

ROOT = Path(__file__).resolve().parents[2]
# the folders whose modules only the tests and programs of this repository find
FOLDERS = ("benchmarks", "docs", "examples", "packages/*/tests", "tests")


class TestsOfPackages(Contract):
    """Tests of a package import no module of a folder of tests or programs but those that lie beside them."""

    type_name = "tests_of_packages"

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        # A namespace, such as `tests.doubles`, is one of them as well.
        strange = {path.stem for folder in FOLDERS for path in ROOT.glob(f"{folder}/**/*.py")} | {"benchmarks", "tests"}
        found = []
        for module in sorted(graph.modules):
            if not module.startswith("packages."):
                continue
            beside = module.rpartition(".")[0]
            for imported in sorted(graph.find_modules_directly_imported_by(module)):
                name = imported.partition(".")[0]
                if name in strange and f"{beside}.{name}" not in graph.modules:
                    [row, *_] = graph.get_import_details(importer=module, imported=imported)
                    found.append(f"{module} (l.{row['line_number']}): {row['line_contents']}")
        return ContractCheck(kept=not found, metadata={"found": found})

    def render_broken_contract(self, check: ContractCheck) -> None:
        for text in check.metadata["found"]:
            output.print_error(text, bold=False)
        output.print_error(
            "Import what is named there from `telenano.testing` (docs/extending.md), or from a file beside the test.",
            bold=False,
        )
