"""The contract of import-linter that the tests of a package can leave with the package, and the core's without it."""

import ast
from collections.abc import Iterator
from pathlib import Path

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, output

ROOT = Path(__file__).resolve().parents[2]
# the folders whose modules only the tests and programs of this repository find
OF_CORE = ("benchmarks", "docs", "examples", "tests")
OF_PACKAGES = "packages/*/tests"


class TestsOfPackages(Contract):
    """Tests import no module of a folder of tests or programs of others.

    Those of a package import only what lies beside them, and those of the core nothing that lies in the tests of a
    package.
    """

    type_name = "tests_of_packages"

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        found = [*_of_packages(graph), *_of_core()]
        return ContractCheck(kept=not found, metadata={"found": found})

    def render_broken_contract(self, check: ContractCheck) -> None:
        for text in check.metadata["found"]:
            output.print_error(text, bold=False)
        output.print_error(
            "Import what is named there from `telenano.testing` (telenano/testing/README.md), from a folder `doubles` "
            "that a package has among its modules, or from a file beside the test.",
            bold=False,
        )


def _modules(*folders: str) -> set[str]:
    return {path.stem for folder in folders for path in ROOT.glob(f"{folder}/**/*.py")}


def _of_packages(graph: ImportGraph) -> Iterator[str]:
    # A namespace, such as `tests.doubles`, is one of them as well.
    strange = _modules(*OF_CORE, OF_PACKAGES) | {"benchmarks", "tests"}
    for module in sorted(graph.modules):
        if not module.startswith("packages."):
            continue
        beside = module.rpartition(".")[0]
        for imported in sorted(graph.find_modules_directly_imported_by(module)):
            name = imported.partition(".")[0]
            if name in strange and f"{beside}.{name}" not in graph.modules:
                [row, *_] = graph.get_import_details(importer=module, imported=imported)
                yield f"{module} (l.{row['line_number']}): {row['line_contents']}"


def _of_core() -> Iterator[str]:
    # The folders of the core are no packages with an `__init__`, which the graph would need.
    strange = (_modules(OF_PACKAGES) - _modules(*OF_CORE)) | {"packages"}
    for folder in OF_CORE:
        for path in sorted(ROOT.glob(f"{folder}/**/*.py")):
            source = path.read_text("utf-8")
            for node in ast.walk(ast.parse(source)):
                match node:
                    case ast.Import():
                        names = [alias.name for alias in node.names]
                    case ast.ImportFrom(module=str(name), level=0):
                        names = [name]
                    case _:
                        continue
                if any(name.partition(".")[0] in strange for name in names):
                    yield f"{path.relative_to(ROOT)} (l.{node.lineno}): {ast.get_source_segment(source, node)}"
