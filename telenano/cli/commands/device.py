"""`telenano device`: the devices and drivers on this machine."""

from pathlib import Path
from typing import Any

import typer

from telenano.cli.options import JsonOption, command_group
from telenano.cli.output import print_json, print_rows, report_errors
from telenano.settings.device_drivers import DeviceDriver
from telenano.settings.known_packages import known_of
from telenano.settings.plugins import installed
from telenano.wire.errors import ConfigError
from telenano.wire.extras import how_to_add_package, how_to_install

app = command_group()
simulate = command_group()
guard = command_group()
app.add_typer(simulate, name="simulate", help="Run an emulated device in this terminal.")
app.add_typer(guard, name="guard", help="Retract the tip of an AFM controller when the rig is silent.")

_BY_ID = Path("/dev/serial/by-id")


@app.command("list")
def list_devices(as_json: JsonOption = False) -> None:
    """List the serial ports, by names that stay the same, and the drivers of packages with their missing parts."""
    with report_errors(as_json):
        rows, packages = serial_ports(), package_rows()
    if as_json:
        print_json({"ports": rows, "packages": packages})
        return
    if rows:
        print_rows(rows)
    else:
        typer.echo("no serial port is plugged in")
    if packages:
        print_rows(packages)


def serial_ports() -> list[dict[str, Any]]:
    """Return the serial ports of this machine: permanent name, device file, description, and process that holds it."""
    try:
        from serial.tools.list_ports import comports
    except ImportError as error:
        raise ConfigError(f"serial ports need pyserial: {how_to_install('haptic')}") from error
    from telenano.devices.hand.port import holder_of

    names = {str(link.resolve()): str(link) for link in _BY_ID.iterdir()} if _BY_ID.is_dir() else {}
    return [
        {
            "port": names.get(port.device, port.device),
            "device": port.device,
            "what": port.description,
            "in use by": holder_of(port.device),
        }
        for port in comports()
    ]


def _state(driver: DeviceDriver) -> str:
    return "can be used, experimental: it has driven an emulator only" if driver.experimental else "can be used"


def package_rows() -> list[dict[str, Any]]:
    """Return the drivers of packages, each with the state of its requirements on this machine.

    For an installed driver this is the result of the check of `telenano doctor` with the driver's name; a driver of
    this project that is not installed has the command that adds its package.
    """
    from telenano.cli.commands.doctor import checks_of_packages
    from telenano.sections.afm_section import DRIVERS as INSTRUMENTS
    from telenano.sections.hand_section import DRIVERS as HANDLES

    handles, instruments = HANDLES.all(), INSTRUMENTS.all()
    drivers, problems = {**handles.found, **instruments.found}, {**handles.problems, **instruments.problems}
    checked = {finding.name: finding for finding in checks_of_packages()}
    rows = []
    # The other entries are sections that drivers share.
    for name, row in ((name, row) for name, row in installed("devices").items() if name in drivers or name in problems):
        finding = checked.get(name)
        rows.append(
            {
                "driver": name,
                "device": drivers[name].what if name in drivers else "",
                "node": drivers[name].node if name in drivers else "",
                "package": f"{row.package} {row.version}",
                "found": problems[name] if name not in drivers else finding.found if finding else _state(drivers[name]),
                "advice": finding.advice if finding else "",
            }
        )
    there = {row["driver"] for row in rows}
    for name, package in known_of("driver").items():
        if name not in there:
            absent = {"package": package, "found": "not installed", "advice": how_to_add_package(package)}
            rows.append({"driver": name, "device": "", "node": "", **absent})
    return rows
