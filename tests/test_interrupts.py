"""Signals that end a command."""

import subprocess
import sys

INTERRUPTED_IN_A_CALLBACK = """
import ctypes, os, signal, sys, time
import glfw
from counterlight.command import run

def work():
    os.kill(os.getpid(), signal.SIGTERM)
    for _ in range(1000):
        pass  # Python handles the signal here

def body(_):
    ctypes.CFUNCTYPE(None)(glfw._callback_exception_decorator(work))()
    print("the callback has ended", flush=True)
    time.sleep(60)

sys.exit(run(body))
"""


def test_a_signal_during_a_callback_of_glfw_ends_the_command() -> None:
    """Exceptions that a callback of C code raises are lost. The show once continued after SIGTERM."""
    words = [sys.executable, "-c", INTERRUPTED_IN_A_CALLBACK]
    done = subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 130
    assert done.stdout == "the callback has ended\n"
    assert done.stderr == "interrupted\n"  # nothing was being written
