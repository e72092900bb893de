"""What every test shares: seeded property tests without a time limit on single examples."""

# first of all: with it every step is compiled in this process, as in a study
import studies  # noqa: F401, I001
from hypothesis import HealthCheck, settings

# derandomize: the same examples every run, and no database of them on disk
settings.register_profile(
    "telenano",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("telenano")
