"""The check of `telenano doctor` for the instrument of a calibration file."""

import socket
from pathlib import Path

from telenano.extend.checks import Finding

_PATIENCE_S = 2.0


def check_instrument(calibration: Path, patience_s: float = _PATIENCE_S) -> Finding:
    """Check whether the instrument of a calibration file is reached; ConfigError for a file that is none.

    It is connected to and asked nothing: a rig may be driving it.
    """
    from telenano.devices.afm.instrument import calibration_of_file

    network = calibration_of_file(calibration).network
    where = f"{network.host}:{network.port}"
    try:
        with socket.create_connection((network.host, network.port), timeout=patience_s):
            return Finding("instrument", "ok", f"{where} accepts a connection")
    except socket.gaierror:
        found, advice = "the name is not known", f"correct network.host in {calibration}, or give an address"
    except TimeoutError:
        found = f"no answer within {patience_s:g} s"
        advice = f"check power and cable, that {network.host} is in the network of this machine, and the firewall"
    except ConnectionRefusedError:
        found = "there is a machine, and it refuses the port"
        advice = f"a T7 listens on 502, a guard on a port of yours: correct network.port in {calibration}, or start it"
    except OSError as error:
        found, advice = f"not reached: {error.strerror or error}", "check cable, address and network mask"
    return Finding("instrument", "problem", f"{where}: {found}", advice)
