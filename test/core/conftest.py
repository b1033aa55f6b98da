from hypothesis import HealthCheck, settings

# Seeded, without a database or wall time: the same examples on every machine.
settings.register_profile(
    "seeded",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("seeded")
