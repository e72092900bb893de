"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "inspect": (
        "telenano_afm_files.inspect_command:inspect",
        "Show how a file is read: format, columns, units, sign, what was left out, and which command uses it.",
    ),
    "sample import": (
        "telenano_afm_files.map_commands:import_map",
        "Convert a recorded map into a file for `afm_node.sample.map`.",
    ),
    "sample info": (
        "telenano_afm_files.map_commands:info",
        "Show what a recorded map contains, or what it lacks to be felt.",
    ),
}
