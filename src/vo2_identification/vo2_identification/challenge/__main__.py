"""`python -m vo2_identification.challenge`."""

import sys

from vo2_identification.challenge import main

sys.exit(main())
