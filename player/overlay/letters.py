"""Draws text in any script: with the bundled DejaVu Sans, and with system fonts for letters that it lacks."""

import subprocess
import unicodedata
from functools import lru_cache
from importlib import resources
from itertools import groupby

from PIL import ImageDraw, ImageFont

TEXT_HEIGHT = 16  # height of a line of text at scale 1, in pixels
FONT = str(resources.files("counterlight.overlay.fonts") / "DejaVuSans.ttf")
UNWRITABLE, MISSING = "?", "\U0010ffff"  # a sign for control characters; a code point that no font has
FOUND_S = 1.0  # time limit for a font query to the system
BLOCK = 128  # code points per font query


def plain(text: str) -> str:
    """Replace characters that cannot be drawn. Tabs are kept."""
    composed = unicodedata.normalize("NFC", text)
    return "".join(
        letter if letter == "\t" or unicodedata.category(letter)[0] != "C" else UNWRITABLE for letter in composed
    )


def width(text: str, scale: float) -> float:
    """Return the width of a line of text, in pixels."""
    return sum(font.getlength(run) for font, run in _runs(text, scale))


def write(
    brush: ImageDraw.ImageDraw, at: tuple[float, float], text: str, scale: float, fill: int, anchor: str = "ls"
) -> None:
    """Draw a line of text on a common baseline.

    at : (x, y) in pixels.
    scale : factor of TEXT_HEIGHT.
    fill : grey value, 0 to 255.
    anchor : Pillow's anchor. Text that is not left-aligned uses only one font.
    """
    left, base = at
    if anchor[0] != "l":
        brush.text(at, text, fill=fill, font=_font(FONT, scale), anchor=anchor)
        return
    for font, run in _runs(text, scale):
        brush.text((left, base), run, fill=fill, font=font, anchor=anchor)
        left += font.getlength(run)


def _runs(text: str, scale: float) -> list[tuple[ImageFont.FreeTypeFont, str]]:
    """Split the text into pieces that each use one font."""
    return [(_font(path, scale), "".join(run)) for path, run in groupby(text, key=_font_of)]


@lru_cache(maxsize=4096)
def _font_of(letter: str) -> str:
    """Return the file of a font that has this letter, or the file of the bundled font, which draws a box."""
    if letter.isascii() or _has(FONT, letter):
        return FONT
    other = _system_font(ord(letter) // BLOCK)
    return other if other is not None and _has(other, letter) else FONT


@lru_cache(maxsize=256)
def _system_font(block: int) -> str | None:
    """Return the font file that fontconfig names for a block of code points, None without fontconfig."""
    question = ("fc-match", "--format=%{file}", f":charset={block * BLOCK + BLOCK // 2:x}")
    try:
        answer = subprocess.run(question, capture_output=True, text=True, timeout=FOUND_S, check=True).stdout
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    return answer or None


def _has(path: str, letter: str) -> bool:
    """Whether a font has a letter, that is, draws it differently from a missing letter."""
    try:
        font = _font(path, 1.0)
        drawn, missing = font.getmask(letter), font.getmask(MISSING)
    except OSError:  # FreeType cannot read the font
        return False
    return letter.isspace() or (drawn.size, bytes(drawn)) != (missing.size, bytes(missing))


@lru_cache(maxsize=64)
def _font(path: str, scale: float) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(path, TEXT_HEIGHT * scale)
