"""What every test shares: seeded property tests without a time limit on single examples."""

from hypothesis import HealthCheck, settings

# derandomize: the same examples every run, and no database of them on disk
settings.register_profile(
    "telenano",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("telenano")
