"""The command of this package, which telenano lists without importing what it needs."""

COMMANDS = {
    "device accept": (
        "telenano_acceptance.accept_command:accept",
        "Lead through a motion of a minute, and tell of each of its checks: pass, fail, retake or cannot say.",
    ),
}
