"""The drive: everything between setpoint and joint force, as one step over pytrees."""
