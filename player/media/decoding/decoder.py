"""The decoder process: `python -m counterlight.media.decoding.decoder`, started by player/media/video.py alone.

Reads its arguments and then commands (JSON lines) from stdin, writes events to stdout:

    in   {"medium": {…}, "loop": …, …}   {"free": slot}   {"seek": order}   {"quit": true}   end of file = quit
         {"skip": seconds, "serial": n}   (pictures that end before that time are no longer wanted)
    out  {"opened": {…}, "slots": n}   (the ring is there, the first picture decoded)
         {"frame": {…}, "serial": n}   {"end": true, "serial": n}   {"error": line, "serial": n}   {"notice": line}
         {"changed": line}   (a live source sends other pictures than those that were told: open it again)
         {"busy_s": seconds}   (the heartbeat: time spent on the current picture)

It beats before it imports what decodes, so that one that does not start is told from one that is slow.
"""

import json
import os
import signal
import sys
import threading
import traceback

from counterlight.media.decoding.child import limit_memory, private_stdout
from counterlight.media.decoding.mailbox import Events, Mailbox


def main() -> None:
    """Open the medium, then follow orders until told to quit."""
    events = Events(private_stdout())
    arguments = json.loads(sys.stdin.buffer.readline())
    mailbox = Mailbox(sys.stdin.buffer)
    threading.Thread(target=events.beat, args=(mailbox,), daemon=True).start()
    from counterlight.media.decoding.laps import decode

    decode(arguments, mailbox, events)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    try:
        main()
    except BrokenPipeError:  # the parent has gone
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        # An orderly exit would wait for the thread that reads stdin, and abort.
        os._exit(1)
