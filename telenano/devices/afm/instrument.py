"""Builds the objects of a configuration of the AFM: its driver, the reach of its base, and the runner of programs."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel

from telenano.afm.programs.reach import Reach
from telenano.afm.programs.runner import ProgramRunner
from telenano.afm.sample.surface import Surface
from telenano.afm.sim import SimulatedInstrument, simulated_afm
from telenano.afm.step import AfmParams
from telenano.extend.feedback import remaining
from telenano.extend.instruments import AfmDriver, SafetyParams
from telenano.extend.programs import Instrument
from telenano.extend.stage import Place
from telenano.runtime.loop.node import LOOP_PERIOD_S
from telenano.sections.afm_parts import ModbusConfig
from telenano.sections.afm_section import DRIVERS, AfmConfig
from telenano.sections.program_requests import LateralTarget
from telenano.sections.program_table import PROGRAMS
from telenano.sections.sample_section import layers_on
from telenano.settings.config import read_yaml, validate
from telenano.settings.device_drivers import DeviceDriver
from telenano.settings.known_packages import where_it_is
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.extras import how_to_install


def driver_of(config: AfmConfig, period_s: float = LOOP_PERIOD_S) -> AfmDriver:
    """Return the driver of the instrument, simulated or real; raise ConfigError, with the reason, if there is none."""
    if config.driver == "modbus" and config.modbus is not None:
        return modbus_driver(config.modbus, config.to_params().safety, period_s)
    if (driver := DRIVERS.find(config.driver)) is not None:
        device: AfmDriver = driver.device(config, config.to_params().safety, period_s)
        return device
    if config.package_sample is not None:
        return _read_by_cantilever(config, config.to_sample_params())
    if config.environment == "spring":
        return _read_by_cantilever(config, config.to_spring_params())
    if config.sample is not None and config.sample.map is not None:
        return recorded_afm(config)
    if config.model == "dynamic":
        return dynamic_afm(config)
    return simulated_afm(
        config.to_params(), config.to_surface(), config.to_friction_params(), config.disturbances, **_layers(config)
    )


def _read_by_cantilever(config: AfmConfig, params: AfmParams) -> SimulatedInstrument:
    """Return the instrument over a plant that gives only a force, which the cantilever reads while it is disturbed."""
    cantilever = config.to_params().plant
    return SimulatedInstrument(params, None, cantilever, config.disturbances, is_gauged=True)


def _layers(config: AfmConfig) -> dict[str, Any]:
    """Return the arguments of `simulated_afm` for the parts around the tip: layers, and the lateral-force channel."""
    heights = [layer.height(settings).height_m for layer, settings in layers_on(config.sample)]

    def layer(part: Any, surface: Surface | None) -> Any:
        return config.measured_by_torsion(config.with_layers(part, surface))

    return {"layer": layer, "above_m": max(heights, default=0.0)}


def dynamic_afm(config: AfmConfig) -> SimulatedInstrument:
    """Return the instrument with the dynamic cantilever; raise ConfigError without numba or for impossible values."""
    try:
        from telenano.afm.dynamic_plant import FINEST
        from telenano.afm.dynamic_sim import dynamic_params, require_steps, resting_steps
    except ImportError as error:
        raise ConfigError(f"afm_node.model: dynamic needs numba: {how_to_install('studies')}") from error
    surface, friction = config.to_surface(), config.to_friction_params()
    try:
        # The impulses are those of 1 K; the driver scales them, so that the temperature can be changed while it runs.
        whole = config.cantilever.steps_per_period
        driven = config.to_dynamic(temperature_k=1.0, finest=whole)
        rest = resting_steps(driven)
        if rest > whole // 2:
            # A millisecond of the bus has no time for more steps than configuration and contact require.
            driven = config.to_dynamic(temperature_k=1.0, like=driven, finest=min(FINEST, max(whole, 2 * rest)))
        require_steps(driven)
        resting = config.to_dynamic(steps_per_period=rest, temperature_k=1.0, like=driven, finest=rest)
        tip = dynamic_params(config.to_params().plant, driven, resting)
    except ValueError as error:
        raise ConfigError(f"afm_node.model: {error}") from error
    return simulated_afm(config.to_params(), surface, friction, config.disturbances, tip, **_layers(config))


def recorded_afm(config: AfmConfig) -> SimulatedInstrument:
    """Return the instrument over its recorded map; raise ConfigError if the map cannot be used."""
    over, params = config.to_over_map(), config.to_params()
    # The disturbances are those of a cantilever that has the stiffness of the map.
    cantilever = params.plant._replace(stiffness_n_per_m=over.stiffness_n_per_m)
    plant = params._replace(plant=over.params)
    return SimulatedInstrument(plant, None, cantilever, config.disturbances, over.about, over.channel)


def modbus_driver(section: ModbusConfig, limits: SafetyParams, period_s: float = LOOP_PERIOD_S) -> AfmDriver:
    """Return the driver of a Modbus instrument; raise ConfigError, with the fault, if its files are wrong."""
    try:
        from telenano.devices.afm.modbus_driver import ModbusAfm
    except ImportError as error:
        raise ConfigError(f"afm_node.driver: modbus needs pymodbus: {how_to_install('afm')}") from error
    from telenano.devices.afm.converter_calibration import InstrumentCalibration

    calibration = InstrumentCalibration.from_file(Path(section.calibration))
    own = {"host": section.host, "port": section.port}
    network = calibration.network.model_copy(update={key: value for key, value in own.items() if value is not None})
    calibration = calibration.model_copy(update={"network": network})
    return ModbusAfm.of(calibration, limits, period_s=period_s)


def calibration_of_file(calibration: Path) -> Any:
    """Return the calibration of a real instrument of any kind; raise ConfigError, with the fault, if it is wrong."""
    from telenano.devices.afm.converter_calibration import InstrumentCalibration

    document = read_yaml(calibration)
    if (kind := document.get("controller")) is None:
        return InstrumentCalibration.from_file(calibration)
    return validate(_calibrated(kind, calibration)[1], document, str(calibration))


def driver_of_file(calibration: Path, config: AfmConfig) -> Any:
    """Return the driver of a real instrument of any kind, chosen by its calibration file alone."""
    limits, kind = config.to_params().safety, read_yaml(calibration).get("controller")
    if kind is None:
        return modbus_driver(ModbusConfig(calibration=str(calibration)), limits)
    driver, _ = _calibrated(kind, calibration)
    section = driver.config(calibration=str(calibration))
    return driver.device(config, limits, LOOP_PERIOD_S, section)


def _calibrated(kind: Any, calibration: Path) -> tuple[DeviceDriver, type[BaseModel]]:
    """Return the driver for the `controller` of a calibration file, and the model of such files.

    Raises:
        ConfigError: No such driver is installed; the message names the package that would have it.
    """
    try:
        driver = DRIVERS.find(str(kind))
    except ValueError as error:
        raise ConfigError(f"{calibration}: controller: {error}") from error
    if driver is None or driver.calibration is None:
        hint = where_it_is(f"driver {kind}") or "no driver is installed that has calibration files of this name"
        raise ConfigError(f"{calibration}: controller: {kind}: {hint}")
    return driver, driver.calibration


def reach_of(config: AfmConfig, driver: AfmDriver) -> Reach | None:
    """Return the reach of the base, or None for an instrument whose surface is not known in advance."""
    if driver.relief is None:
        return None
    surface, above_m = driver.relief
    return Reach(surface, config.rest_distance_m, config.to_params().safety, above_m)


def sample_text(config: AfmConfig, driver: AfmDriver, reach: Reach | None) -> str:
    """Return how the sample was levelled and the range of its heights, for the person who arms the tip.

    Without lateral reach it is the remark of the driver. Empty if there is nothing to tell.
    """
    if reach is None:
        return getattr(driver, "about", "")
    surface, sample = reach.surface, config.sample
    if sample is None or surface is None or not sample.levelled:
        return ""
    low, high = float(surface.height_m.min()), float(surface.height_m.max())
    return (
        f"sample {sample.name}: {sample.levelled} (afm_node.sample.level={sample.level}); the tip sees {low:.3g} to"
        f" {high:.3g} m"
    )


def pointed(config: AfmConfig, driver: AfmDriver, target: LateralTarget, pointer: Place) -> Place:
    """Return the place where a person wants the tip after a command; without a place in it, that is still `pointer`.

    Raises:
        RefusedError: The instrument has no stage, or the place is out of reach.
    """
    if target.x_m is None and target.y_m is None:
        return pointer
    if driver.stage is None:
        raise RefusedError("lateral: this instrument has no lateral stage")
    x_m = pointer.x_m if target.x_m is None else target.x_m
    y_m = pointer.y_m if target.y_m is None else target.y_m
    reach_x_m, reach_y_m = config.places_m
    if abs(x_m) > reach_x_m or abs(y_m) > reach_y_m:
        limit = f"lateral.reach_m = {reach_x_m:g} m"
        if config.map_span is not None:
            limit = f"the recorded map, x ± {reach_x_m:g} m, y ± {reach_y_m:g} m"
        raise RefusedError(f"lateral: {x_m:g}, {y_m:g} m is beyond {limit}")
    return Place(x_m, y_m)


def runner_of(config: AfmConfig, driver: AfmDriver, reach: Reach | None, period_s: float) -> ProgramRunner:
    """Return the runner of the programs of an instrument that steps each period_s [s].

    The feedback of an instrument with a latency D is treated as one that steps less often, with the period T + 2 D: an
    integral of gain Ki behind D is stable for Ki D below pi / 2, and the limit 2 / (T + 2 D) is below that for any T.
    """
    params = config.to_params()
    # Over a recorded map, programs stay within its largest square.
    lateral = None if driver.stage is None else config.to_lateral_params()._replace(reach_m=min(config.places_m))
    surface = None if reach is None else reach.surface
    sides = config.sample_sides_m() if surface is None else (surface.width_m, surface.depth_m)
    c = config.cantilever
    instrument = Instrument(
        limits=params.safety,
        lateral=lateral,
        size_m=sides,
        stiffness_n_per_m=config.felt_through_n_per_m,
        period_s=period_s + 2.0 * driver.latency_s,
        can_vibrate=driver.vibration is not None,
        lag=remaining(period_s, c.resonance_hz, c.quality),
        reach=reach,
        lateral_uncertainty=config.torsion.gain_uncertainty,
        scans=hasattr(driver, "own_scan"),
    )
    return ProgramRunner(instrument, PROGRAMS)
