"""Compiled work that is waited for, so that a Ctrl-C does not wait for its end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Result = TypeVar("Result")


def waited(work: Callable[[], Result]) -> Result:
    """What work gives, done in a thread of its own where the main one would be busy with it.

    Python hears of a signal between two of its own instructions, and a compilation or a compiled
    loop is one of them. Interrupted, the work goes on unseen, and what it gives is dropped.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    import jax

    ended: Future[Result] = Future()
    # A thread begins with JAX's defaults.
    double = jax.numpy.result_type(float) == jax.numpy.float64

    def run() -> None:
        try:
            with jax.enable_x64(bool(double)):
                ended.set_result(work())
        except BaseException as error:
            ended.set_exception(error)

    threading.Thread(target=run, name="compiled work").start()
    return ended.result()
