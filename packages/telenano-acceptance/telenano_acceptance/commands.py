"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "device accept": (
        "telenano_acceptance.accept_command:accept",
        "Lead through a motion of one minute, and report each check: pass, fail, retake or cannot say.",
    ),
    "device monitor": (
        "telenano_acceptance.look_commands:monitor",
        "Read a device without driving it, and report the age of its samples, losses and bad frames.",
    ),
    "device probe": (
        "telenano_acceptance.look_commands:probe",
        "Identify a handle, an instrument or a driver's device.",
    ),
    "device trial": (
        "telenano_acceptance.trial.trial_command:trial",
        "Try your device with a question before each step, and write one file; or make its page.",
    ),
}
