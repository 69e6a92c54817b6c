"""MJX's step of a small robot, unrolled to scalar operations."""
