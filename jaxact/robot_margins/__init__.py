"""What is asked of a robot's loop as a specification describes it."""
