"""What the drive uses of mjlab, as its version 1.6.0 has it."""
