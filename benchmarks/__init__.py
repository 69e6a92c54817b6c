"""Benchmarks against named rivals; every figure is a ratio of two timings of the same run."""
