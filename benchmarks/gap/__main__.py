"""``python -m benchmarks.gap``, from the root of the repository."""

import sys

from benchmarks.gap.run import main

if __name__ == "__main__":
    sys.exit(main())
