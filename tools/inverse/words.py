"""A room's light in words of 4 bytes, made once, so that playing only has to read them."""

from counterlight import memory
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.word_map import MOST_WORDS, RoomWords, WordMap
from counterlight.tools.inverse.words_light import words_of_light

ENTRY_BYTES = 200  # of T at work, an entry


def words_of(maps: RoomMaps, max_error: float) -> RoomWords | None:
    """Words for T and Tᵀ; None where they miss their bound, for more than a texture holds, or too little memory, and
    for blurred light, whose factors have none.

    max_error : code values.
    """
    if maps.blurred is not None or ENTRY_BYTES * maps.transport.count > memory.available_bytes():
        return None
    found = words_of_light(maps, max_error)
    if found is None or found.used > 1 or max(small.most_words for small in found.maps.values()) > MOST_WORDS:
        return None
    return RoomWords({name: WordMap.of(small) for name, small in found.maps.items()}, found.used)
