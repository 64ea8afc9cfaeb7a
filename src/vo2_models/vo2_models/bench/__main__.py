"""`python -m vo2_models.bench [--json FILE] [--only NAME ...] [--also MODULE ...]`."""

from vo2_models.bench.runner import main

raise SystemExit(main())
