"""The packages that this project keeps beside its core: the one table that suggests them where they are missing."""

# A command, a format of `bag export` or a name that a scenario may give, and the distribution that has it.
KNOWN_PACKAGES = {
    "bridge foxglove": "telenano-foxglove",
    "bridge lsl": "telenano-lsl",
    "bridge ros2": "telenano-ros2",
    "device approach": "telenano-afm-controllers",
    "device guard gwyscope": "telenano-afm-controllers",
    "device guard nanonis": "telenano-afm-controllers",
    "device image": "telenano-afm-controllers",
    "device simulate gwyscope": "telenano-afm-controllers",
    "device simulate haply": "telenano-haptic-devices",
    "device simulate nanonis": "telenano-afm-controllers",
    "driver dhd": "telenano-haptic-devices",
    "driver gwyscope": "telenano-afm-controllers",
    "driver haply": "telenano-haptic-devices",
    "driver hd": "telenano-haptic-devices",
    "driver nanonis": "telenano-afm-controllers",
    "export protobuf": "telenano-protobuf",
    "export ros2": "telenano-ros2",
}
