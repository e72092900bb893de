"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "law by-line": (
        "telenano_laws.by_line_command:by_line",
        "Watch the line of a running rig and change to the law that tolerates it, until Ctrl-C.",
    ),
}
