"""`jaxact info`: versions, devices, precision and caches."""

from __future__ import annotations

import json as _json
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

from tyro.conf import arg

from jaxact import __version__
from jaxact.cli import _xla
from jaxact.sweeping import cache

PACKAGES = (
    "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "optax", "numpy", "scipy", "xarray",
    "zarr", "h5netcdf", "pydantic", "tyro", "rich", "matplotlib",
)  # fmt: skip


def main(*, json: Annotated[bool, arg(help="Print JSON instead of a table.")] = False) -> None:
    """Show versions, devices, precision and caches: what a bug report needs.

    examples:
      jaxact info
      jaxact info --json
    """
    facts = collect()
    if json:
        print(_json.dumps(facts, indent=2))
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        shown = ", ".join(map(str, value)) if isinstance(value, list) else value
        print(f"{name:{width}}  {'none' if value in (None, '', []) else shown}")


def collect() -> dict[str, Any]:
    """Everything `jaxact info` shows, by name; text, numbers and lists of them."""
    import jax

    return {
        "jaxact": __version__,
        "python": platform.python_version(),
        **{name: _installed(name) for name in PACKAGES},
        "platform": platform.platform(),
        "cpu cores": _xla.cores(),  # a sweep makes one JAX device of each
        "jax backend": jax.default_backend(),
        "jax devices": [f"{device} ({device.device_kind})" for device in jax.devices()],
        "engine warp": _engine_warp(),
        "float64 by default": bool(jax.config.jax_enable_x64),
        "sweep precision": "float32, or float64 with --set precision=float64",
        "cache": str(cache.folder()),
        "JAX_COMPILATION_CACHE_DIR": os.environ.get("JAX_COMPILATION_CACHE_DIR", ""),
        "JAXACT_PROGRAMS": os.environ.get("JAXACT_PROGRAMS", ""),
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", ""),
        "JAX_PLATFORMS": os.environ.get("JAX_PLATFORMS", ""),
    }


def _engine_warp() -> str:
    """Whether it can be used, and what is missing where it cannot."""
    from jaxact.plants import warp

    return warp.lacking() or "can be used"


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
