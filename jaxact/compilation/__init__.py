"""Compiled programs: kept from run to run, called with little overhead. Numerics know nothing of
it."""
