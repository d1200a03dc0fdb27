"""The format of the sound decoder's blocks; importing it must not import PyAV (0.25 s)."""

import struct

import numpy as np
from numpy.typing import NDArray

RATE, CHANNELS = 48_000, 2
HEADER = struct.Struct("<qI")  # serial, number of samples
NO_SOUND = -1  # serial that means a medium without sound
Samples = NDArray[np.float32]
