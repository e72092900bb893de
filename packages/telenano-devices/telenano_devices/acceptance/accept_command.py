"""`telenano device accept`: judges a device or an instrument by one motion of a minute."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import JsonOption, Keys, Void, print_json, print_rows, report_errors, results_in, rules, run_ahead
from telenano.settings import flag_overrides
from telenano.wire import ConfigError

if TYPE_CHECKING:
    from telenano_devices.acceptance.take import Guide, Kind, Step, Take, Verdict

_NOT_ACCEPTED = 1
SettingsOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="A key of haptic_node.* or afm_node.* (repeat)."),
]
MassOption = Annotated[
    float, typer.Option("--mass", min=0.0, max=5.0, metavar="KG", help="Mass to hang at the handle [kg]; 0: none.")
]
StopOption = Annotated[
    str, typer.Option("--independent-stop", metavar="TEXT", help="How the drives are stopped without the computer.")
]


@rules(
    Void(
        "--device, --set, --mass, --independent-stop, --calibration, --fault",
        "whose take was recorded before",
        beside="--from",
    ),
    Void(
        "--device, --mass, --independent-stop, --fault",
        "the instrument that is judged instead of a device for the hand",
        beside="--calibration, --set afm_node.*",
    ),
    Keys("--device", "haptic_node.driver"),
)
def accept(
    driver: Annotated[
        str, typer.Option("--device", metavar="DRIVER", help="Value of haptic_node.driver: the device to judge.")
    ] = "simulated_impedance",
    settings: SettingsOption = None,
    mass: MassOption = 0.0,
    stop: StopOption = "",
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", metavar="FILE", help="Calibration of an instrument: it is judged instead."),
    ] = None,
    taken: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Judge this recorded take instead of making one.")
    ] = None,
    faults: Annotated[
        list[str] | None,
        typer.Option("--fault", metavar="NAME=VALUE", help="Put a fault into the simulated device (repeat)."),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the take, the page and the verdicts.")
    ] = Path("out/accept"),
    as_json: JsonOption = False,
) -> None:
    """Lead through a motion of one minute, and report each check: pass, fail, retake or cannot say.

    A device is driven in the step *hold*: keep a hand at its independent stop. An instrument (--calibration, or a key
    afm_node.*) approaches its sample behind the guard. The exit code is 1 if a check fails or asks for a retake.
    """
    with report_errors(as_json):
        from telenano_devices.acceptance.haptic_device.checks import HAPTIC_DEVICE
        from telenano_devices.acceptance.instrument.checks import INSTRUMENT
        from telenano_devices.acceptance.take import SILENT, Guide, overall, read_take

        kind: Kind[Any]
        take: Take[Any]
        overrides, guide = flag_overrides(settings or []), SILENT if as_json else Guide(_tell)
        if taken is not None:
            kind, take = read_take(taken, HAPTIC_DEVICE, INSTRUMENT)
        elif calibration is not None or "afm_node" in overrides:
            kind, take = INSTRUMENT, _take_of_instrument(calibration, section_named(overrides, "afm_node"), guide)
        else:
            section = {"driver": driver} | section_named(overrides, "haptic_node")
            kind, take = HAPTIC_DEVICE, _take_of_device(section, mass, stop, faults or [], guide)
        verdicts = kind.judge(take)
        result, identity = overall(verdicts), take.facts.identity
        document = {
            "result": result,
            "device": identity,
            "seconds": take.seconds,
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
        print_rows([verdict._asdict() for verdict in verdicts])
        typer.echo(f"{result}: {identity}; page, take and verdicts are in {out}")
    if result != "pass":
        raise typer.Exit(_NOT_ACCEPTED)


def _tell(step: "Step") -> None:
    typer.echo(f"{step.seconds:4.0f} s  {step.name}: {step.prompt}")


def section_named(document: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the keys of a section; raise ConfigError, with its name, if there is another section."""
    if other := sorted(set(document) - {name}):
        raise ConfigError(f"--set {other[0]}: only keys {name}.* can be set here")
    section: dict[str, Any] = document.get(name, {})
    return section


def _take_of_instrument(calibration: Path | None, section: dict[str, Any], guide: "Guide") -> "Take[Any]":
    from telenano_devices.acceptance.instrument.instruments import config_of, make_take

    config = config_of(calibration, section)
    if config.driver != "simulated":
        # A guard takes a pause of this process for its death and retracts the tip.
        run_ahead()
    return make_take(config, guide)


def _take_of_device(section: dict[str, Any], mass: float, stop: str, faults: list[str], guide: "Guide") -> "Take[Any]":
    import yaml

    from telenano.sections import HapticConfig
    from telenano.settings import validate
    from telenano_devices.acceptance.haptic_device.devices import make_take

    config = validate(HapticConfig, section, "--set", "haptic_node")
    wrong = {name: yaml.safe_load(value) for name, _, value in (fault.partition("=") for fault in faults)}
    return make_take(config, mass, stop, faults=wrong, guide=guide)


def _page(take: "Take[Any]", verdicts: "list[Verdict]", result: str) -> Any:
    from telenano.analysis import Page

    page = Page(f"Acceptance of {take.facts.identity}: {result}")
    page.paragraph(
        f"{len(take.rows)} rows in {take.seconds:.0f} s, judged from this one take. "
        "The tolerances are provisional until takes of real devices are there."
    )
    page.table(("check", "result", "found", "wanted"), verdicts)
    for heading, text, values in take.facts.tables():
        page.heading(heading)
        if text:
            page.paragraph(text)
        page.table(("what", "value"), [(name, str(value)) for name, value in values.items()])
    page.heading("The motion")
    page.table(("step", "seconds", "what was asked for", "driven"), take.steps)
    return page
