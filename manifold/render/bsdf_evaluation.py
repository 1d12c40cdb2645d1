"""Evaluates BSDFs for many parameter vectors at many direction pairs, with derivatives.

BSDFs of `manifold.analytic.principled.MODELS` are evaluated in NumPy, all others by Mitsuba itself, on its
LLVM backend: every texture slot of a plugin holds a *lane texture*, whose value is an array with one entry per lane
of the wavefront. One kernel then evaluates any number of parameter vectors at all direction pairs. A second one, with a
different tangent per lane, evaluates all columns of a Jacobian.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from manifold.analytic import principled
from manifold.core.errors import RendererError, UsageError
from manifold.core.records import Array, Indices
from manifold.render import backend
from manifold.render.bsdf_parameters import BsdfFamily, ParameterLayout

_LANES = 1 << 20  # lanes of one wavefront; more are evaluated one after the other
_BLOCK = 1 << 16  # pairs times vectors that NumPy evaluates at once: what a processor's cache holds
_COLOUR = 0.5  # Mitsuba's, of a family without a free one
_TINTS = ("spec_tint", "sheen_tint")


class Evaluator(Protocol):
    """The interface that evaluates a BSDF family at M direction pairs in B bands; f_cos is in 1/sr."""

    layout: ParameterLayout

    def values(self, p: Array, rows: Indices | None = None) -> Array:
        """Return f_cos of parameter vectors (P, K) at all pairs or some rows of them, shape (P, M, B)."""

    def jacobian(self, p: Array) -> tuple[Array, Array]:
        """Return f_cos (M, B) of one vector (K,), and its derivatives (M, B, K)."""

    def band_jacobian(self, p: Array) -> tuple[Array, Array]:
        """Return f_cos (M, B) of one vector (K,), and its derivatives (M, B, n) by the n values of each band.

        A band must depend only on its own values.
        """


def evaluator(family: BsdfFamily, wi: Array, wo: Array, n_bands: int) -> Evaluator:
    """Return the evaluator at unit vectors (M, 3).

    Raises:
        UsageError: a tint is used with a number of bands other than three, or Mitsuba refuses the BSDF.
        RendererError: the BSDF needs Mitsuba's LLVM backend, which is missing.
    """
    if is_analytic(family):
        return AnalyticEvaluator(family, wi, wo, n_bands)
    mi = backend.mitsuba(colour="rgb")
    if not mi.variant().startswith("llvm"):
        raise RendererError(
            f"BSDF {family.type} is evaluated by Mitsuba's LLVM backend, found {mi.variant()}; {backend.INSTALL}"
        )
    return LaneEvaluator(mi, family, wi, wo, n_bands)


def variant(family: BsdfFamily) -> str:
    """Return the name of a family's evaluator: `numpy`, or the variant of Mitsuba."""
    return "numpy" if is_analytic(family) else str(backend.mitsuba(colour="rgb").variant())


def is_analytic(family: BsdfFamily) -> bool:
    """Return whether NumPy evaluates a family.

    That is so for `principled.MODELS` with a colour per band and all other parameters numbers from 0 to 1.
    """
    model = principled.MODELS.get(family.type)
    if model is None:
        return False
    shared = [parameter for parameter in family.parameters if parameter.name != model.colour]
    names = {*family.fixed, *(parameter.name for parameter in shared)}
    ends = [end for parameter in shared for end in (parameter.minimum, parameter.maximum)]
    return (
        names <= set(model.defaults)
        and all(parameter.per_band == (parameter.name == model.colour) for parameter in family.parameters)
        and all(
            isinstance(value, int | float) and 0.0 <= value <= 1.0
            for value in (*family.fixed.values(), *ends)
        )
    )


def require_independent_bands(family: BsdfFamily) -> None:
    """Raise UsageError for tints of spectral values, because a tint depends on the luminance of three channels."""
    free = {parameter.name for parameter in family.parameters}
    mixing = [name for name in _TINTS if name in free or family.fixed.get(name, 0)]
    if family.type == "principled" and mixing:
        raise UsageError(
            f"{' and '.join(mixing)} need RGB samples: a tint has no meaning per band; leave them out, or fit RGB"
        )


class AnalyticEvaluator:
    """The evaluator of `principled.MODELS`, in NumPy."""

    def __init__(self, family: BsdfFamily, wi: Array, wo: Array, n_bands: int) -> None:
        if n_bands != 3:
            require_independent_bands(family)
        self.layout = ParameterLayout(family, n_bands)
        model = principled.MODELS[family.type]
        self._model = model(np.asarray(wi, float), np.asarray(wo, float))
        self._n_pairs = len(wi)
        self._fixed = {**model.defaults, **{name: float(value) for name, value in family.fixed.items()}}
        self._colour_place = self.layout.slices.get(model.colour)
        self._shared = {
            parameter.name: self.layout.slices[parameter.name].start
            for parameter in family.parameters
            if parameter.name != model.colour
        }

    def values(self, p: Array, rows: Indices | None = None) -> Array:
        """Return f_cos of parameter vectors; see `Evaluator`."""
        p = np.atleast_2d(p)
        model, n_pairs = (self._model, self._n_pairs) if rows is None else (self._model.at(rows), len(rows))
        out = np.empty((len(p), n_pairs, self.layout.n_bands))
        block = max(1, _BLOCK // max(n_pairs, 1))
        for first in range(0, len(p), block):
            part = p[first : first + block]
            fixed = {name: np.full((len(part), 1), value) for name, value in self._fixed.items()}
            shared = {name: part[:, place, None] for name, place in self._shared.items()}
            coefficients = model.coefficients(fixed | shared)  # [3, P, M]
            out[first : first + block] = np.moveaxis(coefficients, 0, -1) @ self._terms(part)
        return out

    def jacobian(self, p: Array) -> tuple[Array, Array]:
        """Return f_cos of one vector, and its derivatives; see `Evaluator`."""
        shared = {name: float(p[place]) for name, place in self._shared.items()}
        coefficients, slopes = self._model.slopes(self._fixed | shared, shared)  # [3, M] each
        terms = self._terms(p)
        J = np.zeros((self._n_pairs, self.layout.n_bands, self.layout.size))
        for name, place in self._shared.items():
            J[..., place] = slopes[name].T @ terms
        if self._colour_place is not None:
            colour = p[self._colour_place]
            J[..., self._colour_place] = coefficients[1][:, None, None] * np.eye(len(colour))
            if np.any(coefficients[2]):
                J[..., self._colour_place] += coefficients[2][:, None, None] * _tint_slope(colour)
        return coefficients.T @ terms, J

    def band_jacobian(self, p: Array) -> tuple[Array, Array]:
        """Return f_cos of one vector, and its derivatives in the values of each band; see `Evaluator`."""
        shared = {name: float(p[place]) for name, place in self._shared.items()}
        coefficients, _ = self._model.slopes(self._fixed | shared, ())
        n_own = int(self._colour_place is not None)  # the colour, if that is free
        slope = np.broadcast_to(coefficients[1][:, None, None], (self._n_pairs, self.layout.n_bands, n_own))
        return coefficients.T @ self._terms(p), slope

    def _terms(self, p: Array) -> Array:
        """Return the terms of coefficients for vectors (..., K), (..., 3, B): 1, the colour and its tint."""
        if self._colour_place is None:
            colour = np.full((*p.shape[:-1], self.layout.n_bands), _COLOUR)
        else:
            colour = p[..., self._colour_place]
        tint = _tint(colour) if self.layout.n_bands == 3 else np.zeros_like(colour)
        return np.stack([np.ones_like(colour), colour, tint], axis=-2)


def _tint(colour: Array) -> Array:
    """Divide colours (..., 3) by their luminance; black becomes white."""
    luminance = (colour @ principled.LUMINANCE)[..., None]
    is_lit = luminance > 0.0
    return np.where(is_lit, colour / np.where(is_lit, luminance, 1.0), 1.0)


def _tint_slope(colour: Array) -> Array:
    """Return the derivatives (3, 3) of the tint of a colour (3,)."""
    luminance = float(colour @ principled.LUMINANCE)
    if luminance <= 0.0:
        return np.zeros((3, 3))
    return np.asarray(np.eye(3) / luminance - np.outer(colour, principled.LUMINANCE) / luminance**2)


def load_bsdf(family: BsdfFamily, values: dict[str, Any]) -> Any:
    """Load Mitsuba's BSDF with values by name, in the RGB variant of the backend.

    A value is one number, or three for a colour.
    """
    return _load(backend.mitsuba(colour="rgb"), bsdf_dict(family, values))


def bsdf_dict(family: BsdfFamily, values: dict[str, Any], wavelengths_nm: Any = None) -> dict[str, Any]:
    """Return Mitsuba's dictionary of a BSDF, for its RGB variants, or with wavelengths (B,) for its spectral ones.

    Values by name are one number, three for a colour, or one per wavelength.
    """
    content: dict[str, Any] = {"type": family.type, **family.fixed}
    for parameter in family.parameters:
        value = values[parameter.name]
        if not parameter.per_band:
            content[parameter.name] = float(value)
        elif wavelengths_nm is None:
            colour = [float(v) for v in value]
            # `rgb` refuses what is outside [0, 1]; `srgb` takes it if unbounded.
            content[parameter.name] = {"type": "srgb", "color": colour, "unbounded": True}
        else:
            content[parameter.name] = {
                "type": "irregular",
                "wavelengths": ", ".join(f"{v:.9g}" for v in wavelengths_nm),
                "values": ", ".join(f"{max(v, 0.0):.9g}" for v in value),  # Mitsuba takes no negative ones
            }
    return content


def _load(mi: Any, content: dict[str, Any]) -> Any:
    try:
        # Equal textures would become one, and their parameters with them.
        loaded = mi.load_dict(content, optimize=False)
    except RuntimeError as error:
        raise _refusal(content["type"], error) from error
    if not isinstance(loaded, mi.BSDF):
        raise UsageError(f"{content['type']} is a {type(loaded).__name__}, expected a BSDF; name its plugin")
    return loaded


def _load_at_defaults(mi: Any, family: BsdfFamily) -> Any:
    defaults = {
        o.name: [min(max(o.default, 0.0), 1.0)] * 3 if o.per_band else o.default for o in family.parameters
    }
    return _load(mi, bsdf_dict(family, defaults))


def _refusal(kind: str, error: RuntimeError) -> UsageError:
    reason = " ".join(str(error).split())
    return UsageError(f"BSDF {kind}: Mitsuba says {reason[:200]}; check its type and parameters")


def bsdf_keys(mi: Any, family: BsdfFamily) -> dict[str, str]:
    """Return Mitsuba's key of every free parameter: `name` for a plain number, `name.value` for a texture."""
    bsdf = _load_at_defaults(mi, family)
    if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) and not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth):
        raise UsageError(
            f"BSDF {family.type} reflects into discrete directions only (delta lobe), which cannot be fitted; use "
            "a rough one, such as roughconductor"
        )
    keys = mi.traverse(bsdf).keys()
    slots = {}
    for parameter in family.parameters:
        found = [key for key in (parameter.name, f"{parameter.name}.value") if key in keys]
        if not found:
            known = ", ".join(sorted(key.removesuffix(".value") for key in keys))
            raise UsageError(f"BSDF {family.type} has no parameter {parameter.name!r}; Mitsuba names {known}")
        slots[parameter.name] = found[0]
    return slots


class LaneEvaluator:
    """The evaluator that uses Mitsuba's LLVM backend, in single precision."""

    def __init__(self, mi: Any, family: BsdfFamily, wi: Array, wo: Array, n_bands: int) -> None:
        self.layout = ParameterLayout(family, n_bands)
        self._mi, self._dr = mi, backend.drjit()
        slots = bsdf_keys(mi, family)
        self._textures = {
            o.name: mi.load_dict({"type": _lane_plugin(mi.variant())})
            for o in family.parameters
            if slots[o.name] != o.name
        }
        plain = {o.name: o.default for o in family.parameters if slots[o.name] == o.name}
        try:
            self._bsdf = mi.load_dict({"type": family.type, **family.fixed, **plain, **self._textures})
        except RuntimeError as error:
            raise _refusal(family.type, error) from error
        self._plain = mi.traverse(self._bsdf)
        self._colours = {name for name in plain if isinstance(self._plain[name], mi.Color3f)}
        self._names = [o.name for o in family.parameters]
        self._wi, self._wo = np.asarray(wi, np.float32), np.asarray(wo, np.float32)
        self._n_groups = -(-n_bands // 3)
        self._all = self._upload(np.arange(len(wi)))

    def _upload(self, rows: Indices) -> tuple[Any, Any]:
        wi, wo = (self._mi.Vector3f(np.ascontiguousarray(w[rows].T)) for w in (self._wi, self._wo))
        self._dr.eval(wi, wo)
        return wi, wo

    def values(self, p: Array, rows: Indices | None = None) -> Array:
        """Return f_cos of parameter vectors; see `Evaluator`."""
        p = np.atleast_2d(p)
        directions, m = (self._all, len(self._wi)) if rows is None else (self._upload(rows), len(rows))
        block = max(1, _LANES // (m * self._n_groups))
        parts = [self._values(p[k : k + block], directions, m) for k in range(0, len(p), block)]
        return np.concatenate(parts)

    def _values(self, p: Array, directions: tuple[Any, Any], m: int) -> Array:
        table = self._triples(p)  # (P * groups, parameters, 3)
        out = self._run(table, directions, m, None)
        return self._bands(out, len(p), m)

    def jacobian(self, p: Array) -> tuple[Array, Array]:
        """Return f_cos and its derivatives; see `Evaluator`.

        There is one tangent per scalar, and one per channel of the parameters per band.
        """
        layout = self.layout
        columns = [
            (j, c)
            for j, o in enumerate(layout.family.parameters)
            for c in (range(3) if o.per_band else (None,))
        ]
        value, slope = self._differentiate(p, columns)
        jacobian = np.zeros((*value.shape, layout.size))
        for k, (j, c) in enumerate(columns):
            place = layout.slices[self._names[j]]
            if c is None:
                jacobian[..., place.start] = slope[k]
                continue
            for first in range(0, layout.n_bands, 3):  # a channel touches the bands of its own three only
                if first + c < layout.n_bands:
                    jacobian[:, first : first + 3, place.start + first + c] = slope[k][:, first : first + 3]
        return value, jacobian

    def band_jacobian(self, p: Array) -> tuple[Array, Array]:
        """Return f_cos and its derivatives per band; see `Evaluator`.

        There is one tangent per parameter, for the three channels together.
        """
        columns = [(j, None) for j, o in enumerate(self.layout.family.parameters) if o.per_band]
        value, slope = self._differentiate(p, columns)
        return value, np.stack(slope, axis=-1)

    def _differentiate(self, p: Array, columns: list[Any]) -> tuple[Array, list[Array]]:
        """Return f_cos (M, B) and its derivative (M, B) by each column (parameter, channel or None for all)."""
        n, m, groups = len(columns), len(self._wi), self._n_groups
        table = np.repeat(self._triples(p[None]), n, axis=0)  # (groups * columns, parameters, 3)
        tangent = np.zeros_like(table)
        for k, (j, c) in enumerate(columns):
            tangent[k::n, j, slice(None) if c is None else c] = 1.0
        value, slope = self._run(table, self._all, m, tangent)
        value, slope = (a.reshape(3, groups, n, m) for a in (value, slope))

        def bands(channels: Any) -> Array:
            return np.asarray(self._bands(np.ascontiguousarray(channels), 1, m)[0])

        return bands(value[:, :, 0]), [bands(slope[:, :, k]) for k in range(n)]

    def _triples(self, p: Array) -> NDArray[np.float32]:
        """Return values (P, K) in Mitsuba's layout, shape (P * groups, parameters, 3)."""
        out = np.empty((len(p), self._n_groups, len(self._names), 3), np.float32)
        for j, name in enumerate(self._names):
            value = p[:, self.layout.slices[name]]
            if self.layout.family.parameters[j].per_band:
                value = np.pad(value, ((0, 0), (0, 3 * self._n_groups - value.shape[1])), mode="edge")
                out[:, :, j] = value.reshape(len(p), self._n_groups, 3)
            else:
                out[:, :, j] = value[:, :, None]
        return out.reshape(-1, len(self._names), 3)

    def _bands(self, out: Any, n: int, m: int) -> Array:
        """Return channels (3, n * groups * m) as bands (n, m, B)."""
        moved = out.reshape(3, n, self._n_groups, m).transpose(1, 3, 2, 0)
        return np.asarray(moved.reshape(n, m, -1)[..., : self.layout.n_bands], dtype=np.float64)

    def _run(self, table: NDArray[np.float32], directions: tuple[Any, Any], m: int, tangent: Any) -> Any:
        """Return f_cos (3, R * m) of a table (R, parameters, 3), rows slowest; with tangents also the derivatives."""
        mi, dr = self._mi, self._dr
        n, width = table.shape[0], table.shape[1] * 3
        size = dr.opaque(mi.UInt32, m)
        lane = dr.arange(mi.UInt32, n * m)
        row = lane // size
        column = lane - row * size
        flat = mi.Float(np.ascontiguousarray(table.reshape(-1)))
        slopes = None if tangent is None else mi.Float(np.ascontiguousarray(tangent.reshape(-1)))
        for j, name in enumerate(self._names):
            at = row * width + 3 * j
            value = mi.Color3f(*(dr.gather(mi.Float, flat, at + c) for c in range(3)))
            if slopes is not None:
                dr.enable_grad(value)
                dr.set_grad(value, mi.Color3f(*(dr.gather(mi.Float, slopes, at + c) for c in range(3))))
            self._set(name, value)
        self._plain.update()
        si = dr.zeros(mi.SurfaceInteraction3f, n * m)
        si.wi = dr.gather(mi.Vector3f, directions[0], column)
        wo = dr.gather(mi.Vector3f, directions[1], column)
        out = self._bsdf.eval(mi.BSDFContext(), si, wo, True)
        if slopes is None:
            return np.array(out)
        slope = dr.forward_to(out)
        out = dr.detach(out)
        dr.eval(out, slope)
        return np.array(out), np.array(slope)

    def _set(self, name: str, value: Any) -> None:
        if name in self._textures:
            self._textures[name].value = value
        else:
            self._plain[name] = value if name in self._colours else value.x


@lru_cache(maxsize=4)
def _lane_plugin(variant: str) -> str:
    """Register the lane texture for a variant; its plugin's name."""
    mi = backend.mitsuba(colour="rgb")

    class LaneTexture(mi.Texture):  # type: ignore[name-defined, misc]
        """A texture with one colour per lane of the wavefront, wherever the surface is hit."""

        def __init__(self, props: Any) -> None:
            mi.Texture.__init__(self, props)
            self.value = mi.Color3f(0.5)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self.value

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return self.value.x

        def eval_3(self, si: Any, active: Any = True) -> Any:
            return self.value

        def mean(self) -> Any:
            return mi.Float(0.5)

        def is_spatially_varying(self) -> bool:
            return False

        def to_string(self) -> str:
            return "LaneTexture"

    mi.register_texture("manifold_lane", LaneTexture)
    return "manifold_lane"
