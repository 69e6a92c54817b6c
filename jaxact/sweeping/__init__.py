"""Sweeps: what is asked (specification), its samples, their execution, and the result store."""
