"""The format of the audio decoder's blocks, known to both processes; importing it does not import PyAV (0.25 s)."""

import struct

import numpy as np
from numpy.typing import NDArray

RATE, CHANNELS = 48_000, 2
HEADER = struct.Struct("<qI")  # serial, samples
NO_SOUND = -1  # serial
Samples = NDArray[np.float32]
