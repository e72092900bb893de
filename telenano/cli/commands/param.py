"""`telenano param`: the keys of all scenarios, and their values in one scenario."""

from typing import Annotated, Any

import typer
import yaml

from telenano.cli.completion import scenario_names, scenario_sections
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import JsonOption, SettingsOption, command_group
from telenano.cli.output import print_answer, report_errors
from telenano.settings.included import find_scenario
from telenano.wire.errors import ConfigError, probably_meant

app = command_group()

ScenarioOption = Annotated[
    str,
    typer.Option(
        "--scenario", metavar="NAME|FILE", help="Scenario whose values are shown.", autocompletion=scenario_names
    ),
]


@app.command("list")
@rules(Void("--all", "below which every key is listed", beside="PREFIX"))
def list_all(
    prefix: Annotated[
        str,
        typer.Argument(
            metavar="PREFIX", help="Only keys that begin so, such as delay_node.", autocompletion=scenario_sections
        ),
    ] = "",
    every: Annotated[bool, typer.Option("--all", help="List every key, not only those that are changed most.")] = (
        False
    ),
    as_json: JsonOption = False,
) -> None:
    """List the keys of a scenario with default, range and unit, which `--set` can change.

    Without PREFIX and --all these are the keys at the top of each section, and those that a packaged scenario changes.
    """
    with report_errors(as_json):
        from telenano.launcher.scenario_keys import all_keys, first_keys

        known = all_keys()
        keys = [key for key in known if key.name.startswith(prefix)] if prefix or every else first_keys(known)
        if not keys:
            parts = {".".join(key.name.split(".")[: prefix.count(".") + 1]) for key in known}
            near = probably_meant(prefix, parts)
            raise ConfigError(f"{prefix}: no key begins so{near}; `telenano param list --all` has them all")
    rows: list[dict[str, Any]] = [
        {
            "key": key.name,
            "type": key.kind,
            "default": key.default,
            "least": key.least,
            "most": key.most,
            "about": key.about,
        }
        for key in keys
    ]
    shown = [{key: value for key, value in row.items() if key != "type"} for row in rows]
    print_answer({"keys": rows}, shown, as_json=as_json)
    if not as_json and len(keys) < len(known) and not prefix:
        typer.echo(f"{len(known) - len(keys)} more: `telenano param list --all`, or `telenano param list afm_node`")


@app.command()
def get(
    key: Annotated[
        str | None, typer.Argument(metavar="KEY", help="Dotted key, or a section, such as controller.wave.")
    ] = None,
    scenario: ScenarioOption = "fig12",
    settings: SettingsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the value of a key in a scenario, its default where the scenario does not name it.

    Without KEY it prints the scenario with every default in it, as a YAML file that can be run.
    """
    with report_errors(as_json):
        value = _value(scenario, settings, key)
    print_answer(value if key is None else {"key": key, "value": value}, _yaml(value), as_json=as_json)


def _value(scenario: str, settings: list[str] | None, key: str | None) -> Any:
    from telenano.launcher.scenario_keys import filled, value_at, with_meant
    from telenano.settings.scenario import LoadedScenario

    document = filled(LoadedScenario.load(find_scenario(scenario), settings or ()))
    try:
        return document if key is None else value_at(document, key)
    except ConfigError as error:
        raise ConfigError(*map(with_meant, error.lines)) from error


def _yaml(value: Any) -> str:
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=100)
    return text.removesuffix("\n").removesuffix("\n...")
