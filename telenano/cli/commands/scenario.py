"""`telenano scenario`: the known experiments, and the user's own files."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from telenano.cli.completion import scenario_names
from telenano.cli.options import JsonOption, SettingsOption, command_group
from telenano.cli.output import print_answer, report_errors
from telenano.files.atomic_files import atomic_file
from telenano.settings.config import read_yaml
from telenano.settings.included import find_scenario, scenarios
from telenano.wire.errors import ConfigError
from telenano.wire.printable import quoted

app = command_group()

NameArgument = Annotated[
    str, typer.Argument(metavar="NAME|FILE", help="A known name, or a YAML file.", autocompletion=scenario_names)
]


@app.command("list")
def list_all(as_json: JsonOption = False) -> None:
    """List the scenarios, those of installed packages included."""
    with report_errors(as_json):
        rows: list[dict[str, Any]] = []
        for name, path in sorted(scenarios().items()):
            document = read_yaml(path)
            rows.append(
                {"scenario": name, "duration_s": document.get("duration_s"), "about": document.get("description")}
            )
    print_answer({"scenarios": rows}, rows, as_json=as_json)


@app.command()
def show(name: NameArgument, as_json: JsonOption = False) -> None:
    """Print a scenario as its file has it; `param get` has every default in it."""
    with report_errors(as_json):
        path = find_scenario(name)
        document = read_yaml(path)
        text = path.read_text(encoding="utf-8").removesuffix("\n")
    print_answer(document, f"# {path}\n{text}", as_json=as_json)


@app.command()
def check(name: NameArgument, settings: SettingsOption = None, as_json: JsonOption = False) -> None:
    """Check a scenario with the models of all nodes; exit code 2 and a sentence for each key that is wrong."""
    with report_errors(as_json):
        # the models of all nodes take a second to import
        from telenano.launcher.plan import check_sections
        from telenano.settings.scenario import LoadedScenario

        loaded = LoadedScenario.load(find_scenario(name), settings or ())
        check_sections(loaded)
    document = {"scenario": loaded.scenario.name, "valid": True, "origin": loaded.origin}
    print_answer(document, f"{loaded.origin}: valid, {loaded.scenario.duration_s:g} s", as_json=as_json)


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the experiment: lower case, digits, _ and -.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="File to write; default: NAME.yaml.")
    ] = None,
    base: Annotated[
        str,
        typer.Option("--from", metavar="NAME|FILE", help="Scenario to begin with.", autocompletion=scenario_names),
    ] = "fig12",
    as_json: JsonOption = False,
) -> None:
    """Write a scenario file of your own, which an editor completes by its JSON Schema."""
    with report_errors(as_json):
        from telenano.settings.config import validate as validated
        from telenano.settings.included import SCHEMA_DIRECTORY
        from telenano.settings.scenario import Scenario

        path = out or Path(f"{name}.yaml")
        if path.exists():
            raise ConfigError(f"{path}: exists already; give another name or --out")
        document = {**read_yaml(find_scenario(base)), "name": name}
        validated(Scenario, document, str(path))
        head = f"# yaml-language-server: $schema={(SCHEMA_DIRECTORY / 'scenario.json').as_uri()}\n"
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100)
        with atomic_file(path, replace=False) as file:
            file.write_text(head + text, encoding="utf-8")
    given = quoted(path)
    text = f"{path}; next: telenano scenario check {given} && telenano up {given}"
    print_answer({"file": str(path)}, text, as_json=as_json)


@app.command()
def schema(
    site: Annotated[bool, typer.Option("--site", help="The schema of site files instead.")] = False,
) -> None:
    """Print the JSON Schema of scenario files, with the laws, devices and samples that are installed here."""
    with report_errors(as_json=False):
        from telenano.launcher.scenario_keys import scenario_schema, site_schema

        typer.echo(json.dumps(site_schema() if site else scenario_schema(), indent=2))
