"""`telenano device trial`: tries a device of your own in half an hour, and writes one file and its page."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telenano.cli import Void, report_errors, rules
from telenano.settings import flag_overrides
from telenano.wire import ConfigError, TelenanoError
from telenano_devices.acceptance.accept_command import MassOption, SettingsOption, StopOption

if TYPE_CHECKING:
    from collections.abc import Callable

    from telenano_devices.acceptance.take import Guide, Verdict
    from telenano_devices.acceptance.trial.devices import TriedDevice
    from telenano_devices.acceptance.trial.trial_file import Trial

_NOT_PASSED = 1
_OPENED = "the device answers and says who it is"


@rules(Void("*", "which makes the page of a file, and tries no device", beside="--read"))
def trial(
    driver: Annotated[
        str | None,
        typer.Argument(metavar="[DRIVER]", help="haply, dhd, hd, nanonis, gwyscope, t7, serial, simulated_impedance."),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", metavar="FILE", help="Calibration of the instrument or handle.")
    ] = None,
    port: Annotated[str | None, typer.Option("--port", metavar="DEVICE", help="Serial port of a handle.")] = None,
    settings: SettingsOption = None,
    mass: MassOption = 0.0,
    stop: StopOption = "",
    yes: Annotated[bool, typer.Option("--yes", help="Answer every question with yes: for emulators only.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="The file to write; default: trial-DRIVER.zip.")
    ] = None,
    read: Annotated[
        Path | None, typer.Option("--read", metavar="FILE", help="Make the page of the file of a trial, as Markdown.")
    ] = None,
) -> None:
    """Try a device of your own with a question before each step, and write one file; or make its page.

    The device is read first, then driven without load, then with load. `end` or Ctrl-C ends the trial at any time: the
    device is released, and the file has the findings so far. The exit code is 1 if a check fails or was not made.
    """
    with report_errors(as_json=False):
        from telenano_devices.acceptance.trial.questions import Questions
        from telenano_devices.acceptance.trial.sheet import judged_again, sheet_of
        from telenano_devices.acceptance.trial.trial_file import read_trial

        if read is not None:
            trial_read = read_trial(read)
            typer.echo(sheet_of(trial_read), nl=False)
            if others := judged_again(trial_read):
                typer.echo("judged again by the version here: " + "; ".join(others), err=True)
            return
        if driver is None:
            raise ConfigError("name the device to try, such as `telenano device trial haply`, or give --read FILE")
        from telenano_devices.acceptance.trial.devices import tried

        path = out or Path(f"trial-{driver}.zip")
        device = tried(driver, flag_overrides(settings or []), calibration, port, mass, stop)
        questions = Questions(typer.echo, yes=yes, is_emulated=device.is_emulated)
        with questions.hear():
            made = make_trial(driver, device, questions.guide, questions.computer)
        _write(path, made)
        typer.echo("\n" + sheet_of(made), nl=False)
        if not made.acceptance.device:
            raise ConfigError(f"{made.errors[0].text} (it is also in {path})")
        typer.echo(f"\n{path} has all of it: please send it as docs/trial.md says")
    if made.acceptance.result != "pass":
        raise typer.Exit(_NOT_PASSED)


def make_trial(
    driver: str, device: "TriedDevice", guide: "Guide", computer: "Callable[[], list[Verdict]]" = list
) -> "Trial":
    """Try a device, and return the trial, without names, paths, hosts and addresses.

    Args:
        driver: The name of the driver.
        device: The device, with the function that records it.
        guide: The guide of the person.
        computer: The function that returns, after the motion, the verdicts on this computer.

    Raises:
        ConfigError: The device cannot be tried in this way.
    """
    from telenano.extend.hands import DeviceError
    from telenano.extend.instruments import DeviceError as InstrumentError
    from telenano_devices.acceptance.take import LOADS, EndedError, Result, Verdict, overall
    from telenano_devices.acceptance.trial.questions import ENDED
    from telenano_devices.acceptance.trial.scrub import Scrubber
    from telenano_devices.acceptance.trial.trial_file import (
        Acceptance,
        Problem,
        Trial,
        kind_of,
        line_of,
        lines_of,
        places_of,
        scrubbed,
        versions,
    )

    take, errors = None, list[Problem]()
    try:
        take = device.record(guide)
    except (DeviceError, InstrumentError, EndedError) as error:
        errors.append(Problem("opening", str(error)))
    except ConfigError:
        raise
    # A driver may raise anything.
    except Exception as error:  # noqa: BLE001
        errors.append(Problem("opening or motion", f"{type(error).__name__}: {error}", places_of(error)))
    if take is None:
        lines = [line_of(LOADS[0], Verdict("opening", "fail", errors[0].text, _OPENED))]
        acceptance = Acceptance(1, driver, "", "fail", 0.0, lines)
    else:
        stopped = take.facts.stopped
        result: Result = "pass" if not stopped else "retake" if stopped.startswith(ENDED) else "fail"
        ended = Verdict("whole motion", result, stopped or "completed", "each step made")
        if ended.result == "fail":
            errors.append(Problem("motion", stopped))
        errors += [Problem("device", text) for text in getattr(take.facts, "device_messages", ())]
        opening = Verdict("opening", "pass", take.facts.identity, _OPENED)
        others = computer()
        lines = [line_of(LOADS[0], verdict) for verdict in (opening, *others)]
        lines += [*lines_of(kind_of(take), take), line_of(LOADS[-1], ended)]
        result = overall([opening, ended, *others, *kind_of(take).judge(take)])
        acceptance = Acceptance(1, driver, take.facts.identity, result, take.seconds, lines)
        if not len(take.rows):
            take = None
    return scrubbed(Trial(acceptance, versions(), errors, take), Scrubber(device.given, (driver, "telenano")))


def _write(path: Path, made: "Trial") -> None:
    from telenano_devices.acceptance.trial.trial_file import write_trial

    try:
        write_trial(path, made)
    except OSError as error:
        raise TelenanoError(f"--out {path}: cannot be written: {error.strerror}") from error
