"""The packages that this project keeps beside its core: the one table that suggests them where they are missing."""

# A command, a format of `bag export` or a name that a scenario may give, and the distribution that has it.
KNOWN_PACKAGES = {
    "bridge foxglove": "telenano-foxglove",
    "bridge lsl": "telenano-lsl",
    "bridge ros2": "telenano-ros2",
    "device simulate haply": "telenano-haptic-devices",
    "driver dhd": "telenano-haptic-devices",
    "driver haply": "telenano-haptic-devices",
    "driver hd": "telenano-haptic-devices",
    "export protobuf": "telenano-protobuf",
    "export ros2": "telenano-ros2",
}
