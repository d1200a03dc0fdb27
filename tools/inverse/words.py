"""Packs a room's light in words of 4 bytes during the build, so that playback only reads them."""

from counterlight import memory
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.word_map import MOST_WORDS, RoomWords, WordMap
from counterlight.tools.inverse.words_light import words_of_light

ENTRY_BYTES = 200  # per entry of T during work


def words_of(maps: RoomMaps, max_error: float) -> RoomWords | None:
    """Return words for T and Tᵀ, or None if they miss their bound, are too large, or do not support the light.

    A texture and the available memory limit the size. Blurred light has no words.

    max_error : in code values.
    """
    if maps.blurred is not None or ENTRY_BYTES * maps.transport.count > memory.available_bytes():
        return None
    found = words_of_light(maps, max_error)
    if found is None or found.used > 1 or max(small.most_words for small in found.maps.values()) > MOST_WORDS:
        return None
    return RoomWords({name: WordMap.of(small) for name, small in found.maps.items()}, found.used)
