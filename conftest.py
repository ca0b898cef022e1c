"""For all tests: an interrupt interrupts.

A script starts what it sends to the background with SIGINT ignored, and every process under it
inherits that: the tests of Ctrl-C would wait for ever.
"""

import signal

signal.signal(signal.SIGINT, signal.default_int_handler)
