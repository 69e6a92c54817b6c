"""Loops simulated: rollouts, metrics, verdicts and growth rates, one or many at once."""
