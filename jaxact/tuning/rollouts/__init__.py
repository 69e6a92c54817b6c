"""Gains in nonlinear rollouts: held against them, and tuned by them."""
