"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "bag diff": (
        "telenano_studies.diff_command:diff",
        "Compare two recordings message by message, by channel and number.",
    ),
    "bag plot": (
        "telenano_studies.plot_command:plot",
        "Draw fields over time, on the terminal or into a PNG.",
    ),
    "compare": (
        "telenano_studies.compare_command:compare",
        "Draw sessions over one another, with one table.",
    ),
    "study": (
        "telenano_studies.study_command:app",
        "Study each law in lockstep: stability, transparency.",
    ),
    "reproduce": (
        "telenano_studies.reproduce_command:reproduce",
        "Make figures and equations of the paper again, on one page.",
    ),
}
