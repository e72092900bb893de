"""`telenano law balance`: the energy that a law generates at its two ports, by kind of transition."""

from itertools import product
from typing import Annotated, Any

import typer

from telenano.cli import JsonOption, print_json, report_errors
from telenano.sections import LAWS
from telenano.testing.law_balance.balance import Balance, states_passivity, worst_balances
from telenano.testing.law_balance.balance_draws import ALL_KINDS
from telenano.wire import ConfigError, TelenanoError

# A law, a kind of transition, and the results of its draws, the worst first.
Row = tuple[str, str, list[Balance]]


def law_balance(
    laws: Annotated[list[str], typer.Argument(metavar="LAW...", help="Names of laws, as `law list` gives them.")],
    cases: Annotated[int, typer.Option("--cases", min=1, metavar="N", help="Draws of each kind.")] = 8,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Seed of the draws.")] = 1,
    longest: Annotated[
        float, typer.Option("--longest", min=5.0, metavar="S", help="Longest sequence, in the time of the rig [s].")
    ] = 60.0,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help=f"One of: {', '.join(ALL_KINDS)}; default: all.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run random sequences of events against laws, and print the energy that each generates.

    The exit code is 1 if a law that states passivity gives out more energy than came in and was granted.
    """
    with report_errors(as_json):
        kinds = tuple(kind or ALL_KINDS)
        if unknown := [name for name in kinds if name not in ALL_KINDS]:
            raise ConfigError(f"--kind {unknown[0]}: known are {', '.join(ALL_KINDS)}")
        for name in laws:
            states_passivity(LAWS[name])
        rows: list[Row] = []
        if not as_json:
            typer.echo(_head(laws))
        for name, one in product(laws, kinds):
            rows.append((name, one, _run(name, one, seed, cases, longest)))
            if not as_json:
                typer.echo(_line(_facts(*rows[-1]), laws))
    broken = [row for row in rows if states_passivity(LAWS[row[0]]) and not row[2][0].is_kept]
    if as_json:
        print_json({"kept": not broken, "rows": [_facts(*row) for row in rows]})
    else:
        _print_findings(rows, broken)
    if broken:
        raise typer.Exit(1)


def _run(name: str, kind: str, seed: int, cases: int, longest_s: float) -> list[Balance]:
    try:
        return worst_balances(LAWS[name], [kind], seed=seed, cases=cases, longest_s=longest_s)[kind]
    except (ArithmeticError, ValueError) as error:
        raise TelenanoError(f"law {name}, {kind}: fails: {type(error).__name__}: {error}") from error


def _facts(name: str, kind: str, balances: list[Balance]) -> dict[str, Any]:
    worst = balances[0]
    return {
        "law": name,
        "transition": kind,
        "draws": len(balances),
        "not_kept": sum(not one.is_kept for one in balances),
        "tolerance_mj": 1e3 * worst.tolerance_j,
        "worst_mj": 1e3 * worst.margin_j,
        "worst_at_reference_mj": 1e3 * min(one.reference_j for one in balances),
        "worst_unstated_mj": 1e3 * min(one.unstated_j for one in balances),
        "most_granted_mj": 1e3 * max(one.granted_j for one in balances),
        "refused": sum(one.refused for one in balances),
        "worst": worst.sentence(),
    }


def _head(laws: list[str]) -> str:
    law = f"{'law':{max(map(len, laws))}}"
    return f"{law}  {'transition':20}  broken   {'worst':>10}  {'at ref.':>10}  {'unstated':>10}  {'granted':>9}  [mJ]"


def _line(facts: dict[str, Any], laws: list[str]) -> str:
    return (
        f"{facts['law']:{max(map(len, laws))}}  {facts['transition']:20}  {facts['not_kept']:3d}/{facts['draws']:<3d}"
        f"  {facts['worst_mj']:10.3f}  {facts['worst_at_reference_mj']:10.3f}  {facts['worst_unstated_mj']:10.3f}"
        f"  {facts['most_granted_mj']:9.3f}"
    )


def _print_findings(rows: list[Row], broken: list[Row]) -> None:
    for name, _, balances in broken:
        typer.echo(f"{name}: {balances[0].sentence()}")
    for name in dict.fromkeys(row[0] for row in rows):
        lost = sum(row[0] == name for row in broken)
        kinds = sum(row[0] == name for row in rows)
        if not states_passivity(LAWS[name]):
            typer.echo(f"{name} does not claim passivity: its energy is shown, not judged")
        else:
            typer.echo(
                f"{name} makes energy at {lost} of {kinds} kinds of transition" if lost else f"{name} makes none"
            )
