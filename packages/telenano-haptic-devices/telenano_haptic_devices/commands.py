"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "device simulate haply": (
        "telenano_haptic_devices.simulate:simulate_haply",
        "Run an emulated Inverse Service with an Inverse3, a VerseGrip and a hand on it.",
    ),
}
