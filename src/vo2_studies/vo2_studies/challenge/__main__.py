"""`python -m vo2_studies.challenge`."""

import sys

from vo2_studies.challenge import main

sys.exit(main())
