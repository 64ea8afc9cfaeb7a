"""Excite, record, fit and diagnose."""
