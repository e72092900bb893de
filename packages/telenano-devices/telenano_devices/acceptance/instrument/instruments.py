"""Makes a take of an instrument: the simulated one, or a real one by its calibration file."""

from pathlib import Path
from typing import Any

from telenano.devices import AfmCapabilities, driver_of
from telenano.extend.instruments import AfmDriver
from telenano.sections import AfmConfig
from telenano.settings import merge, read_yaml, validate
from telenano.wire import ConfigError
from telenano_devices.acceptance.instrument.take import Facts, press_of, record_take
from telenano_devices.acceptance.take import MACHINE, PERIOD_S, SILENT, Clock, Guide, Take

_CONTACT_N = 1e-9


def config_of(calibration: Path | None, options: dict[str, Any]) -> AfmConfig:
    """Return the section `afm_node` of an instrument, from a calibration file and options, or the simulated one.

    Raises:
        ConfigError: The file or a key cannot be used.
    """
    if calibration is None:
        return validate(AfmConfig, options, "--set", "afm_node")
    kind = read_yaml(calibration).get("controller", "modbus")
    section = {"driver": kind, kind: {"calibration": str(calibration)}}
    return validate(AfmConfig, merge(section, options), "--set", "afm_node")


def make_take(config: AfmConfig, guide: Guide = SILENT) -> Take[Facts]:
    """Lead the instrument of a section through the motion, and return the take; it ends retracted and closed.

    Raises:
        DeviceError: The instrument is not ready.
        ConfigError: Its files cannot be used, or its driver declares no capabilities.
    """
    _declared_hz(config)
    driver = driver_of(config, PERIOD_S)
    driver.open()
    try:
        # A simulated instrument needs no wait.
        clock = Clock(lambda: 0) if driver.report is None else MACHINE
        return record_take(driver, facts_of(config, driver), clock, guide)
    finally:
        driver.close()


def _declared_hz(config: AfmConfig) -> float:
    """Return the rate of new samples that the driver declares [Hz]; raise ConfigError if it declares none."""
    capabilities = AfmCapabilities.of(config.driver)
    if capabilities is None:
        raise ConfigError(f"afm_node.driver = {config.driver} declares no capabilities: its package judges it")
    return capabilities.sample_hz


def facts_of(config: AfmConfig, driver: AfmDriver) -> Facts:
    """Return the facts of an open instrument before its take."""
    calibration: Any = getattr(driver, "calibration", None)
    contact_n = _CONTACT_N if calibration is None else calibration.contact_force_n
    cantilever = config.cantilever if calibration is None else calibration.cantilever
    # A measured tick is better than the declared rate of the device as shipped.
    tick_s = getattr(driver, "tick_s", 0.0)
    limits = config.to_params().safety
    return Facts(
        driver=config.driver,
        identity=getattr(driver, "identity", "the simulated instrument"),
        latency_s=driver.latency_s,
        sample_hz=1.0 / tick_s if tick_s else _declared_hz(config),
        stiffness_n_per_m=cantilever.stiffness_n_per_m,
        contact_force_n=contact_n,
        limits=limits,
        press_n=press_of(contact_n, limits.force_limit_n),
        safe_m=driver.safe_position_m,
    )
