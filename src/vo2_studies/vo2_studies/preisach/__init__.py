"""Studies of chapters 2 to 5: compression, compressive sensing, non-monotonic curves, measured recordings."""
