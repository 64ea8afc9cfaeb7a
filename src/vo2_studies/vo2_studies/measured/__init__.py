"""Fit and diagnosis on other people's measurements: converted, fitted, explained, judged on what was held out."""
