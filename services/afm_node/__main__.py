"""Run the AFM node with the instrument that its configuration names."""

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from proto.errors import ConfigError
from services.afm_node.config import DRIVERS, SAMPLES, AfmConfig, ModbusConfig
from services.afm_node.driver import AfmDriver
from services.afm_node.node import INPUTS, AfmNode
from services.afm_node.physics.sim import SimulatedInstrument, simulated_afm
from services.afm_node.safety import SafetyParams
from services.runtime.loop.main import NodeKind, ordinary, run_node
from services.runtime.loop.node import NodeContext
from services.runtime.loop.realtime import ordinary_scheduling


def build(context: NodeContext, config: AfmConfig) -> AfmNode:
    """Build the node with its instrument."""
    # Loading and compiling the dynamic model takes seconds, in which the law beside it has to keep its period.
    with ordinary_scheduling() if config.model == "dynamic" else nullcontext():
        return AfmNode(context, config, _driver(config))


def _driver(config: AfmConfig) -> AfmDriver:
    if config.driver == "modbus" and config.modbus is not None:
        return modbus_driver(config.modbus, config.to_params().safety)
    if config.driver in DRIVERS.found:
        driver = DRIVERS.found[config.driver]
        device: AfmDriver = driver.build(getattr(config, driver.name) or driver.config(), config.to_params().safety)
        return device
    if config.environment in SAMPLES.found:
        return SimulatedInstrument(config.to_sample_params())
    if config.environment == "spring":
        return SimulatedInstrument(config.to_spring_params())
    if config.model == "dynamic":
        return dynamic_afm(config)
    return simulated_afm(
        config.to_params(), config.to_surface(), config.to_friction_params(), config.disturbances, **_particles(config)
    )


def _particles(config: AfmConfig) -> dict[str, Any]:
    particles = None if config.sample is None else config.sample.particles
    return {} if particles is None else {"layer": config.to_particle_layer, "above_m": particles.highest_m}


def dynamic_afm(config: AfmConfig) -> SimulatedInstrument:
    """Return the instrument with the dynamic cantilever; ConfigError, if there is no compiler or no such model."""
    try:
        from services.afm_node.physics.dynamic import FINEST
        from services.afm_node.physics.dynamic_sim import dynamic_params, require_steps, resting_steps
    except ImportError as error:
        raise ConfigError('afm_node.model: dynamic needs numba: pip install "telenano[studies]"') from error
    surface, friction = config.to_surface(), config.to_friction_params()
    try:
        # impulses of 1 K, which the driver scales: the temperature can be changed while it runs
        whole = config.cantilever.steps_per_period
        driven = config.to_dynamic(temperature_k=1.0, finest=whole)
        rest = resting_steps(driven)
        if rest > whole // 2:
            # A millisecond of the bus has no time for more steps than the configuration and the contact ask for.
            driven = config.to_dynamic(temperature_k=1.0, like=driven, finest=min(FINEST, max(whole, 2 * rest)))
        require_steps(driven)
        resting = config.to_dynamic(steps_per_period=rest, temperature_k=1.0, like=driven, finest=rest)
        tip = dynamic_params(config.to_params().plant, driven, resting)
    except ValueError as error:
        raise ConfigError(f"afm_node.model: {error}") from error
    return simulated_afm(config.to_params(), surface, friction, config.disturbances, tip, **_particles(config))


def modbus_driver(section: ModbusConfig, limits: SafetyParams) -> AfmDriver:
    """Return the driver of a real instrument; ConfigError names what is wrong with its files."""
    try:
        from services.afm_node.devices.modbus_driver import ModbusAfm
    except ImportError as error:
        raise ConfigError('afm_node.driver: modbus needs pymodbus: pip install "telenano[afm]"') from error
    from services.afm_node.devices.converter_calibration import read_calibration
    from services.afm_node.devices.register_map import read_map

    calibration = read_calibration(Path(section.calibration))
    own = {"host": section.host, "port": section.port}
    network = calibration.network.model_copy(update={key: value for key, value in own.items() if value is not None})
    calibration = calibration.model_copy(update={"network": network})
    return ModbusAfm(calibration, read_map(calibration.instrument.map), limits)


AFM_NODE = NodeKind("afm_node", AfmConfig, ordinary(build, INPUTS))

if __name__ == "__main__":
    sys.exit(run_node(AFM_NODE))
