"""The page of the results."""

from __future__ import annotations

from typing import Any

HEAD = """# How much delay do the gains that robots ship with bear?

Written by `make shipped`; not edited by hand. What is asked, and what the answer does not mean:
[experiments/shipped_gains](../../experiments/shipped_gains/README.md).

![Delay that published gains bear, robot by robot](delay_margins.png)

Delay in the loop, at a control rate of {rate:g} Hz, at which the robot on a stand begins to shake;
with an ideal actuator, with HyQ's (800 rad/s, damping ratio 0.45) and with StarlETH's (110 rad/s,
0.9). *held*: standing in contact with the trunk held, ideal. *stuck*: what MuJoCo's linearisation
at rest says, in which dry friction is very strong damping; it is not the margin of a joint that
moves. The joint is the one that shakes first on the stand.

| robot | gains of | stand [ms] | HyQ's [ms] | StarlETH's [ms] | joint | at [rad/s] | held [ms] | stuck [ms] | the PD loop closes in |
|---|---|---|---|---|---|---|---|---|---|
"""  # noqa: E501
MIDDLE = """
Ms, the peak of the largest singular value of S, over the delay in the loop, ideal actuator, on the
stand; where the loop is unstable, its growth rate instead.

| robot | gains of |{heads}
|---|---|{lines}
"""
TAIL = """
Where the facts come from:

"""


def page(found: list[dict[str, Any]]) -> str:
    """The whole page."""
    text = HEAD.format(rate=found[0]["control_rate"])
    for row in found:
        stand = row["stand"]
        ideal = stand["ideal"]
        text += line(
            row["robot"], row["publisher"], *(milliseconds(stand[name]) for name in stand),
            ideal["joint"], number(ideal["frequency"]), milliseconds(row["held"]),
            milliseconds(row["stuck"]) if ideal["friction_left_out"] else "no friction",
            row["closes"],
        )  # fmt: skip
    delays = found[0]["stand"]["ideal"]["delays"]
    text += MIDDLE.format(
        heads="".join(f" {1e3 * delay:g} ms |" for delay in delays), lines="---|" * len(delays)
    )
    for row in found:
        ideal = row["stand"]["ideal"]
        cells = zip(ideal["peak"], ideal["growth_rate"], strict=True)
        text += line(row["robot"], row["publisher"], *(level(*cell) for cell in cells))
    text += TAIL
    for row in found:
        text += f"- {row['robot']}, {row['publisher']}: {row['source']}. "
        text += f"Delay published with them: {row['published_delay']}.\n"
    return text


def line(*cells: str) -> str:
    """A line of a table."""
    return f"| {' | '.join(cells)} |\n"


def milliseconds(row: dict[str, Any]) -> str:
    """A delay margin; none where the loop shakes without any delay, or bears any."""
    if row["delay"] is None:
        return "shakes" if row["frequency"] is not None else "any"
    return f"{1e3 * row['delay']:.3g}"


def number(value: float | None) -> str:
    """Three digits."""
    return "" if value is None else f"{value:.3g}"


def level(peak: float | None, growth: float | None) -> str:
    """Ms, or how fast it grows."""
    return f"{peak:.3g}" if peak is not None else f"{growth:+.3g} 1/s"
