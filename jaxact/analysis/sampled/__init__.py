"""A joint's loop as its controller samples it."""
