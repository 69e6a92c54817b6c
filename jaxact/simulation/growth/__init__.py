"""How fast a small perturbation of a loop grows."""
