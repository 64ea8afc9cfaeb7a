"""Physics beyond the nominal device, one effect a file; the folder's listing is the catalogue.

To add an effect, add a file that defines `EFFECT = Effect(...)`: plant, fit, diagnosis and report find it.

>>> from vo2_models.effects import effect
>>> effect("latent_heat").parameters[0].unit
'K'
"""

from vo2_models.effects.catalogue import apply_effects, effect, effect_ids, effects
from vo2_models.effects.record import Effect, constant_of, scaled_by_device, setting

__all__ = [
    "Effect",
    "apply_effects",
    "constant_of",
    "effect",
    "effect_ids",
    "effects",
    "scaled_by_device",
    "setting",
]
