"""A robot's sampled loop, of all joints at once."""
