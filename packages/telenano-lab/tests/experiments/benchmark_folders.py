"""The folders whose code decides what a run of the benchmark gives."""

COMPUTED_BY = (
    "packages/telenano-lab/telenano_lab/", "packages/telenano-laws/", "telenano/afm/", "telenano/analysis/",
    "telenano/hand/", "telenano/laws/", "telenano/link/", "telenano/lockstep/", "telenano/numerics/",
)  # fmt: skip
