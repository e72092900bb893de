"""The commands of this package; telenano lists them without importing their modules."""

COMMANDS = {
    "bag fetch": (
        "telenano_wide_area.fetch_command:fetch",
        "Fetch the slave's part of a session's recording, and merge it with DIR.",
    ),
    "gateway": (
        "telenano_wide_area.gateway.gateway_command:gateway",
        "Serve the page of rigs that dial out, over HTTPS, with datagrams for hand and force.",
    ),
    "relay": ("telenano_wide_area.relay.relay_command:relay", "Run a relay between two sites that can only dial out."),
}
