"""What all tests share."""

from hypothesis import HealthCheck, settings

# No test depends on time: how long an example takes says more about the machine than about us.
settings.register_profile("sfol", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("sfol")
