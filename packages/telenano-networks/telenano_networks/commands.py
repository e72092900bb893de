"""The command of this package, which telenano lists without importing what it needs."""

COMMANDS = {
    "link probe": (
        "telenano_networks.probe_command:probe",
        "Measure the network between two running sites: delay and loss of each datagram, each way.",
    ),
}
