"""Self-contained HTML pages with figures and tables."""
