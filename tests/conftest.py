"""What every test may rely on."""

import gc
import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a suite that a shell put into the background
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collectstart() -> None:
    """Nothing of eleven thousand tests is garbage, and looking for some is a quarter of the time of collecting them."""
    gc.disable()


def pytest_collection_finish() -> None:
    gc.enable()
    gc.freeze()
