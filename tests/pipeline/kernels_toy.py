"""Work for the helpers of the test beside this file: what a group of kernels is to the program."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

FOLDER = "SMTS_TEST_KERNELS"  # where each piece of work leaves a file named by it and its process
MAIN = "SMTS_TEST_MAIN"  # process of the test


def leave_a_file(kernel: str) -> None:
    """As if compiled: one file a call."""
    time.sleep(0.2)
    (Path(os.environ[FOLDER]) / f"{kernel.rsplit('/', 1)[1]}-{os.getpid()}").touch()


def die_in_helpers(kernel: str) -> None:
    """Killed, unless it is the test's own process that does it."""
    if os.getpid() != int(os.environ[MAIN]):
        os.kill(os.getpid(), signal.SIGKILL)
    leave_a_file(kernel)


def take_forever(kernel: str) -> None:
    """Say which process it is, and do not come back."""
    leave_a_file(kernel)
    time.sleep(600.0)
