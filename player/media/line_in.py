"""What comes in at a sound input, one channel, through PortAudio."""

import time
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, one_line

Take: TypeAlias = Callable[[NDArray[np.float32], float], None]  # samples, and when the first was heard (monotonic)


class LineIn:
    """take : called with every block, in a thread of PortAudio's.

    device : name or number of an input; "" for the system's.
    Raises InputError without the package, its library or such a device.
    """

    def __init__(self, device: str, take: Take) -> None:
        try:
            import sounddevice
        except ImportError:
            why = "the package sounddevice is missing; install it with: pip install 'counterlight[audio]'"
        except OSError as error:
            why = f"{one_line(error)}; install PortAudio: apt-get install libportaudio2"
        else:
            try:
                self._open(sounddevice, int(device) if device.isdecimal() else device or None, take)
                return
            except (sounddevice.PortAudioError, ValueError) as error:
                why = f"{one_line(error)}; python -m sounddevice lists what there is"
        raise InputError(f"sound input {device or 'of the system'}: {why}")

    def _open(self, sounddevice: Any, device: int | str | None, take: Take) -> None:
        def took(block: Any, count: int, times: Any, status: object) -> None:
            age_s = times.currentTime - times.inputBufferAdcTime
            take(block[:, 0], time.monotonic() - (age_s if age_s > 0 else self._stream.latency))

        self._stream = sounddevice.InputStream(device=device, channels=1, dtype="float32", callback=took)
        self.rate = float(self._stream.samplerate)

    def start(self) -> None:
        self._stream.start()

    def close(self) -> None:
        self._stream.close()
