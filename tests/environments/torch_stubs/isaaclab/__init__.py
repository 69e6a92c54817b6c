"""What the drive uses of Isaac Lab, as its version 2.3 has it, and 3.0 still does."""
