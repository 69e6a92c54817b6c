"""What a drive may have been identified with and no loop has, in words."""

OFFSET = "a constant force"
"""What is said of an offset. Every joint of a robot has one: of its encoder, or of cables."""
UNMODELLED = {
    "viscous_asymmetry": "viscous friction that differs by direction",
    "coulomb_asymmetry": "dry friction that differs by direction",
    "loaded": "friction that grows with the drive's force",
    "stribeck": "larger friction at rest",
    "offset": OFFSET,
}
"""By the model's numbers."""
