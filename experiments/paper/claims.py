"""The study's claims about its joint's loop, judged, in its order.

Every verdict follows from cases that were computed; what is typed in are the study's words and how
they are read.
"""

from __future__ import annotations

from claim import Claim
from claims_on_margins import on_margins
from claims_on_motion import on_model, on_sensitivity, on_steps
from claims_on_tripling import on_tripling

from results import Results


def claims(results: Results) -> list[Claim]:
    """Every claim that can be held against the loop.

    Args:
        results: from `results.compute`.
    """
    parts = (on_model, on_steps, on_margins, on_sensitivity, on_tripling)
    return [claim for part in parts for claim in part(results)]
