"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "topic pub": (
        "telenano_networks.publish_command:pub",
        "Publish messages in the place of a node that does not run, for trials and tests.",
    ),
    "link fit": (
        "telenano_networks.fit_command:fit",
        "Make settings of the link from a log of a line: its delays, how long they last, its stalls and its losses.",
    ),
    "link picture": (
        "telenano_networks.picture_command:picture",
        "Draw the way forward of networks: delay, its distribution and autocorrelation, stalls, losses, and age.",
    ),
    "link report": (
        "telenano_networks.report_command:report",
        "Show what the link did to the messages of a recording: delay, loss, stalls and order, by direction.",
    ),
    "link udp": (
        "telenano_networks.udp_command:udp",
        "Put the link between two programs that send UDP datagrams, one of which sends to LISTEN.",
    ),
    "link probe": (
        "telenano_networks.probe_command:probe",
        "Measure the network between two running sites: delay and loss of each datagram, each way.",
    ),
}
