"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "device simulate handle": (
        "telenano_emulators.simulate:simulate_handle",
        "Run an emulated handle: the firmware, the motor and the hand, on a port of its own. Ctrl-C ends it.",
    ),
    "device simulate t7": (
        "telenano_emulators.simulate:simulate_t7",
        "Serve the model of a LabJack T7 with stage and cantilever behind it, over Modbus TCP. Ctrl-C ends it.",
    ),
}
