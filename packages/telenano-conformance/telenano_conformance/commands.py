"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "conformance": ("telenano_conformance.command:conformance", "Tell a client in any language what it does wrong."),
}
