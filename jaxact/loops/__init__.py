"""The loop: what it consists of, read from a specification, and advanced by one control period."""
