"""Modules of an experiment, which find each other by their plain names."""

import importlib
import sys
from contextlib import contextmanager


@contextmanager
def imported(folder, *names):
    """These modules of a folder; forgotten afterwards, as other folders have some of that name."""
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield tuple(importlib.import_module(name) for name in names)
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]
