"""`telenano device accept`: one motion of a minute, and what it shows of a device or an instrument."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from proto.errors import ConfigError
from telenano.cli.commands.device_files import run_ahead
from telenano.cli.options import JsonOption
from telenano.cli.output import print_json, print_rows, report_errors
from telenano.cli.sample_options import results_in

if TYPE_CHECKING:
    from services.haptic_node.acceptance.take import Take
    from services.numerics.acceptance import Step, Verdict

_NOT_ACCEPTED = 1


def accept(
    driver: Annotated[
        str, typer.Option("--device", metavar="DRIVER", help="Value of haptic_node.driver: the device to judge.")
    ] = "simulated_impedance",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A key of haptic_node.* or afm_node.* (repeat)."),
    ] = None,
    mass: Annotated[
        float, typer.Option("--mass", min=0.0, max=5.0, metavar="KG", help="Mass to hang at the handle; 0: none.")
    ] = 0.0,
    stop: Annotated[
        str,
        typer.Option("--independent-stop", metavar="TEXT", help="How the drives are stopped without the computer."),
    ] = "",
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", metavar="FILE", help="Calibration of an instrument: it is judged instead."),
    ] = None,
    taken: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Judge this take again in the place of a new one.")
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
    """Lead through a motion of a minute, and tell of each of its checks: pass, fail, retake or cannot say.

    A device is driven in the step *hold*: keep a hand at its independent stop. An instrument (--calibration, or a key
    afm_node.*) approaches its sample behind the guard. The exit code is 1 if a check fails or asks for the motion once
    more.
    """
    with report_errors(as_json):
        from services.numerics.acceptance import overall

        found = _judged(driver, settings or [], (mass, stop), calibration, taken, faults or [], quiet=as_json)
        result = overall(found.verdicts)
        document = {
            "result": result,
            "device": found.identity,
            "seconds": found.seconds,
            "checks": [verdict._asdict() for verdict in found.verdicts],
            "files": str(out),
        }
        with results_in(out) as folder:
            found.take.save(folder / "take.npz")
            (folder / "accept.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
            _page(found, result).write(folder / "accept.html")
    if as_json:
        print_json(document)
    else:
        shown = ("check", "result", "found", "wanted")
        print_rows([dict(zip(shown, verdict, strict=True)) for verdict in found.verdicts])
        typer.echo(f"{result}: {found.identity}; page, take and verdicts are in {out}")
    if result != "pass":
        raise typer.Exit(_NOT_ACCEPTED)


class _Judged(NamedTuple):
    """A take and what it shows: who the device is, how long it took [s], what was declared, tables of the page."""

    take: Any
    verdicts: "list[Verdict]"
    identity: str
    seconds: float
    steps: "tuple[Step, ...]"
    declared: dict[str, Any]
    tables: list[tuple[str, str, dict[str, Any]]]


def _judged(
    driver: str,
    settings: list[str],
    said: tuple[float, str],
    calibration: Path | None,
    taken: Path | None,
    faults: list[str],
    *,
    quiet: bool,
) -> _Judged:
    from services.afm_node.acceptance.take import ROW
    from services.numerics.acceptance import read_rows

    is_instrument = calibration is not None or any(each.startswith("afm_node.") for each in settings)
    if taken is not None:
        is_instrument = read_rows(taken)[0].dtype == ROW
    if is_instrument:
        if faults:
            raise ConfigError("--fault: faults are put into simulated_impedance; an emulated instrument has its own")
        return _judged_instrument(calibration, settings, taken, quiet=quiet)
    from services.haptic_node.acceptance.checks import verdicts_of
    from services.haptic_node.acceptance.take import read_take

    take = _new_take(driver, settings, said, faults, quiet=quiet) if taken is None else read_take(taken)
    seconds = round(sum(step.seconds for step in take.steps), 3)
    device = take.device
    tables = [("The coupling", _coupling_text(take), take.settings._asdict())]
    return _Judged(take, verdicts_of(take), device.identity, seconds, take.steps, device._asdict(), tables)


def _judged_instrument(calibration: Path | None, settings: list[str], taken: Path | None, *, quiet: bool) -> _Judged:
    from services.afm_node.acceptance.checks import verdicts_of
    from services.afm_node.acceptance.instruments import config_of, make_take
    from services.afm_node.acceptance.take import STEPS, read_take
    from services.runtime.settings.config import flag_overrides

    if taken is not None:
        take = read_take(taken)
    else:
        given = flag_overrides(settings)
        if other := sorted(set(given) - {"afm_node"}):
            raise ConfigError(f"--set {other[0]}: an instrument has keys afm_node.* only")
        config = config_of(calibration, given.get("afm_node", {}))
        if config.driver != "simulated":
            # a guard takes a pause of this process for its death
            run_ahead()
        take = make_take(config, _told(quiet=quiet))
    facts = take.facts._asdict()
    limits = [("The limits of the guard", "The motion went through them.", dict(facts.pop("limits")))]
    seconds = round(len(take.rows) * 1e-3 + take.facts.silent_s, 3)
    return _Judged(take, verdicts_of(take), take.facts.identity, seconds, STEPS, facts, limits)


def _told(*, quiet: bool) -> "Callable[[Step], None]":
    """Return what tells a person of each step of a motion as it begins."""

    def say(step: "Step") -> None:
        if not quiet:
            typer.echo(f"{step.seconds:4.0f} s  {step.name}: {step.prompt}")

    return say


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

    return make_take(config, steps_of(said[0]), Circumstances(*said), _told(quiet=quiet), wrong)


def _coupling_text(take: "Take") -> str:
    from services.haptic_node.coupling import passive_stiffness_n_per_m, stable_stiffness_n_per_m

    device, k, b = take.device, take.settings.stiffness_n_per_m[2], take.settings.damping_n_s_per_m[2]
    timing = device.damping_n_s_per_m, b, 1.0 / device.rate_hz, device.drive_delay_s
    return (
        f"K = {k:.4g} N/m, B = {b:.4g} N s/m; passive up to {passive_stiffness_n_per_m(*timing):.4g} N/m, stable up to "
        f"{stable_stiffness_n_per_m(*timing):.4g} N/m. What the check of the rendering stiffness found is a K for "
        "haptic_node.coupling.stiffness_n_per_m, with a margin of your own."
    )


def _page(found: _Judged, result: str) -> Any:
    from studies.pages.page import Page

    page = Page(f"Acceptance of {found.identity}: {result}")
    page.paragraph(
        f"{len(found.take.rows)} rows in {found.seconds:.0f} s, judged from this one take. "
        "The tolerances are provisional until takes of real devices are there."
    )
    page.table(("check", "result", "found", "wanted"), found.verdicts)
    for heading, text, values in [("What was declared", "", found.declared), *found.tables]:
        page.heading(heading)
        if text:
            page.paragraph(text)
        page.table(("what", "value"), [(name, str(value)) for name, value in values.items()])
    page.heading("The motion")
    page.table(("step", "seconds", "what was asked for"), found.steps)
    return page
