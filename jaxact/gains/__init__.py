"""Gains in other people's files: read, matched to joints by name, written."""
