"""`python -m vo2_identification.reproduce`."""

import sys

from vo2_identification.reproduce import main

if __name__ == "__main__":
    sys.exit(main())
