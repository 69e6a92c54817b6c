"""A joint's loop in continuous time, with the exact delay."""
