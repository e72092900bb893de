"""Capabilities of each driver of an instrument, and the laws and programs that they allow.

Only `refusal` and `loop_refusal` decide that: they say in words why a combination is impossible, before anything is
started. A driver of a package brings its own row of capabilities; a driver without a row is never refused. A law itself
declares whether it closes a loop (`Law.link_loop`), so this module knows no law by name.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from telenano.sections.afm_section import DRIVERS
from telenano.sections.program_table import PROGRAMS

# Least rate of z and force for a loop through link and instrument [Hz]; a slower one shakes a hand in contact.
LEAST_LOOP_HZ = 200.0


class AfmCapabilities(NamedTuple):
    """Capabilities of an instrument.

    z_hz: rate at which z is set [Hz]; sample_hz: rate of new samples [Hz], both as declared for the device as shipped;
    latency_s: mean time from a command to the sample that answers it [s]. lateral: whether x and y can be moved.
    images, curves: whether the programs of the node may move the tip for them. channels: channels that the operator may
    feel. retracts: in words, the mechanism that retracts the tip when this rig is gone. scans: whether the program
    `scan` is the controller's own.
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

    @staticmethod
    def of(driver: str) -> "AfmCapabilities | None":
        """Return the capabilities that a driver declares; None if it declares none.

        Raises:
            ValueError: The driver of a package cannot be used.
        """
        driver_row = DRIVERS.find(driver)
        if driver_row is None or driver_row.capabilities is None:
            return TABLE.get(driver)
        return AfmCapabilities(*driver_row.capabilities)


TABLE: Mapping[str, AfmCapabilities] = {
    "simulated": AfmCapabilities(1000.0, 1000.0, 0.0, True, True, True, ("deflection",), "nothing has to"),
    "modbus": AfmCapabilities(
        500.0, 500.0, 2.5e-3, False, False, True, ("deflection",), "a script on a T7; a watchdog of 1 s elsewhere"
    ),
}


def loop_refusal(driver: str, law: str, instead: Iterable[str], where: str = "") -> str:
    """Return why a law that closes a loop through the instrument cannot be used with a driver; empty if it can.

    Args:
        driver: The value of `afm_node.driver`.
        law: The name of the law.
        instead: The names of laws without such a loop, which the text proposes.
        where: A hint at the package of one of them that is not installed; empty if all are.
    """
    able = AfmCapabilities.of(driver)
    if able is None or able.sample_hz >= LEAST_LOOP_HZ:
        return ""
    return (
        f"controller.law: {law} closes a loop through the instrument, and {driver} gives {able.sample_hz:g} samples a"
        f" second, {able.latency_s * 1e3:g} ms late, where a loop needs {LEAST_LOOP_HZ:g}: use a law whose hand meets"
        f" a model of the contact at once, which the instrument corrects, or moves no tip ({', '.join(instead)})"
        f"{where and '; '}{where}"
    )


def refusal(driver: str, program: str) -> str:
    """Return why a program of the instrument cannot be used with a driver; empty if it can.

    Args:
        driver: The value of `afm_node.driver`.
        program: The name of a program of the instrument, empty for none.
    """
    capabilities = AfmCapabilities.of(driver)
    if capabilities is None:
        return ""
    if program in PROGRAMS and PROGRAMS[program].moves_across and not capabilities.lateral:
        return f"{program} moves the tip over the sample, and {driver} moves it along z only"
    if program == "scan" and capabilities.scans:
        return ""
    if program and not (capabilities.curves if program == "curve" else capabilities.images):
        return (
            f"{program} regulates the tip in the node at {LEAST_LOOP_HZ:g} Hz or more, and"
            f" {driver} gives {capabilities.sample_hz:g} samples a second: let the controller do that itself"
        )
    return ""
