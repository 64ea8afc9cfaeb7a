"""Physics beyond the nominal device, one effect a file; the folder's listing is the catalogue.

To add an effect, add a file that defines `EFFECT = Effect(...)` and its hooks: plant, fit, diagnosis and report find it.

>>> from vo2_models.effects import effect
>>> effect("latent_heat").parameters[0].unit
'K'
"""

from vo2_models.effects.catalogue import effect, effect_ids, effects, load_effect
from vo2_models.effects.record import Effect, State, constant_of

__all__ = ["Effect", "State", "constant_of", "effect", "effect_ids", "effects", "load_effect"]
