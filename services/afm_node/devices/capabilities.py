"""What each driver of an instrument can do, and with which laws and programs it may therefore be used.

`refusal` is the one place where that is decided: it says in words why a combination is not possible, before anything is
started. A driver of a package brings its own row; one without a row is not judged.
"""

from collections.abc import Mapping
from typing import NamedTuple

from services.afm_node.config import DRIVERS

# A loop through link and instrument needs z and force at this rate at least [Hz]; slower ones shake a hand in contact.
LEAST_LOOP_HZ = 200.0
# laws that close no loop through link and instrument: the hand meets a model, or nothing
WITHOUT_A_LOOP = ("model_mediated", "tactile")


class Capabilities(NamedTuple):
    """What an instrument offers the rig.

    z_hz: how often z is set, and sample_hz, how often a new sample comes [Hz], as declared for the device as shipped;
    latency_s: from a command to the sample that answers it, in the mean [s]. lateral: whether x and y move. images,
    curves: whether the programs of the node may move the tip. channels: what may be felt. retracts: what retracts the
    tip when this rig is gone. scans: whether the program `scan` is the controller's own.
    """

    z_hz: float
    sample_hz: float
    latency_s: float
    lateral: bool
    images: bool
    curves: bool
    channels: tuple[str, ...]
    retracts: str
    scans: bool = False


TABLE: Mapping[str, Capabilities] = {
    "simulated": Capabilities(1000.0, 1000.0, 0.0, True, True, True, ("deflection",), "nothing has to"),
    "modbus": Capabilities(
        500.0, 500.0, 2.5e-3, False, False, True, ("deflection",), "a script on a T7; a watchdog of 1 s elsewhere"
    ),
}


def capabilities_of(driver: str) -> Capabilities | None:
    """Return what a driver declares of its instrument; None where it declares nothing.

    Raises:
        ValueError: The driver of a package cannot be used.
    """
    found = DRIVERS.find(driver)
    if found is None or found.capabilities is None:
        return TABLE.get(driver)
    return Capabilities(*found.capabilities)


def refusal(driver: str, law: str, program: str = "") -> str:
    """Return why a law, or a program that begins by itself, cannot be used with a driver; empty where it can.

    Args:
        driver: The value of `afm_node.driver`.
        law: The value of `controller.law`, empty where it is not the question.
        program: The name of a program of the instrument, empty for none.
    """
    found = capabilities_of(driver)
    if found is None:
        return ""
    if law and found.sample_hz < LEAST_LOOP_HZ and law not in WITHOUT_A_LOOP:
        return (
            f"controller.law: {law} closes a loop through the instrument, and {driver} gives"
            f" {found.sample_hz:g} samples a second, {found.latency_s * 1e3:g} ms late, where a"
            f" loop needs {LEAST_LOOP_HZ:g}: use model_mediated,"
            " whose hand meets a model of the contact at once, which the instrument corrects"
        )
    if program in ("scan", "tactile", "push") and not found.lateral:
        return f"{program} moves the tip over the sample, and {driver} moves it along z only"
    if program == "scan" and found.scans:
        return ""
    if program and not (found.curves if program == "curve" else found.images):
        return (
            f"{program} regulates the tip in the node at {LEAST_LOOP_HZ:g} Hz or more, and"
            f" {driver} gives {found.sample_hz:g} samples a second: let the controller do that itself"
        )
    return ""
