"""Gains of whole robots: linearised loops, singular values, search."""
