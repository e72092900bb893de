"""`telenano device accept`: one motion of a minute, and what it shows of a device that takes a force."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli.options import JsonOption
from telenano.cli.output import print_json, print_rows, report_errors
from telenano.cli.sample_options import results_in

if TYPE_CHECKING:
    from services.haptic_node.acceptance.checks import Verdict
    from services.haptic_node.acceptance.take import Step, Take

_NOT_ACCEPTED = 1


def accept(
    driver: Annotated[
        str, typer.Option("--device", metavar="DRIVER", help="Value of haptic_node.driver: the device to judge.")
    ] = "simulated_impedance",
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A key of haptic_node.* (repeat).")
    ] = None,
    mass: Annotated[
        float, typer.Option("--mass", min=0.0, max=5.0, metavar="KG", help="Mass to hang at the handle; 0: none.")
    ] = 0.0,
    stop: Annotated[
        str,
        typer.Option("--independent-stop", metavar="TEXT", help="How the drives are stopped without the computer."),
    ] = "",
    taken: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Judge this take again in the place of a new one.")
    ] = None,
    faults: Annotated[
        list[str] | None,
        typer.Option("--fault", metavar="NAME=VALUE", help="Put a fault into the simulated device (repeat)."),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the take, the page and the verdicts.")
    ] = Path("accept"),
    as_json: JsonOption = False,
) -> None:
    """Lead through a motion of a minute, and tell of each of 25 checks: pass, fail, retake or cannot say.

    The device is driven in the step *hold*: keep a hand at its independent stop. The exit code is 1 if a check fails
    or asks for the motion once more.
    """
    with report_errors(as_json):
        from services.haptic_node.acceptance.checks import overall, verdicts_of
        from services.haptic_node.acceptance.take import read_take

        if taken is not None:
            take = read_take(taken)
        else:
            take = _new_take(driver, settings or [], (mass, stop), faults or [], quiet=as_json)
        verdicts = verdicts_of(take)
        result = overall(verdicts)
        document = {
            "result": result,
            "device": take.device.identity,
            "seconds": round(sum(step.seconds for step in take.steps), 3),
            "checks": [verdict._asdict() for verdict in verdicts],
            "files": str(out),
        }
        with results_in(out) as folder:
            take.save(folder / "take.npz")
            (folder / "accept.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
            _page(take, verdicts, result).write(folder / "accept.html")
    if as_json:
        print_json(document)
    else:
        print_rows([{"check": v.check, "result": v.result, "found": v.found, "wanted": v.wanted} for v in verdicts])
        typer.echo(f"{result}: {take.device.identity}; page, take and verdicts are in {out}")
    if result != "pass":
        raise typer.Exit(_NOT_ACCEPTED)


def _new_take(driver: str, settings: list[str], said: tuple[float, str], faults: list[str], *, quiet: bool) -> "Take":
    import yaml

    from services.haptic_node.acceptance.devices import Circumstances, make_take
    from services.haptic_node.acceptance.take import steps_of
    from services.haptic_node.config import HapticConfig
    from services.runtime.settings.config import flag_overrides, validate

    chosen = flag_overrides([f"haptic_node.driver={driver}", *settings])
    config = validate(HapticConfig, chosen.get("haptic_node", {}), "--set", "haptic_node")
    wrong = {name: yaml.safe_load(value) for name, _, value in (fault.partition("=") for fault in faults)}
    wrong = {name: tuple(value) if isinstance(value, list) else value for name, value in wrong.items()}

    def say(step: "Step") -> None:
        if not quiet:
            typer.echo(f"{step.seconds:4.0f} s  {step.name}: {step.prompt}")

    return make_take(config, steps_of(said[0]), Circumstances(*said), say, wrong)


def _page(take: "Take", verdicts: "list[Verdict]", result: str) -> Any:
    from services.haptic_node.coupling import passive_stiffness_n_per_m, stable_stiffness_n_per_m
    from studies.pages.page import Page

    device, k, b = take.device, take.settings.stiffness_n_per_m[2], take.settings.damping_n_s_per_m[2]
    timing = device.damping_n_s_per_m, b, 1.0 / device.rate_hz, device.drive_delay_s
    page = Page(f"Acceptance of {take.device.identity}: {result}")
    page.paragraph(
        f"{len(take.rows)} rows in {sum(step.seconds for step in take.steps):.0f} s, judged from this one take. "
        "The tolerances are provisional until takes of real devices are there."
    )
    page.table(("check", "result", "found", "wanted"), verdicts)
    page.heading("What was declared")
    page.table(("what", "value"), [(name, str(value)) for name, value in take.device._asdict().items()])
    page.heading("The coupling")
    page.paragraph(
        f"K = {k:.4g} N/m, B = {b:.4g} N s/m; passive up to {passive_stiffness_n_per_m(*timing):.4g} N/m, stable up to "
        f"{stable_stiffness_n_per_m(*timing):.4g} N/m. What the check of the rendering stiffness found is a K for "
        "haptic_node.coupling.stiffness_n_per_m, with a margin of your own."
    )
    page.table(("what", "value"), [(name, str(value)) for name, value in take.settings._asdict().items()])
    page.heading("The motion")
    page.table(("step", "seconds", "what was asked for"), take.steps)
    return page
