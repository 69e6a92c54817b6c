"""Gains at which a joint's loop is marginal."""
