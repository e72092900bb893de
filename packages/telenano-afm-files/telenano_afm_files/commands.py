"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "sample import": (
        "telenano_afm_files.map_commands:import_map",
        "Bring a recorded map into a file that `afm_node.sample.map` feels.",
    ),
    "sample info": (
        "telenano_afm_files.map_commands:info",
        "Show what a recorded map is, or what it lacks to be felt.",
    ),
}
