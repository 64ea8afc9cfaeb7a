"""`python -m vo2_studies.bench [--json FILE] [--only NAME ...]`."""

from vo2_studies.bench.runner import main

raise SystemExit(main())
