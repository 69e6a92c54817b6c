"""Gains of single joints and ensembles of them: theory, smooth metrics, search."""
