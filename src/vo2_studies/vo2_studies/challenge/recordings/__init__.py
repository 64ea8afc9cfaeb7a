"""`challenge --recordings`: known changes concealed in measurements of other people's devices.

Hysteresis, noise and misfit are real here; only the change is ours, and it is made where that is exact: behind the
device, on what a sensor said, or before it, on the drive that the recording states.
"""
