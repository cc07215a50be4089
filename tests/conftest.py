"""What holds for all tests."""

from __future__ import annotations

import signal

# A shell without job control starts what it puts into the background with SIGINT ignored, and that is inherited: tests
# of an interrupted command would then wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)
