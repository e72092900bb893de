"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "bridge foxglove": ("telenano_foxglove.command:foxglove", "Serve every topic to Foxglove and Lichtblick."),
}
