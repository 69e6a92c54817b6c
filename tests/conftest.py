"""Strict JAX, two CPU devices, and reproducible properties, for every test."""

import os

# Before JAX starts: it reads these once.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault("MPLBACKEND", "agg")

import hypothesis

hypothesis.settings.register_profile(
    "jaxact",
    deadline=None,  # the first example compiles
    derandomize=True,  # the same examples every time
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("jaxact")
