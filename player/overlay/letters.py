"""Text in whatever script: in DejaVu Sans, which comes along, and the system's fonts for letters that it lacks."""

import subprocess
import unicodedata
from functools import lru_cache
from importlib import resources
from itertools import groupby

from PIL import ImageDraw, ImageFont

TEXT_HEIGHT = 16  # pixels at scale 1
FONT = str(resources.files("counterlight.overlay.fonts") / "DejaVuSans.ttf")
UNWRITABLE, MISSING = "?", "\U0010ffff"  # in place of control characters; what no font has
FOUND_S = 1.0  # how long the system is asked for a font
BLOCK = 128  # letters that one question answers


def plain(text: str) -> str:
    """Text without what cannot be written, tabs kept."""
    composed = unicodedata.normalize("NFC", text)
    return "".join(
        letter if letter == "\t" or unicodedata.category(letter)[0] != "C" else UNWRITABLE for letter in composed
    )


def width(text: str, scale: float) -> float:
    """Of a text in one line, pixels."""
    return sum(font.getlength(run) for font, run in _runs(text, scale))


def write(
    brush: ImageDraw.ImageDraw, at: tuple[float, float], text: str, scale: float, fill: int, anchor: str = "ls"
) -> None:
    """Draw a line whose letters share a baseline.  anchor : Pillow's; other than at the left, all in one font."""
    left, base = at
    if anchor[0] != "l":
        brush.text(at, text, fill=fill, font=_font(FONT, scale), anchor=anchor)
        return
    for font, run in _runs(text, scale):
        brush.text((left, base), run, fill=fill, font=font, anchor=anchor)
        left += font.getlength(run)


def _runs(text: str, scale: float) -> list[tuple[ImageFont.FreeTypeFont, str]]:
    """The text in pieces of one font each."""
    return [(_font(path, scale), "".join(run)) for path, run in groupby(text, key=_font_of)]


@lru_cache(maxsize=4096)
def _font_of(letter: str) -> str:
    """The file of a font that has the letter; ours, which draws a box, if there is none."""
    if letter.isascii() or _has(FONT, letter):
        return FONT
    other = _system_font(ord(letter) // BLOCK)
    return other if other is not None and _has(other, letter) else FONT


@lru_cache(maxsize=256)
def _system_font(block: int) -> str | None:
    """What fontconfig, where there is one, names for a block of letters."""
    question = ("fc-match", "--format=%{file}", f":charset={block * BLOCK + BLOCK // 2:x}")
    try:
        answer = subprocess.run(question, capture_output=True, text=True, timeout=FOUND_S, check=True).stdout
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    return answer or None


def _has(path: str, letter: str) -> bool:
    """Whether a font draws a letter as anything but what it draws for letters that it lacks."""
    try:
        font = _font(path, 1.0)
        drawn, missing = font.getmask(letter), font.getmask(MISSING)
    except OSError:  # no font that FreeType reads
        return False
    return letter.isspace() or (drawn.size, bytes(drawn)) != (missing.size, bytes(missing))


@lru_cache(maxsize=64)
def _font(path: str, scale: float) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(path, TEXT_HEIGHT * scale)
