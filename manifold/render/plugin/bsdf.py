"""The BSDF plugin `manifold`, which evaluates a prediction from the measured materials without a file.

Scenes name it after `import manifold.mitsuba`, in LLVM variants (scalar ones would interpret it):

    {"type": "manifold", "model": "model.h5", "latent": "-0.3,1.2"}

Every evaluation loops over the materials, inverts each one's warp, and sums `T^-1(sum_i v_i T(f_i))`. It also
computes the density, because sampling draws from a mixture of the materials' own warps with shares |v_i|. The values
equal those of `Manifold.predict`, but in float32. Negative values are set to 0, as in written files, except at a
material's own latent, as in Mitsuba's `measured`. At a wavelength, f_i is the value of the nearest band if bands are
at most 5 nm apart, and otherwise interpolated linearly.

Properties:
    model: path of the model.
    library: path of the model's library, if it was moved.
    latent: coordinates separated by commas, a point, a Dr.Jit array, or the name of a material; or
    latent_0, latent_1, ...: textures of the coordinates, which let materials vary over a surface.
    like, reflectance, srgb: given colour, as in `manifold predict`.
    tolerance: skip materials as long as the mapped values change by no more than this fraction of their norm; the
        weights of the others are refitted. The default of 0 keeps all.

Parameters of `mi.traverse`, all differentiable:
    latent: the Q coordinates; if they change, given colours keep their colour coordinates.
    colours: coordinates of a given colour, one per band; on a map of blends, cube roots of reflectances at 8 degrees.
    latent_0.data, latent_1.data, ...: texels of the textures.

Only the weights have derivatives; samples and their densities have none. The derivative is 0 if a negative value is
clipped, if a weight is 0, or at the latent of a library material. Derivatives with respect to directions raise an
error.
"""

# Models and what evaluates them are imported where they are used: the plugin is registered for every render.

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold.core.errors import UnknownNameError, UsageError
from manifold.core.names import names_like
from manifold.model.colours import ColourChoice
from manifold.model.places import Place, parse_coordinates, parse_walk
from manifold.render import backend

if TYPE_CHECKING:
    from manifold.model.manifold import Manifold
    from manifold.render.plugin.mixture import FixedLatent

NAME = "manifold"
_registered: set[str] = set()


def register(variant: str) -> None:
    """Register the plugin in a variant, once."""
    if variant in _registered:
        return
    _registered.add(variant)
    mi = backend.mitsuba_of_any_variant()
    if "llvm" not in variant and "cuda" not in variant:
        mi.register_bsdf(NAME, _refuse)
    elif "mono" in variant:
        mi.register_bsdf(NAME, _refuse_mono)
    else:
        mi.register_bsdf(NAME, _plugin_class(mi, variant))


def _refuse(properties: Any) -> Any:
    raise UsageError(
        "the plugin `manifold` needs an LLVM variant of Mitsuba; install libLLVM 17 or newer, or write the "
        "prediction with `manifold predict` and use Mitsuba's `measured`"
    )


def _refuse_mono(properties: Any) -> Any:
    raise UsageError(
        "the plugin `manifold` needs an RGB or spectral variant of Mitsuba: mono variants have a single channel; set "
        "llvm_ad_rgb for RGB materials, llvm_ad_spectral for spectral ones"
    )


def _plugin_class(mi: Any, variant: str) -> Any:
    """Return the plugin's class for a variant, because Mitsuba's base classes exist once per variant."""
    is_spectral = "spectral" in variant

    class ManifoldBSDF(mi.BSDF):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            from manifold.model.manifold import load_model
            from manifold.render.plugin.evaluation import Evaluation
            from manifold.render.plugin.mixture import varying_mixture

            model = load_model(_path(properties, "model"), _optional_path(properties, "library"))
            if model.bands.is_rgb == is_spectral:
                kind = "RGB" if model.bands.is_rgb else "spectral"
                raise UsageError(
                    f"variant {variant} with a library of {kind} materials; set a {kind} variant"
                )
            self._textures, self._fixed = _read_latent(mi, properties, model)
            self._parameters = {}
            if self._fixed is None:
                self.mixture = varying_mixture(model)
            else:
                self.mixture = self._fixed.mixture()
                given = {"latent": self._fixed.latent, "colours": self._fixed.colours}
                self._parameters = {name: mi.Float(v) for name, v in given.items() if v is not None}
            self._evaluation = Evaluation(mi, backend.drjit(), self.mixture)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            if self._textures:
                flags |= mi.BSDFFlags.SpatiallyVarying
            self.m_components = [flags]
            self.m_flags = flags

        def _latent(self, si: Any, active: Any) -> list[Any] | None:
            return [texture.eval_1(si, active) for texture in self._textures] or None

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            record = mi.BSDFSample3f()
            active = mi.Bool(active) & (mi.Frame3f.cos_theta(si.wi) > 0.0)
            latent = self._latent(si, active)
            lobes = self._evaluation.weights(latent)
            wo = self._evaluation.sample(lobes, si.wi, sample1, sample2, active)
            active &= mi.Frame3f.cos_theta(wo) > 0.0
            value, pdf = self._evaluation.eval_pdf(lobes, si.wi, wo, si.wavelengths, active)
            active &= pdf > 0.0
            record.wo, record.pdf, record.eta = wo, pdf & active, 1.0
            record.sampled_type, record.sampled_component = mi.UInt32(+mi.BSDFFlags.GlossyReflection), 0
            return record, (value / pdf) & active

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            active = mi.Bool(active) & (mi.Frame3f.cos_theta(si.wi) > 0.0) & (mi.Frame3f.cos_theta(wo) > 0.0)
            lobes = self._evaluation.weights(self._latent(si, active))
            value, pdf = self._evaluation.eval_pdf(lobes, si.wi, wo, si.wavelengths, active)
            return value & active, pdf & active

        def traverse(self, callback: Any) -> None:
            named = {f"latent_{k}": texture for k, texture in enumerate(self._textures)} | self._parameters
            for name, value in named.items():
                callback.put(name, value, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Any) -> None:
            if self._fixed is None:
                return
            from manifold.render.plugin.evaluation import Evaluation

            dr = backend.drjit()
            latent, colours = self._parameters["latent"], self._parameters.get("colours")
            self._fixed = self._fixed.moved(
                np.array(dr.detach(latent)), None if colours is None else np.array(dr.detach(colours))
            )
            before = self.mixture
            self.mixture = self._fixed.mixture(before, has_slopes=dr.grad_enabled(latent, colours))
            if self.mixture.tables is not before.tables:
                self._evaluation = Evaluation(mi, dr, self.mixture)
            self._evaluation.set_weights(self.mixture, latent, colours)

        def to_string(self) -> str:
            return f"ManifoldBSDF[{self.mixture}]"

    return ManifoldBSDF


def _read_latent(mi: Any, properties: Any, model: Manifold) -> tuple[list[Any], FixedLatent | None]:
    """Read the textures of the latent, or a fixed one."""
    from manifold.render.plugin.mixture import FixedLatent

    names = [f"latent_{k}" for k in range(model.settings.latent_dim)]
    given = [name for name in names if name in properties]
    tolerance = float(properties.get("tolerance", 0.0))
    if given:
        if len(given) < len(names) or "latent" in properties:
            raise UsageError(f"plugin manifold: found {', '.join(given)}, expected all of {', '.join(names)}")
        for name in ("tolerance", "like", "reflectance", "srgb"):
            if name in properties:
                raise UsageError(f"plugin manifold: {name} needs one latent, not textures; leave it out")
        return [_finite_texture(mi, properties, name) for name in names], None
    if "latent" not in properties:
        raise UsageError(
            f"plugin manifold: no latent; give `latent` as 'x,y' or a material, or textures {', '.join(names)}"
        )
    given_latent = properties["latent"]
    if not isinstance(given_latent, str):  # a point, or an array of Dr.Jit
        given_latent = ",".join(repr(float(value)) for value in np.ravel(np.array(given_latent)))
    place = place_of(model, given_latent)
    colour = ColourChoice(
        like=str(properties["like"]) if "like" in properties else None,
        reflectance=_optional_path(properties, "reflectance"),
        srgb=str(properties["srgb"]) if "srgb" in properties else None,
    )
    return [], FixedLatent.of(model, place, colour, tolerance)


def place_of(model: Manifold, latent: str) -> Place:
    """Return the point that coordinates or a material's name denote. Raises UsageError for a step of a walk."""
    if latent not in model.names and parse_coordinates(latent) is None:
        if (walk := parse_walk(latent, model.names)) is None:
            raise UnknownNameError(
                f"plugin manifold: latent is '{latent}', expected coordinates such as -0.3,1.2, or a material of the "
                f"model ({names_like(model.names, latent)})"
            )
        if model.place(latent).walk is not None:
            raise UsageError(
                f"plugin manifold: latent is '{latent}', a step of a walk, which no latent makes; give the coordinates "
                f"model.between{walk} on the map between the two, or write the step to a file with `manifold predict`"
            )
    return model.place(latent)


def _finite_texture(mi: Any, properties: Any, name: str) -> Any:
    """Return a texture of a latent's coordinates, and refuse NaN and infinite texels, which would render as NaN."""
    texture = properties.get_texture(name)
    params = mi.traverse(texture)
    for key in params.keys():  # noqa: SIM118  # its own iteration is over pairs
        if key.endswith("data") and not np.all(np.isfinite(np.array(params[key]))):
            raise UsageError(f"plugin manifold: {name} has texels that are not finite, expected coordinates")
    return texture


def _path(properties: Any, name: str) -> Path:
    if name not in properties:
        raise UsageError(f"plugin manifold: no {name}; give the path of a model")
    return Path(str(properties[name]))


def _optional_path(properties: Any, name: str) -> Path | None:
    return _path(properties, name) if name in properties else None
