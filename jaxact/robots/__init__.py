"""What is read from an MJCF or URDF: actuators, joints, base, posture, and what is said of each."""
