"""Two motions beside each other: labels, the time, and how fast the joints move."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxact.plotting import theme

_GAP = 4  # pixels between the two
_HEAD, _STRIP = 0.085, 0.2  # heights of the label and of the strip below, as shares of an image's
_SMALL = 0.75  # height of the small print, as a share of the label's
_STILL = 1e-3  # joints that are slower stand still, whatever rounding makes of them [rad/s or m/s]
_COLOURS = (theme.BLUE, theme.VERMILION)


@dataclass(frozen=True)
class Side:
    """One of the two motions.

    Attributes:
        images: RGB, each of shape (height, width, 3), uint8, all of one size.
        label: what is seen.
        speed: of the joints at every frame, shape (frames,): drawn as a line that grows.
        note: said below the label, "" for nothing.
    """

    images: Iterable[np.ndarray]
    label: str
    speed: np.ndarray
    note: str = ""


def side_by_side(
    left: Side,
    right: Side,
    *,
    times: Sequence[float],
    speed: float,
    unit: str = "rad/s",
    caption: str = "",
) -> Iterator[np.ndarray]:
    """Frames of a film of two motions.

    Args:
        left, right: what is shown; as many images as there are times.
        times: of the frames [s], shape (frames,).
        speed: 1 for real time, 0.25 for four times slower; only said.
        unit: of the joint speed.
        caption: small print below, "" for nothing.

    Yields:
        RGB images of even width and height, shape (height, width, 3), uint8.
    """
    highest = max(float(np.max(left.speed)), float(np.max(right.speed)), _STILL)
    pace = "" if speed == 1.0 else f"   {_pace(speed)}"
    for index, (time, *pair) in enumerate(zip(times, left.images, right.images, strict=True)):
        height, width, _ = pair[0].shape
        head, strip = round(_HEAD * height), round(_STRIP * height)
        foot = head + (round(_SMALL * head) if caption else 0)
        size = (2 * width + _GAP, head + height + strip + foot)
        paper = Image.new("RGB", tuple(length + length % 2 for length in size), "white")
        draw = ImageDraw.Draw(paper)
        for number, (side, picture) in enumerate(zip((left, right), pair, strict=True)):
            x = number * (width + _GAP)
            paper.paste(Image.fromarray(picture), (x, head))
            _centred(draw, x + width / 2, head / 2, side.label, head, _COLOURS[number], bold=True)
            if side.note:
                _centred(draw, x + width / 2, 1.6 * head, side.note, 0.8 * head, theme.VERMILION)
            box = (x, head + height + 0.36 * strip, x + width, head + height + strip)
            _strip(draw, box, side.speed[: index + 1] / highest, len(side.speed), _COLOURS[number])
            words = f"joint speed, rms: {side.speed[index]:.3g} {unit}"
            font = _font(0.23 * strip, bold=False)
            draw.text(
                (x + 0.16 * strip, head + height + 0.08 * strip), words, fill=theme.INK, font=font
            )
        below = head + height + strip
        _centred(draw, size[0] / 2, below + head / 2, f"{time:.2f} s{pace}", head, theme.INK)
        if caption:
            room = (size[0] / 2, below + (1.0 + 0.5 * _SMALL) * head)
            _centred(draw, *room, caption, _fitting(caption, _SMALL * head, size[0]), theme.INK)
        yield np.asarray(paper)


def _pace(speed: float) -> str:
    return f"{1 / speed:.3g} times slower" if speed < 1.0 else f"{speed:.3g} times faster"


def _strip(
    draw: ImageDraw.ImageDraw,
    box: tuple[float, float, float, float],
    heights: np.ndarray,
    frames: int,
    colour: str,
) -> None:
    """A line that has come as far as there are heights, which are shares of the box."""
    left, top, right, bottom = box
    margin = 0.08 * (bottom - top)
    x = np.linspace(left + margin, right - margin, max(frames, 2))
    y = bottom - margin - (bottom - top - 2.0 * margin) * heights
    ground = [(float(x[0]), bottom - margin), (float(x[-1]), bottom - margin)]
    draw.line(ground, fill=theme.FAINT, width=1)
    points = [(float(a), float(b)) for a, b in zip(x, y, strict=False)]
    if len(points) > 1:
        draw.line(points, fill=colour, width=2)


def _centred(
    draw: ImageDraw.ImageDraw,
    x: float,
    y: float,
    words: str,
    height: float,
    colour: str,
    *,
    bold: bool = False,
) -> None:
    draw.text((x, y), words, fill=colour, font=_font(0.62 * height, bold=bold), anchor="mm")


def _fitting(words: str, height: float, width: float) -> float:
    """A height of one line at which these words fit the width."""
    length = _font(0.62 * height, bold=False).getlength(words)
    return height * min(1.0, 0.97 * width / max(length, 1.0))


@cache
def _font(size: float, *, bold: bool) -> ImageFont.FreeTypeFont:
    """The typeface of the pictures, which matplotlib brings along."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/{name}", max(size, 6.0))
