"""What a verb compiles, kept from process to process, where Python asks for it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from jaxact import files
from jaxact.compilation import programs
from jaxact.errors import UserError
from jaxact.sweeping import cache


def keep_programs(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep what jaxact compiles for the processor, so that the next process need not compile it.

        jaxact.keep_programs()

    The command line does so by itself. Without this call every process compiles anew: some 20 s
    for the first margins of a joint. What the caller transforms (`jax.vmap`, `jax.grad`, `jax.jit`)
    is JAX's to keep: `jax.config.update("jax_compilation_cache_dir", ...)`.

    Args:
        folder: which only its owner may write to, as what is in it is run; None for the one that
            `JAXACT_PROGRAMS` names in the environment, or else the command line's in the user's
            cache folder. Made where it is not there. At most 1 GiB is kept in it.

    Returns:
        The folder, for this process and those that it starts; it may be deleted at any time.

    Raises:
        UserError: the folder cannot be made or written, or others can write to it.
    """
    named = os.environ.get(programs.FOLDER, "") if folder is None else folder
    try:
        path = Path(named).expanduser().absolute() if named else cache.folder() / "programs"
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except (OSError, RuntimeError, TypeError, ValueError) as error:  # RuntimeError: no home
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"folder {named or 'for what is compiled'}: {reason}") from None
    if reason := files.shared(path):
        raise UserError(f"folder {path}: {reason}; what is kept in it would be run")
    os.environ[programs.FOLDER] = str(path)
    return path
