"""The device: driver, thermal core with both transitions, structure, sensors; as truth and as fitted simulation.

Names are loaded on first use, so that importing the package does not load the compiler.

>>> from vo2_models.device import truth
>>> recording = truth("integrated", seed=1).simulate([0.004, 0.005, 0.006], seed=2)
>>> sorted(recording.channels)[:2]
['commanded_current', 'film_resistance']
"""

from vo2_models.lazy import lazy_names

_HOME = {
    "PARAMETERS": "model",
    "DeviceModel": "model",
    "PRESETS": "description",
    "DeviceDescription": "description",
    "preset": "description",
    "Simulation": "simulation",
    "Stepper": "stepper",
    "TruthDevice": "ground_truth",
    "temperature_of_surrogate": "surrogate",
    "truth": "ground_truth",
    "surrogate_of_temperature": "surrogate",
}
__all__ = sorted(_HOME)
__getattr__, __dir__ = lazy_names(__name__, _HOME)
