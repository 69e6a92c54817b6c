"""Isaac Lab's configclass, of which a dataclass with keywords is enough here."""

from dataclasses import dataclass


def configclass(cls):
    return dataclass(kw_only=True)(cls)
