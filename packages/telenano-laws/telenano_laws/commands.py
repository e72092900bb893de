"""Commands of this package; telenano lists them without importing the modules that they need."""

COMMANDS = {
    "law by-line": (
        "telenano_laws.by_line_command:by_line",
        "Watch the line of a running rig and change to the law that tolerates it, until Ctrl-C.",
    ),
}
