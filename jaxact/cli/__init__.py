"""The command line: one module for each verb, thin; `main` is the entry point."""
