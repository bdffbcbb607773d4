"""The command line: `python -m posecore evaluate | train | estimate`."""

import os
import signal
import sys

# Threads that wait by spinning take the cores on which others compute: on a busy machine two of
# them took four times the time of one. Read when torch is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def _stop(*_: object) -> None:
    """End at Ctrl-C while libraries are imported, which would make errors of their own of it."""
    os.write(2, b"interrupted\n")
    os._exit(130)  # nothing was begun that would need an end


STARTED = __name__ == "__main__"
LISTENS = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not in the background
if STARTED and LISTENS:
    signal.signal(signal.SIGINT, _stop)

from posecore.methods.main import main, parse, run  # noqa: E402

__all__ = ["main"]

if STARTED:
    options = parse()
    if LISTENS:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    status = run(options)
    if LISTENS:  # the end of the interpreter has no more to say
        signal.signal(signal.SIGINT, _stop)
    sys.exit(status)
