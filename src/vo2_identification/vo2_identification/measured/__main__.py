"""`python -m vo2_identification.measured`."""

import sys

from vo2_identification.measured.command import main

if __name__ == "__main__":
    sys.exit(main())
