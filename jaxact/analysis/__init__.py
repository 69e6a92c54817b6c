"""Exact theory of the closed loop; it imports no plant and no simulation."""
