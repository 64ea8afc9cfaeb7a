"""`python -m vo2_studies.reproduce`."""

import sys

from vo2_studies.reproduce import main

if __name__ == "__main__":
    sys.exit(main())
