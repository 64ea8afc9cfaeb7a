"""Fitting of device simulations to recordings; import the modules of this folder by name."""
