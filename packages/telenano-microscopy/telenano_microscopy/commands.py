"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "sample": ("telenano_microscopy.sample_command:app", "Make or read a surface as a round tip sees it."),
    "curve": (
        "telenano_microscopy.curve_command:curve",
        "Measure a force curve of the simulated instrument, beside a measured one.",
    ),
    "scan": (
        "telenano_microscopy.scan_command:scan",
        "Image a sample: tapping or contact mode, simulated time.",
    ),
}
