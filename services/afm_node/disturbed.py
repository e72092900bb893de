"""An instrument with disturbances: a driver around a driver, which changes nothing while all of them are off."""

from services.afm_node.disturbances import (
    DisturbanceConfig,
    DisturbanceState,
    NormalNumbers,
    begun,
    displaced,
    read_out,
    sines_of,
)
from services.afm_node.driver import AfmDriver, DeviceReport, LateralStage
from services.afm_node.step import AfmSample


class DisturbedAfm:
    """An `AfmDriver` whose base and read-out are disturbed.

    Parameters: driver, the instrument itself; stiffness_n_per_m and volts_per_m, of its cantilever and read-out. What
    is reported of the base is what it was sent to: an open-loop piezo knows no better.
    """

    def __init__(
        self, driver: AfmDriver, config: DisturbanceConfig, stiffness_n_per_m: float, volts_per_m: float
    ) -> None:
        self._driver = driver
        self._stiffness, self._volts_per_m = stiffness_n_per_m, volts_per_m
        self.config = config
        self._state: DisturbanceState = begun()
        self._normals, self._sines = NormalNumbers(config.seed), sines_of(config)
        self._active = config.any_enabled
        self._elapsed_s = 0.0

    def configure(self, config: DisturbanceConfig) -> None:
        """Take other disturbances from now on; those that go on keep their state."""
        self._sines = sines_of(config)
        self._normals.reseed(config.seed)
        self.config, self._active = config, config.any_enabled

    def elapse(self, dt: float) -> None:
        """Note the time [s] of the next exchange."""
        self._elapsed_s += dt

    @property
    def safe_position_m(self) -> float:
        return self._driver.safe_position_m

    @property
    def latency_s(self) -> float:
        return self._driver.latency_s

    @property
    def calibration_identity(self) -> str:
        return self._driver.calibration_identity

    @property
    def report(self) -> DeviceReport | None:
        return self._driver.report

    @property
    def stage(self) -> LateralStage | None:
        return self._driver.stage

    def open(self) -> None:
        self._driver.open()

    def exchange(self, base_m: float) -> AfmSample:
        if not self._active:
            return self._driver.exchange(base_m)
        dt, self._elapsed_s = self._elapsed_s, 0.0
        self._state, piezo_m = displaced(self.config, self._sines, self._state, base_m, dt)
        sample = self._driver.exchange(piezo_m)
        self._state, zeta = read_out(
            self.config, self._normals, self._state, sample.deflection_m, self._stiffness, self._volts_per_m, dt
        )
        return sample._replace(
            base_m=base_m, deflection_m=zeta, force_n=self._stiffness * zeta, bridge_voltage_v=self._volts_per_m * zeta
        )

    def retract(self) -> bool:
        return self._driver.retract()

    def close(self) -> None:
        self._driver.close()
