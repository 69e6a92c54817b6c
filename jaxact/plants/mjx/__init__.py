"""MuJoCo models in MJX."""
