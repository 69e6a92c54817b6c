"""Drives and gains for other people's simulators and controllers."""
