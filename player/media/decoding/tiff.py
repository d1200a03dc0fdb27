"""Prepares TIFF pictures for FFmpeg's strict decoder by removing the tags that it does not know."""

import struct

# The tags that FFmpeg 7's decoder reads and that describe how pixels are stored. In strict mode it refuses all other
# tags,
# such as orientation, page or software, which other programs write.
KNOWN = {
    *(254, 256, 257, 258, 259, 262, 266, 273, 277, 278, 279, 282, 283, 284),
    *(292, 293, 317, 320, 322, 323, 324, 325, 330, 530),
}
ENTRY = 12  # bytes


def known_tags(data: bytes) -> bytes:
    """Return a TIFF file's bytes with only the KNOWN tags in its index. Other files are returned unchanged."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None or len(data) < 8:
        return data
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    if at + 2 > len(data):
        return data
    (count,) = struct.unpack_from(f"{order}H", data, at)
    first, end = at + 2, at + 2 + count * ENTRY
    if end > len(data):
        return data
    entries = [data[place : place + ENTRY] for place in range(first, end, ENTRY)]
    kept = [entry for entry in entries if struct.unpack_from(f"{order}H", entry)[0] in KNOWN]
    index = struct.pack(f"{order}H", len(kept)) + b"".join(kept) + b"\0" * 4  # no further picture
    return data[:at] + index + data[at + len(index) :]
