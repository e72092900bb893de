"""`telenano law`: the laws that are installed, their parameters, and the rules that they keep or break."""

import sys
from typing import Annotated, Any

import typer

from telenano.cli.completion import law_name
from telenano.cli.exit_codes import EXIT_FAILED
from telenano.cli.options import JsonOption, command_group
from telenano.cli.output import print_document, print_json, print_rows, report_errors, say

app = command_group()
_OWN = "telenano"

LawArgument = Annotated[
    str, typer.Argument(metavar="LAW", help="Name of a law, as `law list` gives it.", autocompletion=law_name)
]


@app.command("list")
def list_laws(as_json: JsonOption = False) -> None:
    """List the laws, those of installed packages included, and the reason why one cannot be used."""
    with report_errors(as_json):
        from telenano.sections.controller_section import LAWS, PACKAGE_LAWS

        rows = [{"law": name, **_origin(name), "about": _about(law)} for name, law in LAWS.items()]
        problems = dict(PACKAGE_LAWS.problems)
    if as_json:
        print_json({"laws": rows, "problems": problems})
        return
    print_rows(rows)
    for text in problems.values():
        say(text)


@app.command()
def show(law: LawArgument, as_json: JsonOption = False) -> None:
    """Show the properties of a law, and its parameters with default, range and unit."""
    with report_errors(as_json):
        from telenano.sections.controller_section import LAWS

        row = LAWS[law]
        properties: dict[str, Any] = row.config.model_json_schema()["properties"]
        parameters = [
            {
                "parameter": f"controller.{law}.{name}",
                "default": schema.get("default"),
                "least": schema.get("minimum"),
                "most": schema.get("maximum"),
                "about": schema.get("description", ""),
            }
            for name, schema in properties.items()
        ]
        says = {
            "closes_a_loop_through_the_instrument": row.link_loop,
            "states_passivity": row.passive,
            "passive_within_j": row.passive_within_j if row.passive else None,
            "must_know": list(row.must_know),
        }
        facts = {"law": law, **_origin(law), "about": _about(row), **says}
    if as_json:
        print_json({**facts, "parameters": parameters})
        return
    print_document(facts, law, as_json=False)
    print_rows(parameters)


@app.command()
def check(law: LawArgument, as_json: JsonOption = False) -> None:
    """Check the rules that the rig relies on; exit code 1 and a sentence for each that the law breaks."""
    with report_errors(as_json):
        from telenano.lockstep.law_rules import LATE_PERIODS, broken_rules
        from telenano.sections.controller_section import LAWS, ControllerConfig

        law = LAWS[law].name
        if not as_json:
            typer.echo(
                "checking the rules; the first time needs a minute or less, because the steps are compiled", err=True
            )
        broken = broken_rules(law)
        limit_of = ControllerConfig(law=law).stiffness_limit_n_per_m
        limit, *behind = map(limit_of, range(LATE_PERIODS + 1))
        uneven = [limit_of(late, even=False) for late in range(LATE_PERIODS + 1)]
    if as_json:
        limits = {"stiffness_limit_n_per_m": limit, "late_stiffness_limits_n_per_m": behind}
        document = {"law": law, "rules": broken, "keeps_all": not any(broken.values()), **limits}
        print_json(document | {"uneven_stiffness_limits_n_per_m": uneven})
    else:
        if limit is not None:
            late, lossy = (", ".join(f"{value:.4g}" for value in values) for values in (behind, uneven))
            typer.echo(
                f"tolerates samples of up to {limit:.4g} N/m; {late} N/m, the instrument 1 to {LATE_PERIODS} ms late,"
            )
            typer.echo(
                f"over a line that loses or delays signals {lossy} N/m, the instrument 0 to {LATE_PERIODS} ms late"
            )
        for rule, faults in broken.items():
            typer.echo(f"{'broken' if faults else 'kept  '}  {rule}")
            for fault in faults:
                typer.echo(f"        {fault}")
        count = sum(map(bool, broken.values()))
        typer.echo(f"{law} breaks {count} of {len(broken)} rules" if count else f"{law} keeps all {len(broken)} rules")
    if any(broken.values()):
        raise typer.Exit(EXIT_FAILED)


def _origin(name: str) -> dict[str, str]:
    from telenano.sections.controller_section import OWN_LAWS
    from telenano.settings.plugins import installed

    if name in OWN_LAWS:
        return {"package": _OWN, "version": "", "digest": ""}
    return installed("laws")[name].facts()


def _about(law: Any) -> str:
    """Return the first sentence of the module that defines a law."""
    text = (sys.modules[law.master_receive.__module__].__doc__ or "").strip()
    return " ".join(text.split("\n\n")[0].split()).split(": ")[0]
