"""`telenano experiment plan`: the number of people and trials that an effect needs."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import JsonOption, print_json, print_rows, report_errors
from telenano.wire import ConfigError, known_names
from telenano_lab.experiments.plans import find_experiment

if TYPE_CHECKING:
    from telenano_lab.experiments.plan import Plan
    from telenano_lab.experiments.power import Levels

# Numbers of trials per condition that are shown beside that of the plan.
_TRIALS = (1, 2, 5, 10, 20)


def plan(
    file: Annotated[str, typer.Argument(metavar="NAME|FILE", help="The experiment: a known name or a YAML file.")],
    effect: Annotated[
        float,
        typer.Option(
            "--effect",
            metavar="D",
            min=0.001,
            help="Difference of the extreme levels (or of such differences) that is to be found, in standard "
            "deviations of one person's trials in one condition.",
        ),
    ],
    spread: Annotated[
        float | None,
        typer.Option(
            "--spread",
            metavar="S",
            min=0.0,
            help="Standard deviation of people's own effects, in the same unit; default: half the effect.",
        ),
    ] = None,
    power: Annotated[
        float,
        typer.Option(
            "--power", metavar="P", min=0.06, max=0.999, help="Power: probability of finding the effect, below 1."
        ),
    ] = 0.8,
    category: Annotated[
        list[str] | None,
        typer.Option("--category", metavar="FACTOR", help="Numeric factor to treat as categories (repeatable)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say how many people and trials an effect needs, of each factor and interaction, before anybody is asked.

    The test is that of `analyse` at p < 0.05, before the correction for several tests.
    """
    with report_errors(as_json):
        from telenano_lab.experiments.plan import load_plan
        from telenano_lab.experiments.power import MOST_PEOPLE, expected

        plan_loaded = load_plan(find_experiment(file))
        factors = _factors(plan_loaded, tuple(category or ()))
        people, own = (
            len(plan_loaded.experiment.pseudonyms),
            plan_loaded.experiment.repetitions * plan_loaded.experiment.sessions,
        )
        # A threshold is one value per condition, however many trials it takes.
        counts = (1,) if plan_loaded.adaptive else tuple(sorted({own, *_TRIALS}))
        differ = 0.5 * effect if spread is None else spread
        rows: list[dict[str, Any]] = [
            {
                "term": term.term,
                "power_of_the_plan": round(term.power(people, 1 if plan_loaded.adaptive else own, effect, differ), 4),
                "people": {str(trials): term.people(power, trials, effect, differ) for trials in counts},
            }
            for term in expected(factors)
        ]
    if as_json:
        print_json(
            {"participants": people, "trials": own, "effect": effect, "spread": differ, "power": power, "terms": rows}
        )
        return
    typer.echo(
        f"an effect of {effect:g}, in which people differ by {differ:g} (standard deviations of one person's trials): "
        f"people for a power of {power:g}, by the number of trials in a condition"
    )
    print_rows(
        [
            {
                "term": row["term"],
                f"power with {people} x {own}": f"{row['power_of_the_plan']:.2f}",
                **{
                    f"{trials} trial{'s' if trials != '1' else ''}": f"> {MOST_PEOPLE}"
                    if needed is None
                    else str(needed)
                    for trials, needed in row["people"].items()
                },
            }
            for row in rows
        ]
    )


def _factors(plan: "Plan", categories: tuple[str, ...]) -> "list[Levels]":
    from telenano_lab.experiments.power import Levels

    factors = []
    for name in categories:
        if name not in plan.experiment.factors:
            raise ConfigError(f"--category: factor {name}: {known_names(name, plan.experiment.factors)}")
    for name, factor in plan.experiment.factors.items():
        levels = factor.names
        if name == plan.adaptive or len(levels) < 2:
            continue
        numbers = [float(level) for level in levels if isinstance(level, int | float) and not isinstance(level, bool)]
        is_numeric = len(numbers) == len(levels) and name not in categories
        factors.append(
            Levels(name, tuple(sorted(numbers)) if is_numeric else tuple(map(float, range(len(levels)))), is_numeric)
        )
    if not factors:
        raise ConfigError(f"{plan.path}: factors: none has two levels, so there is no effect to plan for")
    return factors
