"""`python -m vo2_studies.measured`."""

import sys

from vo2_studies.measured.command import main

if __name__ == "__main__":
    sys.exit(main())
