"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "experiment": (
        "telenano_experiments.experiment_command:app",
        "Run trials of people or simulated operators over conditions.",
    ),
    "benchmark": (
        "telenano_experiments.benchmark_command:benchmark",
        "Run the benchmark of laws: which law for which network.",
    ),
}
