"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "bridge lsl": ("telenano_lsl.command:lsl", "Publish states, events and trials on the Lab Streaming Layer."),
}
