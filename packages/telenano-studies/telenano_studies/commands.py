"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "study": (
        "telenano_studies.study_command:app",
        "Study each law in lockstep: stability, transparency.",
    ),
    "reproduce": (
        "telenano_studies.reproduce_command:reproduce",
        "Make figures and equations of the paper again, on one page.",
    ),
}
