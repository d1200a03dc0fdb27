"""The decoder process: `python -m counterlight.media.decoding.decoder`, started only by player/media/video.py.

Reads its arguments and then commands (JSON lines) from stdin, and writes events to stdout:

    in   {"medium": {…}, "loop": …, …}   {"free": slot}   {"seek": order}   {"quit": true}   end of file = quit
         {"skip": seconds, "serial": n}   (pictures that end before that time are no longer wanted)
    out  {"opened": {…}, "slots": n}   (the ring exists, the first picture is decoded)
         {"frame": {…}, "serial": n}   {"end": true, "serial": n}   {"error": line, "serial": n}   {"notice": line}
         {"changed": line}   (a live source has changed its picture format: open it again)
         {"busy_s": seconds}   (the heartbeat: time spent on the current picture)

Heartbeats begin before the decoding modules are imported. They distinguish a slow process from one that does not start.
"""

import gc
import json
import os
import signal
import sys
import threading
import traceback

from counterlight.media.decoding.child import limit_memory, private_stdout
from counterlight.media.decoding.mailbox import Events, Mailbox


def main() -> None:
    """Open the medium, then follow commands until the order to quit."""
    events = Events(private_stdout())
    arguments = json.loads(sys.stdin.buffer.readline())
    mailbox = Mailbox(sys.stdin.buffer)
    threading.Thread(target=events.beat, args=(mailbox,), daemon=True).start()
    gc.disable()  # imports leave no garbage; looking for it would take a ninth of their time
    from counterlight.media.decoding.laps import decode

    gc.enable()
    decode(arguments, mailbox, events)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    try:
        main()
    except BrokenPipeError:  # the parent has ended
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        # An orderly exit would wait for the thread that reads stdin, and abort.
        os._exit(1)
