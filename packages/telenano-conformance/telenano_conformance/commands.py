"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "conformance": ("telenano_conformance.command:conformance", "Tell a client in any language what it does wrong."),
    "law balance": (
        "telenano_conformance.balance_command:law_balance",
        "Run drawn orders of events against a law, and print what energy it makes at its two ports.",
    ),
}
