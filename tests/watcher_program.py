"""A watcher for tests of the player's side: records the messages, gives the answers in a file, or misbehaves.

    python -m tests.watcher_program FOLDER MANNER

Appends a JSON line per message to FOLDER/messages. MANNER is `answers` (with the line in FOLDER/answer, if it exists,
after each light), `waits` (reads nothing until FOLDER/go exists, then answers), `dies` (after the first message),
`hangs` (reads and says nothing), `floods` or `raves`.
"""

import json
import os
import sys
import time
from pathlib import Path

from counterlight.unattended.watch_link import Answer, Light, Picture, Start, Unpacker


def main(folder: Path, manner: str) -> int:
    unpacker = Unpacker()
    while manner == "hangs" or (manner == "waits" and not (folder / "go").exists()):
        time.sleep(0.01)
    while content := os.read(0, 1 << 16):
        for message in unpacker.feed(content):
            entry = {"kind": type(message).__name__}
            if isinstance(message, Light | Picture):
                array = message.grid if isinstance(message, Light) else message.drive
                entry |= {"time_s": message.time_s, "shape": array.shape, "number": float(array.mean())}
            else:
                entry |= vars(message)
            with (folder / "messages").open("a") as log:
                log.write(json.dumps(entry) + "\n")
            if manner == "dies":
                print("the camera is on fire", file=sys.stderr)
                return 3
            while manner == "floods":
                os.write(1, 100 * Answer("holding", captures=7).line())
            if manner == "raves":
                os.write(1, b"{'\xff': no answer\n")
            if isinstance(message, Light) and (folder / "answer").exists():
                os.write(1, (folder / "answer").read_bytes())
            elif isinstance(message, Start):
                os.write(1, Answer("looking").line())
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2]))
