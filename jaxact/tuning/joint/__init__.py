"""Gains of single joints and ensembles of them: theory, smooth figures, search."""
