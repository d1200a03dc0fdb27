"""Check the arguments of the Python API: TypeError for a wrong kind of value, otherwise InputError.

Pictures follow one rule everywhere. uint8 and uint16 arrays are sRGB code values, as `counterlight play` reads them
from a file. Floats are linear light. Other integers are refused, because their scale is unknown.
"""

import operator
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from itertools import permutations
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import RADIANCE
from counterlight.errors import InputError, nearest, one_line, shown
from counterlight.files.picture_files import MAX_SIDE
from counterlight.response import TABLE_SIZE, Response, parse_response, projector_response, transfer_table
from counterlight.tools.transport.arrays import CODES, NOT_LIGHT
from counterlight.tools.transport.transport import Csr

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
Shape: TypeAlias = tuple[int, int]

TOO_BRIGHT = 2.0  # a picture with a larger median, relative to white, would be almost entirely clipped
OPTION = re.compile(r"--([a-z][a-z0-9]*(?:-[a-z0-9]+)*)")
# Options of the commands whose argument has another name.
NAMED = {"regularize": "damping", "force": "force=True", "radius": "parameters.radius", "no-refine": "refine=False"}


def in_python(**named: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate an API function: its InputErrors name arguments where the library names command options.

    named : option=argument pairs of this function only.

    A system error on a file or folder also becomes an InputError.
    """
    names = NAMED | named

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                return function(*args, **kwargs)
            except InputError as error:
                text = OPTION.sub(lambda match: names.get(match[1], match[1].replace("-", "_")), str(error))
                raise type(error)(text.replace(" the option ", " the argument ")) from error.__cause__
            except OSError as error:
                if error.filename is None:
                    raise
                raise InputError(f"{error.filename}: {error.strerror}; check the path and its rights") from error

        return checked

    return decorated


def instance(value: T, kind: type, name: str, fix: str = "") -> T:
    if not isinstance(value, kind):
        raise TypeError(f"{name}: expected {kind.__name__}, found {type(value).__name__}{fix and f'; {fix}'}")
    return value


def whole(value: int, name: str, low: int, high: int) -> int:
    """Returns a whole number within bounds."""
    if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
        raise TypeError(f"{name}={shown(value)}: expected a whole number")
    if not low <= (number := operator.index(value)) <= high:
        raise InputError(f"{name}={number}: expected {low} to {high}")
    return number


def number(value: object, name: str, low: float, high: float) -> float:
    """Returns a real number within bounds."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise TypeError(f"{name}={shown(value)}: expected a number")
    found = float(value)
    if not low <= found <= high:
        bounds = f"at least {low:g}" if high == float("inf") else f"{low:g} to {high:g}"
        raise InputError(f"{name}={found:g}: expected {bounds}")
    return found


def white(value: float | None, usual: float) -> float:
    """Returns a radiance; `usual` for None."""
    return usual if value is None else number(value, "white", *RADIANCE)


def size(value: Sequence[int], name: str) -> Shape:
    """Returns a size (height, width)."""
    try:
        height, width = value
    except (TypeError, ValueError):
        raise TypeError(f"{name}={shown(value)}: expected (height, width) in pixels") from None
    return whole(height, f"{name} height", 1, MAX_SIDE), whole(width, f"{name} width", 1, MAX_SIDE)


def choice(value: str, name: str, known: Iterable[str]) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name}={shown(value)}: expected one of {', '.join(known)}")
    if value not in known:
        raise InputError(f"{name}={value!r}: expected one of {', '.join(known)}{nearest(value, known)}")
    return value


def words(values: Iterable[str], name: str) -> tuple[str, ...]:
    """Returns several names; TypeError for a single string, which would be split into letters."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise TypeError(f"{name}={shown(values)}: expected a list of names")
    names = tuple(values)
    if not all(isinstance(each, str) for each in names):
        raise TypeError(f"{name}={shown(names)}: expected a list of names")
    return names


def path(value: str | PathLike[str], name: str) -> Path:
    if not isinstance(value, str | PathLike):
        raise TypeError(f"{name}={shown(value)}: expected a path")
    if not str(value):
        raise InputError(f"{name} is empty; expected a path")
    if "\0" in str(value):
        raise InputError(f"{name}={shown(value)}: contains a NUL character; expected a path")
    return Path(value)


def response(value: object) -> Response:
    """Returns a response from a Response, "linear", "srgb", a gamma, a table, or a .toml file with one of these."""
    if isinstance(value, Response):
        return value
    if isinstance(value, str | PathLike):
        return projector_response(str(value))
    if isinstance(value, np.ndarray | np.generic | tuple):
        value = np.asarray(value).tolist()
    return parse_response(value)


def picture(values: ArrayLike, shape: Shape, name: str = "picture", *, of_white: bool = False) -> FloatArray:
    """Returns linear light (height, width, 3) from a picture of that size, one colour (3,), or one grey value.

    of_white : the picture is in multiples of white; warns if most of it is far above 1.
    """
    array = real_array(values, name)
    if array.dtype.kind in "iu" and not isinstance(values, int):  # a Python number is light: 1 is white
        if array.dtype.newbyteorder("=") not in CODES:
            raise InputError(
                f"{name} of {array.dtype}: expected sRGB code values as uint8 (0 to 255) or uint16 (0 to 65535), or "
                f"linear light as floats; convert it, such as {name}.astype(np.uint8)"
            )
        return _shaped(_linear(array), shape, name)
    light = _shaped(array.astype(np.float64), shape, name)
    if of_white and (median := float(np.median(light))) > TOO_BRIGHT:
        finding = f"{name}: its median is {median:g} times white; floats are linear light, 1 being white"
        warnings.warn(f"{finding}; pass code values as uint8 or uint16", stacklevel=4)
    return light


def radiance(values: ArrayLike, shape: Shape, name: str) -> NDArray[np.float32]:
    """Returns (height, width, 3) in the camera's unit of light; accepts the same as `picture`, except code values."""
    array = real_array(values, name)
    if array.dtype.kind in "iu" and array.ndim:
        raise InputError(f"{name} of {array.dtype}: {NOT_LIGHT}")
    return _shaped(array.astype(np.float64), shape, name).astype(np.float32)


def mask(values: ArrayLike, shape: Shape) -> BoolArray:
    """Returns a mask (height, width) from True and False, or from 0 and one other number."""
    array = real_array(values, "mask")
    if array.shape != shape:
        raise InputError(f"mask of shape {array.shape}, expected {shape}{_reordered(array.shape, shape, 'mask')}")
    if not np.isin(array, (0, array.max())).all():
        raise InputError(f"mask of {array.dtype} with many values, expected True and False; compare it, as mask > 0.5")
    if not array.any():
        raise InputError("mask: no camera pixel counts, expected at least 1")
    return array.astype(bool)


def matrix(values: object, name: str) -> Csr:
    """Returns a copy as sparse rows, float32, with duplicates summed."""
    known = sparse.issparse(values) or isinstance(values, list | tuple)
    if not (known or hasattr(values, "__array__") or hasattr(values, "__dlpack__")):
        raise TypeError(f"{name}: expected a matrix of scipy.sparse or an array, found {type(values).__name__}")
    found: Any = values if sparse.issparse(values) else real_array(values, name)
    if len(found.shape) != 2 or found.dtype.kind not in "fiub":
        raise InputError(f"{name}: {found.dtype} of shape {found.shape}, expected real numbers in rows and columns")
    if found.dtype in CODES:
        raise InputError(f"{name} of {found.dtype}: {NOT_LIGHT}")
    with np.errstate(over="ignore"):  # values beyond float32 become infinite, which the caller refuses
        rows = Csr(found, dtype=np.float32, copy=True)
    rows.sum_duplicates()
    return rows


def real_array(values: object, name: str) -> NDArray[Any]:
    """Convert values to an array of real numbers by `__array__` or DLPack; TypeError if numpy cannot."""
    if isinstance(values, np.ma.MaskedArray):
        raise TypeError(f"{name}: a masked array, whose mask would be lost; fill it first, with its method filled(0)")
    try:
        exported = hasattr(values, "__dlpack__") and not hasattr(values, "__array__")
        array = np.from_dlpack(values) if exported else np.asarray(values)  # type: ignore[arg-type]
    except Exception as error:  # methods of the object may raise anything
        raise TypeError(f"{name}: {type(values).__name__} is no array of numbers ({one_line(error)})") from None
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name}: {array.dtype} of shape {array.shape}, expected an array of real numbers")
    return array


def _linear(codes: NDArray[Any]) -> FloatArray:
    """Returns linear light, 0 to 1, of sRGB code values, from the player's table."""
    shares = codes / np.iinfo(codes.dtype).max
    return np.asarray(np.interp(shares, np.linspace(0, 1, TABLE_SIZE), transfer_table("srgb")), np.float64)


def _shaped(array: FloatArray, shape: Shape, name: str) -> FloatArray:
    expected = (*shape, 3)
    if array.shape not in ((), (3,), expected):
        fix = _reordered(array.shape, expected, name)
        if array.shape == shape:
            fix = f"; repeat grey in three channels, as np.repeat({name}[..., None], 3, axis=2)"
        if array.shape == (*shape, 4):
            fix = f"; leave the fourth channel out, as {name}[..., :3]"
        raise InputError(f"{name} of shape {array.shape}, expected {expected}{fix}")
    if len(bad := np.argwhere(~np.isfinite(array))):
        first = f", the first at index {tuple(map(int, bad[0]))}" if array.ndim else ""
        raise InputError(
            f"{name}: {len(bad)} of {array.size} values are NaN or infinity{first}; repair the measurement"
        )
    if np.abs(array).max() > RADIANCE[1]:
        raise InputError(f"{name} holds {np.abs(array).max():g}, expected at most {RADIANCE[1]:g}; use another unit")
    return np.broadcast_to(array, expected)


def _reordered(found: tuple[int, ...], expected: tuple[int, ...], name: str) -> str:
    """Returns how to bring the axes of an array into the expected order; nothing if the shape is another one."""
    for order in permutations(range(len(found))):
        if tuple(found[axis] for axis in order) == expected:
            what = "width and height are swapped" if order[:2] == (1, 0) else "the channels come last"
            return f"; {what}, as in {name}.transpose{order}"
    return ""
