"""Small pictures of a show for remotes, made from pictures that have already been rendered."""

import base64
import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.value_types import Choice
from counterlight.show.session import Session

PREVIEWS = Choice(("screen", "camera"))
QUALITY = 75  # quality of JPEG, 0 to 100
MOST_TIME = 0.05  # share of the show's time that previews may take
MOST_STOLEN = 0.01  # share of the frames' time that previews may take if no time is left between frames
LEAST_S = 0.5  # shortest time between two previews that delay a frame
AT_FIRST_S = 0.002  # assumed cost of the first preview, in seconds


class Previews:
    """Makes previews between frames if there is time. Otherwise each preview delays one frame, and previews are rare.

    clock : seconds, to measure the cost of a preview.
    """

    def __init__(self, session: Session, clock: Callable[[], float] = time.perf_counter) -> None:
        self._session, self._clock = session, clock
        self._costs = dict.fromkeys(PREVIEWS.words, AT_FIRST_S)
        self._made: set[str] = set()
        self._made_at = self._rests_until = float("-inf")

    def take(self, name: str, serial: float) -> dict[str, object] | None:
        """Return the JPEG picture in base64 and its serial number.

        Returns None if the client already has picture `serial`, or if there is no time now.
        """
        serial_now, began = self._session.rendered, self._clock()
        if serial_now in (0, serial) or not self._has_time(self._costs[name], began):
            return None
        picture = self._picture(name)
        if picture is None:
            return None
        jpeg = base64.b64encode(_encode(picture)).decode()
        self._made_at = self._clock()
        cost_s = self._made_at - began
        if name in self._made:  # the first preview compiles its shaders
            self._costs[name] = (self._costs[name] + cost_s) / 2
        self._made.add(name)
        self._rests_until = self._made_at + cost_s * (1 / MOST_TIME - 1)
        return {"name": name, "serial": serial_now, "jpeg": jpeg}

    def _has_time(self, cost_s: float, now_s: float) -> bool:
        if now_s < self._rests_until:
            return False
        playback = self._session.playback
        left_s = cost_s if playback is None else playback.wait_s(cost_s)
        return left_s >= cost_s or now_s - self._made_at >= max(LEAST_S, cost_s / MOST_STOLEN)

    def _picture(self, name: str) -> NDArray[np.uint8] | None:
        renderer = self._session.renderer
        return renderer.small() if name == "screen" else renderer.small_seen()


def _encode(picture: NDArray[np.uint8]) -> bytes:
    """Encode an RGB picture as JPEG."""
    done, content = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return content.tobytes()
