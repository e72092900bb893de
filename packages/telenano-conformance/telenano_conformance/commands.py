"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "conformance": (
        "telenano_conformance.command:conformance",
        "Check a client in any language against the rules of the protocol.",
    ),
    "law balance": (
        "telenano_conformance.balance_command:law_balance",
        "Run random sequences of events against a law, and report the energy that it generates at its ports.",
    ),
}
