"""What all tests of this package need."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # a shell without job control starts background jobs deaf to Ctrl-C, and the commands under test would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)
