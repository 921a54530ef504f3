"""rotorjax: compare a rotor model with vibration measurements, see where it fails, add the effect that is missing.

    rig = read_rig("rig.toml")
    measurement = read_measurement("data.csv", rig)
    fitted = fit(rig.model + effects.CrossCoupling(), measurement)
    view = compare(fitted.model, measurement)

Fits and diagnoses need double precision: ``jax.config.update("jax_enable_x64", True)``. Importing the package changes
no setting, and loads a module only when a name from it is used; the names stand in ``__init__.pyi``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
