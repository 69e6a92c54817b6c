"""Images to a film: a GIF with what is there, an MP4 where ffmpeg is to be had."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from jaxact import files
from jaxact.errors import UserError

FORMATS = ("gif", "mp4")
_SAMPLED = 6  # images that the colours of a GIF are chosen from


def check_output(path: Path, fps: float) -> Path:
    """The path of a film to be written, if it can be.

    Args:
        path: its ending is the format.
        fps: frames per second; those of a GIF last whole hundredths of a second.

    Raises:
        UserError: another format, a rate that the format does not have, a folder that is not there,
            and an MP4 without ffmpeg.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        said = f"'.{suffix}' is not a film format" if suffix else "the name has no ending"
        raise UserError(f"output {path}: {said}; use .gif or .mp4")
    files.check_output(path)
    if suffix == "gif" and not (round(100 / fps) >= 2 and abs(100 / fps % 1.0) < 1e-9):
        raise UserError(f"a GIF cannot show {fps:g} frames per second; use 50, 25, 20 or 10")
    if suffix == "mp4" and _ffmpeg() is None:
        raise UserError(
            "an MP4 needs ffmpeg, which is not here; install it, or jaxact[video], which brings "
            "it along, or write a .gif"
        )
    return path


def moments(time: np.ndarray, *, fps: float, speed: float) -> np.ndarray:
    """Which samples of a motion a film shows, shape (frames,): the last before each frame's time.

    Args:
        time: of the samples [s], increasing, shape (steps,).
        fps: frames per second of the film.
        speed: 1 for real time, 0.25 for four times slower.
    """
    count = int(np.floor((time[-1] - time[0]) * fps / speed + 1e-9)) + 1
    shown = time[0] + np.arange(count) * speed / fps
    return np.clip(np.searchsorted(time, shown + 1e-9, side="right") - 1, 0, len(time) - 1)


def write(images: Iterable[np.ndarray], path: Path, *, fps: float) -> None:
    """Write a film, whole or not at all; one that is there is replaced.

    Args:
        images: RGB, each of shape (height, width, 3), uint8, all of one size; even sizes for MP4.
        path: .gif or .mp4.
        fps: frames per second.

    Raises:
        UserError: as `check_output`, the folder cannot be written to, or ffmpeg fails.
    """
    check_output(path, fps)
    save = _save_gif if path.suffix.lower() == ".gif" else _save_mp4
    with files.output(path) as partial:
        save(iter(images), partial, fps)


def _save_gif(images: Iterator[np.ndarray], path: Path, fps: float) -> None:
    """One palette for all images: else what stands still flickers, and the file is far larger."""
    pictures = [Image.fromarray(image) for image in images]
    chosen = np.linspace(0, len(pictures) - 1, min(_SAMPLED, len(pictures))).round().astype(int)
    width, height = pictures[0].size
    montage = Image.new("RGB", (width, height * len(chosen)))
    for row, index in enumerate(chosen):
        montage.paste(pictures[index], (0, row * height))
    palette = montage.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    reduced[0].save(
        path, format="GIF", save_all=True, append_images=reduced[1:], duration=round(1000 / fps),
        loop=0, optimize=False,
    )  # fmt: skip


def _save_mp4(images: Iterator[np.ndarray], path: Path, fps: float) -> None:
    """H.264 in the colour format that every player has."""
    first = next(images)
    height, width, _ = first.shape
    command = [
        str(_ffmpeg()), "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264",
        "-pix_fmt", "yuv420p", "-crf", "22", "-movflags", "+faststart", str(path),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        coder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said)
        assert coder.stdin is not None
        try:
            for image in itertools.chain([first], images):
                coder.stdin.write(np.ascontiguousarray(image).tobytes())
            coder.stdin.close()
        except BrokenPipeError:
            with contextlib.suppress(BrokenPipeError):  # its own words, below, say more
                coder.stdin.close()
        except BaseException:
            coder.kill()
            raise
        finally:
            code = coder.wait()
        said.seek(0)
        if code != 0:
            lines = said.read().decode(errors="replace").strip().splitlines()
            raise UserError(f"ffmpeg failed: {lines[-1] if lines else f'exit code {code}'}")


def _ffmpeg() -> str | None:
    """The program, from the PATH or from the package imageio-ffmpeg; None without it."""
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        import imageio_ffmpeg
    except ImportError:
        return None
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError:  # the package is there without the program
        return None
