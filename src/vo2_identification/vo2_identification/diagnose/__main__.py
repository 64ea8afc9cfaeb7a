"""`python -m vo2_identification.diagnose`."""

import sys

from vo2_identification.diagnose.command import main

sys.exit(main())
