"""Estimates the outline of a photographed ball and the lamps from its own highlights and shading.

The circle, the lamps, the gains and a shading function are fitted to the pixels together. Under a distant lamp and
camera, the BRDF of an isotropic, reciprocal material on a ball is a symmetric function of the cosines of lamp and
camera. The fitted shading is symmetric as well, so its errors do not bias the lamp towards the camera or away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import expit

from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.core.defaults import TINY
from manifold.core.errors import UsageError
from manifold.core.names import percent
from manifold.core.records import Array, Indices, Mask, evenly_spaced
from manifold.estimate.lamps import Lamp
from manifold.estimate.outlines import BRIGHT, Circle, Outline, Photograph, outlines_in
from manifold.estimate.pixel_mixtures import INDEPENDENT
from manifold.formats.readings import Assumption

_SIDES = (24, 48)  # pixels across a ball that are compared, to choose a start and to refine it
_RIM = 0.95  # share of the radius that is compared
_GRAZING = (
    0.5  # cosine of lamp or camera below which pixels count less: there materials are least like the shading
)
_LEAST_WEIGHT = 0.1  # of these pixels
_DARK = 0.02  # share of a picture's mean, to which errors of darker pixels are relative
_NOISE = 0.03  # error of cube roots, relative to the picture's largest, from which residuals count less
_LEAST_NOISE = 0.005  # of the smoothest materials
_ROBUST = 2.0  # residuals, in units of that, that count less than in proportion
_LARGEST_RESIDUAL = 0.12  # relative error of cube roots beyond which no lamp explains a picture
# Error of the shading model: on a real ball 0 against a mirror ball's lamps, 2.9 against stated ones.
_MODEL_DEG = 2.5
_TOGETHER = 12  # pictures that are fitted together; of more, some evenly spaced
_DOUBTED_DEG = 10.0  # least doubtful angle; lamps are found within 7 degrees in pictures of a matte ball
_WELL_EXPLAINED = 0.035  # largest residual of pictures that are explained well
_CLEARLY = 1.6  # least ratio of residuals of two encodings: at most 1.33 in triples of pictures that are sRGB
_CLEARLY_OF_FEW = 2.5  # the same of one or two pictures: at most 2.1 in single ones that are sRGB
# Ratio of these residuals at which both encodings are equally probable, and the power of it by which the odds change:
# a higher one trusts residuals more than angles.
_DOUBTFUL, _DOUBTFUL_POWER = 2.0, 4
_OF_ENCODING = 3  # pictures in which encodings are compared; of more, some evenly spaced

_Places = tuple[Array, Array, Array | float, Indices, Array]  # see `_Pixels._places`
_NODES = np.sqrt([0.0, 1.0, 2.5, 4.5, 7.0, 10.0, 13.0, 17.0, 22.0, 28.0, 35.0, 45.0, 58.0, 72.0, 90.0])
"""Square roots of angles of the half vector, in degrees, between which the logarithm of the highlight is linear."""
_SHAPE = 4  # numbers of the shading beside its highlight, see `_Pixels.shading`
_COMMON = 3 + _SHAPE + len(_NODES)  # parameters that all pictures share: outline, shape, highlight
_OWN = 4  # parameters of a picture: lamp (2), logarithms of its gain and of its highlight's strength
_SHAPE_SPREAD = (
    0.3  # standard deviations of the numbers of the shape, of steps of the highlight, of its strength
)
_STEP_SPREAD, _STRENGTH_SPREAD = 1.0, 0.3
_HIGHLIGHT, _HIGHLIGHT_SPREAD = -3.0, 3.0  # logarithm of the highlight at 90 degrees
_STEP = 1e-5  # of derivatives
_ITERATIONS, _SETTLED = 60, 1e-5  # the latter is a relative change of the cost

_OUTLINE, _TERMINATOR = 0.02, 0.1  # standard deviations of an outline, and of a possible terminator, in radii
_EDGE_SPAN = 0.05  # share of the radius within which edges are sought
_EDGE_RAYS, _EDGE_STEP = 240, 0.25  # rays, and step along them in pixels
_EDGE_SIDE, _EDGE_BLUR = 6, 6  # steps that are compared on either side, and those of the blur between them
_LIT_LIMB = 0.2  # least cosine between a ray and the lamp
_CONTRAST = 0.4  # least relative contrast of an edge
_BLACK = 0.003  # share of a picture's bright pixels that is as dark as none
_SHARPNESS = 4  # power of the ratio of values beside an edge and farther inside, by which it counts
_ALIKE_EDGES = 8.0  # neighbouring rays whose errors are alike
_EDGE_ERROR = 0.001  # error of all edges together, in radii
_ROUNDS = 10  # of robust least squares


@dataclass(frozen=True, eq=False)
class Probe:
    """The estimated light of photographs of one ball.

    Attributes:
        circle: the outline, the same in all photographs.
        gains: brightness of every photograph relative to the first.
        lamp_deg: standard deviation of every lamp's direction, in degrees, including the error of the shading model.
        circle_error: standard deviation of centre and radius, in radii.
        residual: relative cube-root residual of every photograph.
    """

    circle: Circle
    lamps: tuple[Lamp, ...]
    gains: tuple[float, ...]
    lamp_deg: tuple[float, ...]
    circle_error: float
    residual: tuple[float, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences about the estimated lamps and outline, with their uncertainties."""
        shown = "; ".join(
            f"{lamp} +- {off:.1f} degrees" for lamp, off in zip(self.lamps, self.lamp_deg, strict=True)
        )
        return (f"lamps found: {shown}; outline within {100.0 * self.circle_error:.1f} % of the radius",)


def find_light(
    photographs: Sequence[Photograph],
    circle: Circle | None = None,
    distance: float = np.inf,
) -> Probe:
    """Estimate the outline of a ball that did not move, and the single lamp of every photograph.

    All photographs have the same size. A given circle is refined. The lamps are `distance` radii from the ball's
    centre. Raises UsageError if no lamp explains a photograph.
    """
    sizes = {one.values.shape[:2] for one in photographs}
    if len(sizes) > 1:
        raise UsageError(
            "photographs of different sizes, expected one camera that stays where it is to find lamps; give the lamps"
        )
    outlines = outlines_in(photographs) if circle is None else [Outline(circle, 1.0)]
    factor = photographs[0].factor
    smaller = [one.reduced(factor) for one in photographs]
    chosen = evenly_spaced(len(smaller), _TOGETHER)
    some = [smaller[k] for k in chosen]
    tried = []
    for outline in outlines:
        deviation = _TERMINATOR if outline.notes else _OUTLINE
        tried.append((*_coarse_fit(some, outline.circle.scaled(1.0 / factor), distance), deviation))
    pixels, fit = _refined(some, *min(tried, key=lambda each: each[1].cost))
    if len(some) < len(smaller):
        pixels, fit = _with_others(_Pixels.of(smaller, pixels.circle, distance, _SIDES[1]), fit, chosen)
    found = pixels.probe(fit, photographs)
    return replace(found, circle=found.circle.scaled(factor))


def given_lamp_notes(photograph: Photograph, circle: Circle, lamp: Lamp) -> tuple[str, ...]:
    """Return a warning about a given lamp if the ball looks lit from elsewhere.

    There is no warning for near lamps, or for materials that are not a sum of a diffuse part and a highlight, because
    a single photograph does not determine their lamp.
    """
    if np.isfinite(lamp.distance):
        return ()
    try:
        seen = _coarse_probe(photograph, circle)
    except UsageError:
        return ()
    apart = seen.lamps[0].degrees_from(lamp)
    if apart <= max(_DOUBTED_DEG, 3.0 * seen.lamp_deg[0]):
        return ()
    return (
        f"{photograph.path.name}: the lamp was given at {lamp}, but the ball looks lit from {seen.lamps[0]}, "
        f"{apart:.0f} degrees away: check that it is the lamp of this picture, with x to the right, y up, z to the "
        "camera",
    )


def given_encoding_notes(
    photographs: Sequence[Photograph], circles: Sequence[Circle], lamps: Sequence[Lamp], *, are_given: bool
) -> tuple[str, ...]:
    """Return a warning if photographs seem to be encoded otherwise than they were read, given their far lamps.

    That is so if the other encoding is more probable by the angles between given and estimated lamps, and by the
    residuals. Given lamps are taken to be as uncertain as the shading model. Estimated circles are searched
    again, because the encoding moves them as well.
    """
    chosen = evenly_spaced(len(photographs), _OF_ENCODING).tolist()
    read = [photographs[k] for k in chosen]
    otherwise, deviation = _read_otherwise(read), np.hypot(_MODEL_DEG, _MODEL_DEG)
    if otherwise is None or any(np.isfinite(lamps[k].distance) for k in chosen):
        return ()
    try:
        probes = [_coarse_probe(one, circles[k]) for one, k in zip(read, chosen, strict=True)]
        off = [one.lamps[0].degrees_from(lamps[k]) for one, k in zip(probes, chosen, strict=True)]
        if np.median(off) < deviation:
            return ()
        apart, residual = [], []
        for pictures in (read, otherwise):
            probes = [
                find_light([one], circles[k] if are_given else None)
                for one, k in zip(pictures, chosen, strict=True)
            ]
            off = [one.lamps[0].degrees_from(lamps[k]) for one, k in zip(probes, chosen, strict=True)]
            apart.append(float(np.median(off)))
            residual.append(float(np.mean([one.residual[0] for one in probes])))
    except UsageError:
        return ()
    (far, near), (large, small) = apart, residual
    log_odds = 0.5 * (far**2 - near**2) / deviation**2 + _log_odds(large / max(small, TINY))
    if near > 2.0 * deviation or log_odds < 0.0:
        return ()
    return (
        _advice(
            read[0],
            f"the lamp that explains the ball best is {far:.0f} degrees away from the given one, with a residual of "
            f"{percent(large, 1)}",
            f"it is {near:.0f} degrees away, with {percent(small, 1)}",
        ),
    )


def doubt_encoding(photographs: Sequence[Photograph], probe: Probe) -> tuple[Probe, tuple[str, ...]]:
    """Return the probe and, if photographs seem to be read in the wrong encoding, a warning.

    The warning appears if one lamp explains the photographs well in the other encoding, and clearly better than the
    probe does. The uncertainty of the probe's lamps then includes the angle between both estimates. If the difference
    is less clear, there is no warning, and the uncertainty includes a share of this angle.
    """
    chosen = evenly_spaced(len(photographs), _OF_ENCODING).tolist()
    otherwise = _read_otherwise([photographs[k] for k in chosen])
    if otherwise is None:
        return probe, ()
    try:
        other = find_light(otherwise, probe.circle, probe.lamps[0].distance)
    except UsageError:
        return probe, ()
    small = float(np.mean(other.residual))
    residual = float(np.mean([probe.residual[k] for k in chosen]))
    between = [one.degrees_from(probe.lamps[k]) for one, k in zip(other.lamps, chosen, strict=True)]
    apart = [between[chosen.index(k)] if k in chosen else max(between) for k in range(len(photographs))]
    ratio = residual / max(small, TINY)
    least = _CLEARLY if len(chosen) >= _OF_ENCODING else _CLEARLY_OF_FEW
    is_clear = small <= _WELL_EXPLAINED and ratio >= least
    probability = 1.0 if is_clear else float(expit(_log_odds(ratio)))
    wider = np.hypot(probe.lamp_deg, np.sqrt(probability) * np.array(apart))
    probe = replace(probe, lamp_deg=tuple(wider.tolist()))
    if not is_clear:
        return probe, ()
    explained = f"one lamp explains the ball to {percent(residual, 1)}"
    return probe, (_advice(photographs[0], explained, f"to {percent(small, 1)}"),)


def _log_odds(ratio: float) -> float:
    """Return the logarithm of the odds of another encoding, by the ratio of the residual to that of the other one."""
    return _DOUBTFUL_POWER * float(np.log(max(ratio, TINY) / _DOUBTFUL))


def _read_otherwise(photographs: Sequence[Photograph]) -> list[Photograph] | None:
    """Return photographs with linear values encoded, or display values not decoded; None if that is not in doubt."""
    is_encoded = photographs[0].is_encoded
    if any(one.is_certain or one.is_encoded != is_encoded for one in photographs):
        return None
    if not is_encoded and max(float(np.nanmax(one.values, initial=0.0)) for one in photographs) > 1.0:
        return None
    change = encode_srgb if is_encoded else decode_srgb
    return [replace(one, values=change(one.values)) for one in photographs]


def _advice(photograph: Photograph, before: str, after: str) -> Assumption:
    """Return the advice to read photographs otherwise, which explains the ball better."""
    read, other, option = _encodings(photograph)
    return Assumption(
        f"the pictures were read as {read}, and {before}; read as {other}, {after}: if their values are {other}, add "
        f"{option}, else the lamps are wrong"
    )


def _encodings(photograph: Photograph) -> tuple[str, str, str]:
    """Return how a photograph was read, how else it may be read, and the option for that."""
    return ("sRGB", "linear", "--linear") if photograph.is_encoded else ("linear", "sRGB", "--encoded")


def _coarse_probe(photograph: Photograph, circle: Circle) -> Probe:
    """Return the estimated light of one photograph without its refinement. Raises UsageError as `find_light`."""
    factor = photograph.factor
    pixels, fit = _coarse_fit([photograph.reduced(factor)], circle.scaled(1.0 / factor), np.inf)
    return pixels.probe(fit, [photograph])


def _coarse_fit(photographs: Sequence[Photograph], circle: Circle, distance: float) -> tuple[_Pixels, _Fit]:
    """Return the better fit of two starts near an outline: the brightest pixels face the lamp, or mirror it."""
    pixels = _Pixels.of(photographs, circle, distance, _SIDES[0])
    return pixels, min(
        (pixels.fitted(pixels.start(lamps)) for lamps in pixels.lamps()), key=lambda fit: fit.cost
    )


def _refined(
    photographs: Sequence[Photograph], pixels: _Pixels, fit: _Fit, deviation: float
) -> tuple[_Pixels, _Fit]:
    """Return a fit with more pixels, and with the edges of the ball where the lamps light it.

    The outline from which the first fit started has a standard deviation, in radii.
    """
    outline = pixels.circle
    for side in _SIDES:
        circle, lamps = pixels.outline(fit), _directions(pixels.slopes(fit.x))
        circle, information = edges_on_limb(photographs, circle, lamps, outline, deviation)
        noise = max(float(pixels.residual(fit).max()), _LEAST_NOISE)
        pixels = _Pixels.of(photographs, circle, pixels.distance, side)
        pixels = replace(pixels, information=information, noise=noise)
        fit = pixels.fitted(np.concatenate([np.zeros(3), fit.x[3:]]))
    return pixels, fit


def _with_others(pixels: _Pixels, fit: _Fit, chosen: Indices) -> tuple[_Pixels, _Fit]:
    """Return a fit of some pictures with lamp and gain of every other one, which share its outline and material."""
    P = len(pixels.roots)
    x, curvature = np.zeros(_COMMON + _OWN * P), np.zeros((_COMMON + _OWN * P, _COMMON + _OWN * P))
    own = np.append(np.arange(_COMMON), _COMMON + _OWN * chosen[:, None] + np.arange(_OWN))
    x[own], curvature[np.ix_(own, own)] = fit.x, fit.curvature
    for p in np.setdiff1d(np.arange(P), chosen).tolist():
        one = pixels.part(p)
        starts = [one.start(lamps) for lamps in one.lamps()]
        fits = [one.fitted(np.append(fit.x[:_COMMON], start[_COMMON:]), _COMMON) for start in starts]
        best = min(fits, key=lambda each: each.cost)
        at = _COMMON + _OWN * p + np.arange(_OWN)
        x[at], curvature[np.ix_(at, at)] = best.x[_COMMON:], best.curvature[_COMMON:, _COMMON:]
    return pixels, _Fit(x, fit.cost, curvature)


def edges_on_limb(
    photographs: Sequence[Photograph], circle: Circle, lamps: Array, outline: Circle, deviation: float
) -> tuple[Circle, Array]:
    """Refine a circle by the edges near it where lamps (P, 3) light the ball; return it and its information matrix.

    The information matrix (3, 3) is that of the centre (right, up) and the radius, in radii. An edge is where the
    value is midway between the values on its two sides. The prior is `outline`, with the standard deviation
    `deviation`.
    """
    before = (
        np.array([outline.x - circle.x, circle.y - outline.y, outline.radius - circle.radius]) / circle.radius
    )
    angle = 2.0 * np.pi * np.arange(_EDGE_RAYS) / _EDGE_RAYS
    span, n, blur = max(_EDGE_SPAN * circle.radius, 4.0), _EDGE_SIDE, _EDGE_BLUR
    radii = np.arange(circle.radius - span, circle.radius + span, _EDGE_STEP)
    terms, off, sharp = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0)]
    for one, lamp in zip(photographs, lamps, strict=True):
        lit = angle[lamp[0] * np.cos(angle) + lamp[1] * np.sin(angle) > _LIT_LIMB]
        right, up = np.cos(lit), np.sin(lit)
        grey = np.nan_to_num(one.values.mean(axis=2))
        at = [circle.y - 0.5 - radii[:, None] * up, circle.x - 0.5 + radii[:, None] * right]
        profile = map_coordinates(grey, at, order=1, cval=np.nan)  # NaN beside the picture
        sums = np.cumsum(np.vstack([np.zeros(len(lit)), profile]), axis=0)
        means = (sums[n:] - sums[:-n]) / n
        inner, outer = means[: -n - blur], means[n + blur :]
        black = _BLACK * float(np.quantile(grey, BRIGHT))
        contrast = np.nan_to_num(np.abs(inner - outer) / (np.abs(inner) + np.abs(outer) + black))
        best, ray = contrast.argmax(axis=0), np.arange(len(lit))
        near = np.arange(2 * n + blur)[:, None] + best
        above = profile[near, ray] - 0.5 * (inner + outer)[best, ray]
        crosses = np.sign(above[:-1]) != np.sign(above[1:])
        k = np.where(crosses, np.abs(np.arange(len(crosses)) - n - blur // 2)[:, None], 2 * n + blur).argmin(
            axis=0
        )
        low, high = above[k, ray], above[k + 1, ray]
        edge = radii[near[k, ray]] + _EDGE_STEP * low / np.where(low == high, 1.0, low - high)
        used = (contrast[best, ray] > _CONTRAST) & crosses.any(axis=0) & np.isfinite(edge)
        terms.append(np.stack([right, up, np.ones(len(lit))], axis=1)[used])
        off.append(edge[used] / circle.radius - 1.0)
        inside = profile[np.maximum(near[:n] - 2 * n, 0), ray].mean(axis=0)
        sharp.append(np.minimum(inner[best, ray] / np.maximum(inside, black), 1.0)[used] ** _SHARPNESS)
    A, y, counts = np.vstack(terms), np.concatenate(off), np.concatenate(sharp)
    pixel, alike = 1.0 / circle.radius, _ALIKE_EDGES
    weights, scale = counts, 0.5 * pixel
    shift: Array = np.zeros(3)
    for _ in range(_ROUNDS):
        information = A.T @ (A * weights[:, None]) / (alike * scale**2) + np.eye(3) / deviation**2
        pull = A.T @ (weights * y) / (alike * scale**2) + before / deviation**2
        shift = np.linalg.solve(information, pull)
        residual = np.abs(y - A @ shift)
        scale = max(1.5 * float(np.median(residual)) if len(y) else 0.0, 0.25 * pixel)
        weights = counts / (1.0 + (residual / scale) ** 2) ** 2
    covariance = np.linalg.inv(information) + _EDGE_ERROR**2 * np.eye(3)
    return _moved(circle, shift), np.linalg.inv(covariance)


def _moved(circle: Circle, shift: Array) -> Circle:
    """Move a circle right and up, and enlarge it, by shares of its radius."""
    right, up, more = (float(v) * circle.radius for v in shift)
    return Circle(circle.x + right, circle.y - up, circle.radius + more)


@dataclass(frozen=True, eq=False)
class _Fit:
    x: Array
    cost: float
    curvature: Array


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Grey pixels of P photographs that are compared, relative to the largest of each.

    Attributes:
        columns, rows: centres of the M pixels, shape (M,).
        roots: cube roots of the values, to which `dark` is added, shape (P, M).
        levels: the largest values, shape (P,).
        information: of centre and radius, in radii, shape (3, 3).
        noise: of cube roots.
    """

    circle: Circle
    distance: float
    columns: Array
    rows: Array
    roots: Array
    dark: Array
    is_clipped: Mask
    is_seen: Mask
    levels: Array
    information: Array
    noise: float = _NOISE

    @classmethod
    def of(cls, photographs: Sequence[Photograph], circle: Circle, distance: float, side: int) -> _Pixels:
        """Return evenly spaced pixels within the outline, each a mean over its neighbourhood."""
        step = max(2.0 * circle.radius / side, 1.0)
        across = np.arange(-circle.radius, circle.radius, step)
        x, y = (grid.ravel() for grid in np.meshgrid(across, across))
        inside = np.hypot(x, y) < _RIM * circle.radius
        height, width = photographs[0].values.shape[:2]
        j, i = (np.floor(v).astype(int) for v in (circle.x + x[inside], circle.y + y[inside]))
        in_picture = (j >= 0) & (j < width) & (i >= 0) & (i < height)
        j, i = j[in_picture], i[in_picture]
        values, clipped, seen, levels = [], [], [], []
        for one in photographs:
            grey = one.values.mean(axis=2)
            is_seen = np.isfinite(grey)
            grey = np.where(is_seen, np.maximum(grey, 0.0), 0.0)
            if step > 1.5:
                grey = gaussian_filter(grey, 0.4 * step)
            level = float(np.quantile(grey[i, j], BRIGHT)) if len(i) else 0.0
            if not level > 0.0:
                raise UsageError(f"{one.path}: the ball at {circle} is black, expected a lamp")
            levels.append(level)
            values.append(grey[i, j] / level)
            clipped.append(one.is_clipped[i, j].any(axis=1))
            seen.append(is_seen[i, j])
        relative = np.array(values)
        dark = _DARK * relative.mean(axis=1, keepdims=True)
        return cls(
            circle, distance, j + 0.5, i + 0.5, np.cbrt(relative + dark), dark, np.array(clipped), np.array(seen),
            np.array(levels), np.eye(3) / _OUTLINE**2,
        )  # fmt: skip

    def part(self, p: int) -> _Pixels:
        """Return the pixels of one photograph."""
        own = slice(p, p + 1)
        return replace(
            self, roots=self.roots[own], dark=self.dark[own], is_clipped=self.is_clipped[own],
            is_seen=self.is_seen[own], levels=self.levels[own],
        )  # fmt: skip

    def lamps(self) -> list[Array]:
        """Return directions of the lamps (P, 3), in two versions.

        They take the brightest pixels as a highlight, or as facing the lamp.
        """
        n = self._normals(np.zeros(3))
        roots = np.where(self.is_seen, self.roots, 0.0)
        bright = np.array([np.mean(n[row >= np.quantile(row, BRIGHT)], axis=0) for row in roots])
        bright /= np.linalg.norm(bright, axis=1, keepdims=True)
        mirrored = 2.0 * bright[:, 2:] * bright - [0.0, 0.0, 1.0]
        return [mirrored, bright]

    def _normals(self, shift: Array) -> Array:
        """Return normals (M, 3) of a far camera's pixels for an outline moved and grown by shares of its radius."""
        circle = _moved(self.circle, shift)
        x, y = (self.columns - circle.x) / circle.radius, (circle.y - self.rows) / circle.radius
        r = np.maximum(np.hypot(x, y), 1.0)
        x, y = x / r, y / r
        return np.stack([x, y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=1)

    def outline(self, fit: _Fit) -> Circle:
        """Return the outline of a fit."""
        return _moved(self.circle, fit.x[:3])

    def slopes(self, x: Array) -> Array:
        """Return parameters of the lamps, shape (P, 2)."""
        return x[_COMMON:].reshape(-1, _OWN)[:, :2]

    def _cosines(self, x: Array) -> tuple[Array, Array, Array, Array | float]:
        """Return cosines of the lamp, the camera and the half vector, and the lamp's falloff, each (P, M)."""
        n, lamps = self._normals(x[:3]), _directions(self.slopes(x))
        towards, falloff = np.broadcast_to(lamps[:, None], (len(lamps), len(n), 3)), 1.0
        if np.isfinite(self.distance):
            away = self.distance * lamps[:, None] - n
            length = np.linalg.norm(away, axis=2, keepdims=True)
            towards, falloff = away / length, (self.distance / length[..., 0]) ** 2
        half = towards + np.array([0.0, 0.0, 1.0])
        half /= np.maximum(np.linalg.norm(half, axis=2, keepdims=True), 1e-9)
        lit = np.maximum(np.sum(towards * n, axis=2), 0.0)
        return lit, np.broadcast_to(n[:, 2], lit.shape), np.clip(np.sum(half * n, axis=2), 0.0, 1.0), falloff

    def _places(self, x: Array) -> _Places:
        """Return what outline and lamps determine: cosines of lamp and camera, falloff, and nodes of the highlight.

        The logarithm of the highlight is interpolated: nodes are the index of the one before a pixel, and the share of
        the one after it. Each has shape (P, M).
        """
        lit, seen, half, falloff = self._cosines(x)
        place = np.sqrt(np.rad2deg(np.arccos(half)))
        k = np.clip(np.searchsorted(_NODES, place) - 1, 0, len(_NODES) - 2)
        return lit, seen, falloff, k, (place - _NODES[k]) / (_NODES[k + 1] - _NODES[k])

    def shading(self, x: Array, places: _Places | None = None) -> tuple[Array, Array]:
        """Return light of the diffuse part and of the highlight, each (P, M), at the places of these parameters.

        The diffuse part is Minnaert's `(l v)^k / v`, l and v being the cosines of lamp and camera, times a polynomial's
        exponential; the highlight is a function of the half vector over a power of `l v`. Source: Minnaert 1941.
        """
        lit, seen, falloff, k, share = self._places(x) if places is None else places
        shape, nodes = x[3 : 3 + _SHAPE], x[3 + _SHAPE : _COMMON]
        _, _, gain, strength = np.clip(x[_COMMON:].reshape(-1, _OWN, 1), -20.0, 20.0).transpose(1, 0, 2)
        both = np.maximum(lit, 1e-4) * np.maximum(seen, 0.03)
        flat = np.exp(np.clip(shape[0], -2.0, 2.0)) - 1.0
        limb = shape[1] * ((1.0 - lit) ** 2 + (1.0 - seen) ** 2) + shape[2] * (1.0 - lit) * (1.0 - seen)
        power = 1.0 / (1.0 + np.exp(np.clip(shape[3], -5.0, 5.0)))
        light = lit * falloff * np.exp(gain)
        log = (1.0 - share) * nodes[k] + share * nodes[k + 1]
        highlight = light * np.exp(np.clip(log + strength, -20.0, 20.0)) * both**-power
        return light * both**flat * np.exp(np.clip(limb, -5.0, 5.0)), highlight

    def start(self, lamps: Array) -> Array:
        """Return the first parameters of a fit for lamps in directions (P, 3)."""
        highlight = _HIGHLIGHT + np.linspace(3.0, 0.0, len(_NODES))
        own = np.hstack([_slopes(lamps), np.zeros((len(lamps), 2))])
        return np.concatenate([np.zeros(3 + _SHAPE), highlight, own.ravel()])

    def fitted(self, x: Array, fixed: int = 0) -> _Fit:
        """Fit from some parameters, of which the first ones are fixed."""
        for _ in range(2):  # the second with the weights of the first
            lit, seen, _, _ = self._cosines(x)
            weights = np.minimum(lit / _GRAZING, 1.0) * np.minimum(seen / _GRAZING, 1.0)
            fit = self._descended(x, np.sqrt(np.maximum(weights, _LEAST_WEIGHT)), fixed)
            x = fit.x
        return fit

    def _descended(self, x: Array, weights: Array, fixed: int) -> _Fit:
        """Minimise squared residuals by the method of Levenberg and Marquardt."""
        residual, J = self._linearised(x, weights)
        damping, cost = 1e-2, float(residual @ residual)
        for _ in range(_ITERATIONS):
            H, g = J[:, fixed:].T @ J[:, fixed:], J[:, fixed:].T @ residual
            y = x.copy()
            y[fixed:] -= np.linalg.solve(H + damping * np.diag(np.diagonal(H) + 1e-9), g)
            there = self._linearised(y, weights)
            lower = float(there[0] @ there[0])
            if not lower < cost:
                damping *= 8.0
                if damping > 1e6:
                    break
                continue
            is_settled = lower > (1.0 - _SETTLED) * cost
            x, (residual, J), cost, damping = y, there, lower, max(damping / 5.0, 1e-7)
            if is_settled:
                break
        return _Fit(x, cost, J.T @ J)

    def _linearised(self, x: Array, weights: Array) -> tuple[Array, Array]:
        """Return robust residuals of pixels and those of the prior, and their derivatives."""
        places = self._places(x)
        *_, node, share = places
        diffuse, highlight = self.shading(x, places)
        value = diffuse + highlight
        root = np.cbrt(value + self.dark)
        (P, M), n = value.shape, len(x)
        D = np.zeros((P, M, n))
        for k in range(3 + _SHAPE):
            D[..., k] = (self._light(_stepped(x, [k]), None if k < 3 else places) - value) / _STEP
        of_nodes = D[..., 3 + _SHAPE : _COMMON]
        np.put_along_axis(of_nodes, node[..., None], (highlight * (1.0 - share))[..., None], 2)
        np.put_along_axis(of_nodes, node[..., None] + 1, (highlight * share)[..., None], 2)
        every = np.arange(P)
        for k in range(2):
            at = _COMMON + _OWN * every + k
            D[every, :, at] = (self._light(_stepped(x, at)) - value) / _STEP
        D[every, :, _COMMON + _OWN * every + 2] = value
        D[every, :, _COMMON + _OWN * every + 3] = highlight
        scale = np.sqrt(INDEPENDENT / M) / self.noise * weights * self._counts(root)
        off = scale * (root - self.roots)
        least = _ROBUST * np.sqrt(INDEPENDENT / M)
        stretch = np.sqrt(1.0 + (off / least) ** 2)
        robust = np.sign(off) * least * np.sqrt(2.0 * (stretch - 1.0))
        slope = np.where(robust == 0.0, 1.0, off / (stretch * np.where(robust == 0.0, 1.0, robust)))
        D *= (scale * slope / (3.0 * root**2))[..., None]
        before, of_before = self._before(x)
        residual = np.concatenate([robust.ravel(), before])
        return residual, np.vstack([D.reshape(P * M, n), of_before])

    def _light(self, x: Array, places: _Places | None = None) -> Array:
        diffuse, highlight = self.shading(x, places)
        return diffuse + highlight

    def _counts(self, root: Array) -> Array:
        """Return which pixels count: observed ones, and clipped ones where the prediction is darker."""
        return np.asarray(self.is_seen & ~(self.is_clipped & (root > self.roots)))

    def _before(self, x: Array) -> tuple[Array, Array]:
        """Return residuals of the prior of the parameters, and their derivatives."""
        n, J = len(x), len(_NODES)
        rows = np.zeros((3 + _SHAPE + J + 3 * ((n - _COMMON) // _OWN), n))
        target = np.zeros(len(rows))
        rows[:3, :3] = np.linalg.cholesky(self.information).T
        rows[3 : 3 + _SHAPE, 3 : 3 + _SHAPE] = np.eye(_SHAPE) / _SHAPE_SPREAD
        first = 3 + _SHAPE
        rows[first : first + J - 1, first:_COMMON] = np.diff(np.eye(J), axis=0) / _STEP_SPREAD
        rows[first + J - 1, _COMMON - 1] = 1.0 / _HIGHLIGHT_SPREAD
        target[first + J - 1] = _HIGHLIGHT / _HIGHLIGHT_SPREAD
        own = np.arange(_COMMON, n).reshape(-1, _OWN)
        for p, (_, _, gain, strength) in enumerate(own):
            rows[first + J + 3 * p, strength] = 1.0 / _STRENGTH_SPREAD
            rows[first + J + 3 * p + 1, gain] = 1e-2  # that of a black picture is not determined
        rows[-1, own[:, 3]] = 1.0 / _STRENGTH_SPREAD
        return rows @ x - target, rows

    def residual(self, fit: _Fit) -> Array:
        """Return the relative error of every photograph's cube roots, (P,)."""
        root = np.cbrt(self._light(fit.x) + self.dark)
        squares = np.sum((self._counts(root) * (root - self.roots)) ** 2, axis=1)
        return np.asarray(
            np.sqrt(squares / np.maximum(np.sum((self.roots * self.is_seen) ** 2, axis=1), 1e-12))
        )

    def probe(self, fit: _Fit, photographs: Sequence[Photograph]) -> Probe:
        """Return the estimate of a fit. Raises UsageError beyond the largest residual."""
        residual = self.residual(fit)
        names = [one.path.name for one in photographs]
        lost = [name for name, one in zip(names, residual, strict=True) if one > _LARGEST_RESIDUAL]
        if lost:
            doubted = next((one for one in photographs if not one.is_certain), None)
            hint = "" if doubted is None else "; add {2} if its values are {1}".format(*_encodings(doubted))
            raise UsageError(
                f"{', '.join(lost)}: no single lamp explains the ball (residual {percent(residual.max())}, expected at "
                f"most {percent(_LARGEST_RESIDUAL)}); give its --circle, or the lamp by --lamp X,Y,Z or the light "
                f"by --light{hint}"
            )
        covariance = np.linalg.pinv(fit.curvature)
        deviation = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        # A step of the parameters turns the lamp by about as much in radians: see `_directions`.
        degrees = np.hypot(np.rad2deg(np.hypot(*self.slopes(deviation).T)), _MODEL_DEG)
        gain, strength = fit.x[_COMMON:].reshape(-1, _OWN)[:, 2:].T
        diffuse, highlight = self.shading(fit.x)
        shine = highlight.sum(axis=1) / np.maximum((diffuse + highlight).sum(axis=1), np.finfo(float).tiny)
        gains = np.exp(gain + shine * strength) * self.levels
        lamps = tuple(Lamp(direction, self.distance) for direction in _directions(self.slopes(fit.x)))
        return Probe(
            self.outline(fit), lamps, tuple((gains / gains[0]).tolist()), tuple(degrees.tolist()),
            float(np.linalg.norm(deviation[:3])), tuple(residual.tolist()),
        )  # fmt: skip


def _stepped(x: Array, at: Sequence[int] | Indices) -> Array:
    """Return a copy of the parameters, some of which are increased by a step."""
    y = x.copy()
    y[at] += _STEP
    return y


def _directions(slopes: Array) -> Array:
    """Return unit vectors (P, 3) from the halves of their angles from the camera, stereographic: (P, 2)."""
    square = np.sum(slopes**2, axis=1, keepdims=True) / 4.0
    return np.hstack([slopes / (1.0 + square), (1.0 - square) / (1.0 + square)])


def _slopes(directions: Array) -> Array:
    return np.asarray(2.0 * directions[:, :2] / np.maximum(1.0 + directions[:, 2:], 1e-3))
