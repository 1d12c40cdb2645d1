"""The BSDF plugin `surface`, which changes the colour of another BSDF by a texture.

Scenes can use it after `manifold.surface.bsdf.register()`, in LLVM variants:

    {"type": "surface", "changes": {"type": "bitmap", "bitmap": ..., "raw": True},
     "nested": {"type": "measured", "filename": "mean_spec.bsdf"}}

Properties:
    changes: texture of factors of red, green and blue, as `spectral_changes` returns them. In RGB variants they
        multiply the colour; in spectral ones, the factor of a wavelength is their sum weighted by `weights_at`.
    nested: the BSDF that is changed.

For slopes, put the plugin into Mitsuba's `normalmap`.
"""

from __future__ import annotations

from typing import Any

from manifold.colour.reflectances import NODES_NM
from manifold.core.errors import UsageError
from manifold.render import backend

NAME = "surface"
_registered: set[str] = set()


def _register(variant: str) -> None:
    if variant in _registered:
        return
    _registered.add(variant)
    mi = backend.mitsuba_of_any_variant()
    is_scalar = "llvm" not in variant and "cuda" not in variant
    mi.register_bsdf(NAME, _refuse if is_scalar else _plugin_class(mi, variant))


def _refuse(properties: Any) -> Any:
    raise UsageError("the plugin `surface` needs an LLVM variant of Mitsuba; install libLLVM 17 or newer")


def _plugin_class(mi: Any, variant: str) -> Any:
    """Return the class for a variant, because Mitsuba's base classes exist once per variant."""
    is_spectral = "spectral" in variant

    class SurfaceBSDF(mi.BSDF):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            nested = [each for each in _objects(properties) if isinstance(each, mi.BSDF)]
            if len(nested) != 1 or "changes" not in properties:
                raise UsageError("plugin surface: expected a texture `changes` and one nested BSDF")
            self._nested: Any = nested[0]
            self._changes = properties.get_texture("changes")
            self.m_components = [
                self._nested.flags(k) | mi.BSDFFlags.SpatiallyVarying
                for k in range(self._nested.component_count())
            ]
            self.m_flags = self._nested.flags() | mi.BSDFFlags.SpatiallyVarying

        def _factor(self, si: Any, active: Any) -> Any:
            changes = self._changes.eval_3(si, active)
            if not is_spectral:
                return mi.Color3f(changes)
            red, green, blue = changes.x, changes.y, changes.z
            low, middle, high = NODES_NM
            nm = si.wavelengths
            dr = backend.drjit()
            to_green = dr.clip((nm - low) / (middle - low), 0.0, 1.0)
            to_red = dr.clip((nm - middle) / (high - middle), 0.0, 1.0)
            return blue * (1.0 - to_green) + green * (to_green - to_red) + red * to_red

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            record, value = self._nested.sample(ctx, si, sample1, sample2, active)
            return record, value * self._factor(si, active)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._nested.eval(ctx, si, wo, active) * self._factor(si, active)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._nested.pdf(ctx, si, wo, active)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            value, pdf = self._nested.eval_pdf(ctx, si, wo, active)
            return value * self._factor(si, active), pdf

        def traverse(self, callback: Any) -> None:
            callback.put("changes", self._changes, mi.ParamFlags.Differentiable)
            callback.put("nested", self._nested, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"SurfaceBSDF[{self._nested}]"

    return SurfaceBSDF


def _objects(properties: Any) -> list[Any]:
    return [properties[name] for name in properties.keys() if name != "changes"]  # noqa: SIM118


def register() -> None:
    """Register the plugin in the current variant and in every variant that is set later."""
    backend.on_variant(_register)
