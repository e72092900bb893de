"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "bag recalibrate": (
        "telenano_calibration.recalibrate_command:recalibrate",
        "Read what real devices sent with another calibration, into a new recording.",
    ),
    "budget": (
        "telenano_calibration.budget_command:budget",
        "State the error of a session's figures by its sources, and the delay of the loop by its stages.",
    ),
    "calibrate": (
        "telenano_calibration.command:app",
        "Calibrate read-out and stiffness from own measurements.",
    ),
    "device calibrate": (
        "telenano_calibration.device_command:app",
        "Measure a device, and write its calibration file.",
    ),
}
