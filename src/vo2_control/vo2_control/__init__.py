"""References, controllers and inverse compensation."""
