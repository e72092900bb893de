"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "inspect": (
        "telenano_afm_files.inspect_command:inspect",
        "Say what a file is taken for: format, columns, units, sign, what was left out, and which command takes it.",
    ),
    "sample import": (
        "telenano_afm_files.map_commands:import_map",
        "Bring a recorded map into a file that `afm_node.sample.map` feels.",
    ),
    "sample info": (
        "telenano_afm_files.map_commands:info",
        "Show what a recorded map is, or what it lacks to be felt.",
    ),
}
