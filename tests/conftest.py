"""What every test may rely on."""

import gc
import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a suite that a shell put into the background
    signal.signal(signal.SIGINT, signal.default_int_handler)

LONG = ("work", "discovery", "face")  # folders with files that take more than half a minute


def pytest_collection_modifyitems(items: list) -> None:
    """Long files begin first: one that begins last keeps a worker waiting."""
    items.sort(key=lambda item: item.path.parent.name not in LONG)


def pytest_collectstart() -> None:
    """Nothing of eleven thousand tests is garbage, and looking for some is a quarter of the time of collecting them."""
    gc.disable()


def pytest_collection_finish() -> None:
    gc.enable()
    gc.freeze()
