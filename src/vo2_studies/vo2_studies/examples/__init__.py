"""Every set of measured data with its device file: converted, described, fitted, and predicted where it was held out."""
