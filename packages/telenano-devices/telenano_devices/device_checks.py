"""The checks of this package for `telenano doctor`."""

import socket
from collections.abc import Sequence
from pathlib import Path

from telenano.extend.checks import Finding

_PATIENCE_S = 0.3


def check_devices(service: str = "", folders: Sequence[Path] | None = None) -> list[Finding]:
    """Check the requirements of the drivers of force devices: Haply's service, and the libraries of two vendors.

    All findings have the level ok, because a user without these devices lacks nothing.

    Args:
        service: The address of the Inverse Service; empty for that of the settings.
        folders: The folders in which to look for libraries, instead of the usual ones.
    """
    from telenano_devices.force_dimension import dhd
    from telenano_devices.haply.haply import INSTALL, SERVICE
    from telenano_devices.impedance.vendor_library import find
    from telenano_devices.touch import hd

    findings = [_inverse_service(service or SERVICE, INSTALL)]
    for name, library in (("dhd", dhd.LIBRARY), ("hd", hd.LIBRARY)):
        at = find(library if folders is None else library._replace(folders=tuple(map(str, folders))))
        missing = f"{library.what} is not installed, which haptic_node.driver {name} needs"
        advice = "" if at else library.install
        findings.append(Finding(name, "ok", f"{library.what}: {at}" if at else missing, advice))
    return findings


def _inverse_service(service: str, install: str) -> Finding:
    host, _, port = service.removeprefix("ws://").partition(":")
    try:
        with socket.create_connection((host, int(port)), timeout=_PATIENCE_S):
            return Finding("haply", "ok", f"something answers at {service}: ask it by `telenano device probe`")
    except OSError:
        problem = f"no Inverse Service answers at {service}, which haptic_node.driver haply needs"
        return Finding("haply", "ok", problem, install)
