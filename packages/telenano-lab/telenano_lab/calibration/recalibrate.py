"""Convert a recording of real devices with a better calibration, from the raw counts and volts that it keeps."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from telenano.devices import HandleCalibration, InstrumentCalibration
from telenano.numerics import to_site_frame
from telenano.recording import CopyResult, Recording
from telenano.wire import AfmState, ConfigError, HapticState, Message, NodeHealth, RecordingError, decode, encode


class RecalibrationResult(CopyResult):
    """Result of a recalibration: the number of converted messages by topic."""

    read_again: dict[str, int]


def recalibrate(
    source: Path, target: Path, *, handle: HandleCalibration | None = None, stage: InstrumentCalibration | None = None
) -> RecalibrationResult:
    """Copy a recording with its measured values converted again; references and commands remain as they were.

    Raises:
        ConfigError: A calibration is missing, or is that of another device.
        RecordingError: The source has no counts or volts to convert, or the target exists.
    """
    read: dict[str, Callable[[Message], Message | None]] = {}
    if handle is not None:
        read["haptic/state"] = lambda message: _hand(message, handle)
    if stage is not None:
        read["afm/state"] = lambda message: _tip(message, stage)
    if not read:
        raise ConfigError("give a calibration file: --handle handle.yaml, --stage stage.yaml, or both")
    recording = Recording(source)
    identities = {"haptic_node": handle and handle.identity, "afm_node": stage and stage.identity}
    again = dict.fromkeys(read, 0)

    def messages() -> Iterator[Any]:
        for message in recording.raw():
            topic = message.channel.topic.partition("@")[0]
            if topic in read:
                reading = read[topic](decode(topic, message.payload))
                if reading is not None:
                    again[topic] += 1
                    message = message._replace(payload=encode(reading))
            elif topic == "node/health":
                health = decode(topic, message.payload)
                if isinstance(health, NodeHealth) and health.calibration:
                    wanted = identities.get(health.src.partition("@")[0])
                    if wanted:
                        _require_same_device(source, health.calibration, wanted)
                        message = message._replace(payload=encode(msgspec.structs.replace(health, calibration=wanted)))
            yield message
        for topic, count in again.items():
            if not count:
                raise RecordingError(
                    f"{source}: {topic} has no raw values: its device was simulated, or recorded before they were kept"
                )

    return RecalibrationResult.of(target, [recording], messages(), read_again=again)


def _require_same_device(source: Path, recorded: str, wanted: str) -> None:
    # An identity is the device, a blank, and the time of its calibration.
    device, wanted_name = recorded.rpartition(" ")[0], wanted.rpartition(" ")[0]
    if device != wanted_name:
        raise ConfigError(
            f"{source}: was recorded with the device {device}, and the calibration is that of {wanted_name}"
        )


def _hand(message: Message, calibration: HandleCalibration) -> Message | None:
    if not isinstance(message, HapticState) or message.position_raw is None:
        return None
    update: dict[str, object] = {"position_m": to_site_frame(calibration.position_m(message.position_raw))}
    if message.velocity_raw is not None:
        update["velocity_m_per_s"] = to_site_frame(calibration.velocity_m_per_s(message.velocity_raw))
    if message.operator_force_raw is not None:
        update["operator_force_n"] = to_site_frame(calibration.operator_force_n(message.operator_force_raw))
    if message.drive_raw is not None:
        update["motor_force_n"] = to_site_frame(calibration.drive_force_n(message.drive_raw))
    return msgspec.structs.replace(message, **update)


def _tip(message: Message, calibration: InstrumentCalibration) -> Message | None:
    if not isinstance(message, AfmState) or message.output_v is None or message.input_v is None:
        return None
    sample = calibration.readings(message.output_v, message.input_v).sample
    return msgspec.structs.replace(
        message,
        base_position_m=to_site_frame(sample.base_m),
        deflection_m=sample.deflection_m,
        tip_force_n=(0.0, 0.0, sample.force_n),
        in_contact=sample.in_contact,
    )
