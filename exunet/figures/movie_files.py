"""Moving pictures in files, written picture by picture: none but the one at hand is kept in memory.

GIF is written by Pillow, on which Matplotlib depends; MP4 by the program ffmpeg, which gets the pictures
through a pipe.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import replacing

Picture = NDArray[np.uint8]  # (height, width, 3), both even

KINDS = (".gif", ".mp4")
FASTEST = {".gif": 50.0, ".mp4": 120.0}  # [1/s]; viewers show a GIF of more at ten a second
_TICK = 100  # of a GIF [1/s]
_COLOURS = Image.Quantize.FASTOCTREE  # quick, and nearer to the colours of thin lines than others


def check_movie(path: Path, fps: float) -> None:
    """Raise what `write_movie` would, as far as it can be known before."""
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise InputError(f"{path}: the name must end in {' or '.join(KINDS)}, which says what is written")
    if not 0.0 < fps <= FASTEST[kind]:
        raise InputError(f"fps: must be above 0 and at most {FASTEST[kind]:g} for {kind}, got {fps:g}")
    if kind == ".mp4":
        _ffmpeg()


def write_movie(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """Write pictures of one size, `fps` a second; the file appears whole or not at all.

    Raises InputError for a name that ends in neither of `KINDS`, a rate out of range or a file that cannot be
    written, MissingExtra for an MP4 without ffmpeg.
    """
    check_movie(path, fps)
    with replacing(path) as part:
        if path.suffix.lower() == ".gif":
            _write_gif(part, pictures, fps)
        else:
            _write_mp4(part, pictures, fps)


def _write_gif(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """A GIF that is shown again and again, each picture with colours of its own."""
    with path.open("wb") as file:
        for number, picture in enumerate(pictures):
            image = Image.fromarray(picture).quantize(256, _COLOURS, dither=Image.Dither.NONE)
            if number == 0:
                file.writelines(GifImagePlugin.getheader(image.copy(), info={"loop": 0})[0])
            # Whole ticks, whose sum is the time that has passed.
            ticks = round(_TICK * (number + 1) / fps) - round(_TICK * number / fps)
            shown: dict[str, Any] = {"duration": 1000 * ticks // _TICK, "include_color_table": True}
            file.writelines(GifImagePlugin.getdata(image, (0, 0), **shown))
        file.write(b";")


def _write_mp4(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """H.264 with colours of half the resolution, which every player shows."""
    arriving: Iterator[Picture] = iter(pictures)
    first = next(arriving)
    height, width = first.shape[:2]
    taken = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    made = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"]
    command = [_ffmpeg(), "-y", "-loglevel", "error", *taken, *made, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as ffmpeg:
        assert ffmpeg.stdin is not None
        assert ffmpeg.stderr is not None
        try:
            for picture in chain([first], arriving):
                ffmpeg.stdin.write(picture.tobytes())
            ffmpeg.stdin.close()
        except BrokenPipeError:  # it has ended, and says why
            pass
        except BaseException:
            ffmpeg.kill()
            raise
        words = " ".join(ffmpeg.stderr.read().decode(errors="replace").split())
    if ffmpeg.returncode:
        raise InputError(f"{path.name}: ffmpeg could not write it: {words or f'code {ffmpeg.returncode}'}")


def _ffmpeg() -> str:
    """The program, on the path or of the extra."""
    if (found := shutil.which("ffmpeg")) is not None:
        return found
    if find_spec("imageio_ffmpeg") is None:
        raise MissingExtra(
            "MP4 needs the program ffmpeg, on the PATH or by pip install 'exunet[movie]'; a name that ends "
            "in .gif needs neither"
        )
    import imageio_ffmpeg

    return str(imageio_ffmpeg.get_ffmpeg_exe())
