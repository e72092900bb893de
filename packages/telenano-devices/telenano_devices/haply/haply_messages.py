"""The messages of Haply's Inverse Service, JSON of format 3.x, with the fields that the driver reads."""

import math

import msgspec

from telenano_devices.impedance.coupling import Vector

# The names of the buttons of a grip, bit 0 first.
BUTTONS = ("a", "b", "c")


class Xyz(msgspec.Struct, frozen=True):
    """A vector of the wire; null stands for a component that is NaN, which JSON cannot express."""

    x: float | None
    y: float | None
    z: float | None

    def vector(self) -> Vector:
        return tuple(math.nan if value is None else value for value in (self.x, self.y, self.z))  # type: ignore[return-value]


class Wxyz(msgspec.Struct, frozen=True):
    """A rotation of the wire."""

    w: float
    x: float
    y: float
    z: float


class ArmState(msgspec.Struct, frozen=True):
    """The state of an Inverse3 in each answer."""

    cursor_position: Xyz
    current_cursor_force: Xyz | None = None


class ArmStatus(msgspec.Struct, frozen=True):
    """Whether the Inverse3 may be used."""

    calibrated: bool = True
    ready: bool = True


class ArmInfo(msgspec.Struct, frozen=True):
    """Model and firmware of the Inverse3."""

    model: str = ""
    major_version: int = 0
    minor_version: int = 0


class ArmConfig(msgspec.Struct, frozen=True):
    """Type, model and firmware of an Inverse3, which only a full message contains."""

    type: str = "inverse3"
    device_info: ArmInfo = ArmInfo()


class Arm(msgspec.Struct, frozen=True):
    """An Inverse3 in a message."""

    device_id: str
    state: ArmState | None = None
    status: ArmStatus = ArmStatus()
    config: ArmConfig | None = None


class GripState(msgspec.Struct, frozen=True):
    """The state of a grip; a wired grip has one button."""

    orientation: Wxyz | None = None
    buttons: dict[str, bool] = {}
    button: bool = False
    battery_level: float = 1.0

    @property
    def pressed(self) -> int:
        """Return the pressed buttons as bits, in the order of `BUTTONS`."""
        return sum(self.buttons.get(name, False) << i for i, name in enumerate(BUTTONS)) | self.button


class GripStatus(msgspec.Struct, frozen=True):
    """Whether the grip is awake and reports."""

    awake: bool = True


class Grip(msgspec.Struct, frozen=True):
    """A grip in a message."""

    device_id: str
    state: GripState | None = None
    status: GripStatus = GripStatus()


class Answer(msgspec.Struct, frozen=True):
    """A message of the service; devices are found by their ids, because the order of the lists is not guaranteed."""

    inverse3: list[Arm] = []
    wireless_verse_grip: list[Grip] = []
    verse_grip: list[Grip] = []

    @property
    def grips(self) -> list[Grip]:
        """Return the grips, wireless ones first."""
        return [*self.wireless_verse_grip, *self.verse_grip]

    def arms(self, device_id: str | None) -> list[Arm]:
        """Return the Inverse3 devices with this id, or all of them for None."""
        return [arm for arm in self.inverse3 if device_id in (None, arm.device_id)]
