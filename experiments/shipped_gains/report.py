"""The page of the results."""

from __future__ import annotations

from statistics import median
from typing import Any

# A loop closed in the motor's drive has less delay than this [ms].
DRIVE = 1.0
HEAD = """# How much delay do the gains that robots ship with bear?

Written by `make shipped`; not edited by hand. What is asked, and what the answer does not mean:
[experiments/shipped_gains](../../experiments/shipped_gains/README.md).

![Delay that published gains bear, robot by robot](delay_margins.png)

{summary}

Delay in the loop, at a control rate of {rate:g} Hz, at which the robot on a stand begins to shake;
with an ideal actuator, with HyQ's (800 rad/s, damping ratio 0.45) and with StarlETH's (110 rad/s,
0.9). *held*: standing in contact with the trunk held, ideal, or
*falls* where the robot does not come to rest on its feet from that keyframe. *stuck*: what MuJoCo's
linearisation at rest says, in which dry friction is very strong damping; it is not the margin of a
joint that moves. The joint is the one that shakes first on the stand, the first of those that are
alike.

| robot | gains of | stand [ms] | HyQ's [ms] | StarlETH's [ms] | joint | at [rad/s] | held [ms] | stuck [ms] | the PD loop closes in |
|---|---|---|---|---|---|---|---|---|---|
"""  # noqa: E501
MIDDLE = """
Ms, the peak of the largest singular value of S, over the delay in the loop, ideal actuator, on the
stand; where the loop is unstable, its growth rate instead.

| robot | gains of |{heads}
|---|---|{lines}
"""
TUNED = """
Gains tuned on the same stand (`jaxact tune`), as stiff as Ms and Mt of at most {peak:g} allow with
{delay:g} ms in the loop, ideal actuator. Joints of one published pattern share their gains; where no
gains within the bound were found for these, joints of one kind do (left and right, front and hind),
which is said. *stiffness*: kp over the published kp, the geometric mean of the joints, and the least
and the most of them. *bears*: all the delay in the loop at which the tuned robot begins to shake.
What is called not found was not found by this search, from the starts that `jaxact tune` makes; it
does not prove that there are none. The gains are in [shipped_gains.json](shipped_gains.json).

| robot | gains of | published: Ms at {delay:g} ms | bear [ms] | tuned: Ms, Mt | stiffness | bear [ms] | shared by |
|---|---|---|---|---|---|---|---|
"""  # noqa: E501
TAIL = """
Where the facts come from:

"""


def page(found: list[dict[str, Any]]) -> str:
    """The whole page."""
    text = HEAD.format(rate=found[0]["control_rate"], summary=summary(found))
    for row in found:
        stand = row["stand"]
        ideal = stand["ideal"]
        text += line(
            row["robot"], row["publisher"], *(milliseconds(stand[name]) for name in stand),
            ideal["joint"], number(ideal["frequency"]),
            milliseconds(row["held"]) if row["held"] else "falls",
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
    tuned = found[0]["tuned"]
    text += TUNED.format(peak=tuned["max_peak"], delay=1e3 * tuned["designed_for_delay"])
    for row in found:
        text += line(row["robot"], row["publisher"], *beside(row))
    text += TAIL
    for row in found:
        text += f"- {row['robot']}, {row['publisher']}: {row['source']}. "
        text += f"Delay published with them: {row['published_delay']}.\n"
    return text


def summary(found: list[dict[str, Any]]) -> str:
    """What came out, in sentences."""
    stands = [row["stand"]["ideal"] for row in found]
    delays = [1e3 * (stand["delay"] or 0.0) for stand in stands if stand["frequency"] is not None]
    bus = found[0]["tuned"]["designed_for_delay"]
    shaking = sum(delay <= 1e3 * bus for delay in delays)
    peaks = [at(stand, bus) for stand in stands]
    strained = sum(peak is None or peak > found[0]["tuned"]["max_peak"] for peak, _ in peaks)
    tuned = [row["tuned"] for row in found if row["tuned"]["certified"]]
    softer = sum(one["stiffness"] < 1.0 for one in tuned)
    lost = sum(row["stand"]["starleth"]["delay"] is None for row in found)
    bound, count = found[0]["tuned"]["max_peak"], len(found)
    borne = sum(delay > DRIVE for delay in delays)
    return (
        f"With ideal actuators these {count} sets of gains bear {min(delays):.3g} to "
        f"{max(delays):.3g} ms in the loop; the median is {median(delays):.3g} ms. A PD loop "
        f"closed in the motor's drive has less than {DRIVE:g} ms, which {borne} of {count} bear. "
        f"Closed on a host over a bus, with {1e3 * bus:g} ms, {shaking} of {count} shake, and "
        f"{strained} have no Ms of at most {bound:g}. With an actuator as slow as StarLETH's "
        f"{lost} shake without any delay. Gains that have one at {1e3 * bus:g} ms were found for "
        f"{len(tuned)}, softer than the published ones for {softer} of them, and stiffer for the "
        f"others."
    )


def at(stand: dict[str, Any], delay: float) -> tuple[float | None, float | None]:
    """Ms and growth rate at a delay [s]."""
    place = stand["delays"].index(delay) if delay in stand["delays"] else 0
    return stand["peak"][place], stand["growth_rate"][place]


def beside(row: dict[str, Any]) -> list[str]:
    """The published and the tuned gains of one robot, as cells."""
    ideal, tuned = row["stand"]["ideal"], row["tuned"]
    before = [level(*at(ideal, tuned["designed_for_delay"])), milliseconds(ideal)]
    shared = {"pattern": "published pattern", "kind": "kind of joint"}[tuned["shared_by"]]
    if not tuned["certified"]:
        best = "unstable" if tuned["peak"] is None else f"{tuned['peak']:.3g} at best"
        return [*before, f"not found, {best}", "", "", shared]
    factors = f"× {tuned['stiffness']:.2g} ({tuned['least']:.2g} to {tuned['most']:.2g})"
    return [*before, f"{tuned['peak']:.3g}", factors, milliseconds(tuned), shared]


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
