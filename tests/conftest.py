"""What every test may rely on."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a suite that a shell put into the background
    signal.signal(signal.SIGINT, signal.default_int_handler)
