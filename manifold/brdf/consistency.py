"""Checks the values of an RGL file against each other, against other fields, and against physical limits.

The comparisons find values that were scaled, swapped or damaged; docs/explanation/rgl-files.md describes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from manifold.brdf.goniometer import WARP_NODES, node_normals, visible_normals
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import cells_of
from manifold.brdf.warp import interpolate
from manifold.colour.conversion import xyz_weights
from manifold.colour.reflectances import BEYOND_COLOURS, beyond_reflectances
from manifold.core.compiled import loops
from manifold.core.directions import HORIZON, from_spherical, u_to_phi, u_to_theta
from manifold.core.names import counted, first_few, percent
from manifold.core.records import Array, BsdfFile, Indices, Mask, evenly_spaced

# Limits, and in brackets what 20 measured files and the corpus reach.
_STEEPEST_DEG = 75.0  # nearer to the horizon, files hold little that was measured
_MOST_ALBEDO = 1.2  # 1, and room for calibration and fluorescence (1.02)
_MOST_ALBEDO_GRAZING = 1.5  # ... and for extrapolation (1.00)
MOST_NEGATIVE = 0.005
"""Largest share of negative values of a band or a prediction. Measured files have none; one in a hundred is visible."""

_MOST_DEPARTURE = 10.0  # of a value from the range of its neighbours, in widths of that range (6.6)
_MOST_STEP = 1.5  # factor between an albedo and both albedos beside it (1.08)
_MOST_NON_RECIPROCAL = 2.0  # factor, median over the pairs of an incidence (1.19)
_LUMINANCE_TOLERANCE = 0.01  # relative (0.0005)
_SPECTRAL_LUMINANCE_TOLERANCE = 0.1  # relative: the weights that the database sums spectra with are not known
_MOST_WARP_DIFFERENCE = (
    0.03  # total variation from the visible normals (0.005; files written here: 0.08 and more)
)
_MOST_AREA_RATIO = 1.25  # of `sigma` to the projected area of `ndf` (1.03; narrow anisotropic files: 1.12)
_QUADRATURE = 4  # polar angles of normals per node of `ndf`
_LEAST_AZIMUTHS = 64  # of normals; the `ndf` of an isotropic file has two
_AZIMUTHS = 17  # of views, at which anisotropic files are compared; the database has as many incident ones
_EVEN = 0.1  # relative: ratios that vary by less are one scale
_MOST_NODES = 1024  # per axis of `ndf` that the quadrature follows; the database has 128
_LEAST_EXPLAINED = 0.9  # least share of the cells of several slices that one change explains
_DARK = 0.01  # albedo, or stored value relative to the median
_BROAD_NM = 10.0  # bands this far apart may differ by any factor
_MOST_BANDS = 8  # in which reciprocity is measured
_MOST_SLICES = 4  # that a sentence names


class Cell(NamedTuple):
    """A stored value that disagrees with its neighbours, or with the luminance of its cell.

    Attributes:
        at: indices of the azimuth, polar angle, band, row and column.
        value: the stored value.
        expected: the value that the luminance implies, or the median of the neighbours.
        low, high: smallest and largest neighbour; NaN if there are fewer than three neighbours.
    """

    at: tuple[int, ...]
    value: float
    expected: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Consistency:
    """Statistics of the values of a file with P azimuths, T polar angles and B bands, and the faults found.

    Attributes:
        albedo: directional albedo, shape (P, T, B).
        reciprocity: median of f(wi, wo) / f(wo, wi) over the directions wo of an incidence, shape (P, T); NaN beyond
            75 degrees.
        negative_share: share of negative values, shape (P, T, B).
        cells: values that disagree with their neighbours, or with the luminance of their cell.
        findings: sentences that describe the faults; empty if the file is consistent.
    """

    albedo: Array
    reciprocity: Array
    negative_share: Array
    cells: tuple[Cell, ...]
    findings: tuple[str, ...]


def check_consistency(file: BsdfFile, *, has_exact_luminance: bool = True) -> Consistency:
    """Compare the values of a file with each other, with its other fields, and with physical limits.

    With `has_exact_luminance` False, the luminance is not compared; use this for materials of compact libraries,
    whose values and luminance are approximate.
    """
    filled: Mask = np.any(file.spectra != 0, axis=2)  # [P, T, H, W]
    negative_share = np.sum(file.spectra < 0, axis=(3, 4)) / np.maximum(filled.sum(axis=(2, 3)), 1)[..., None]
    luminance = _LuminanceComparison((), np.broadcast_to(np.nan, file.spectra.shape))
    if has_exact_luminance and file.jacobian and _has_warp_of_visible_normals(file):
        luminance = _compare_luminance(file)
    cells, mended = _disagreeing_cells(file, filled, luminance.implied)
    albedo, reciprocity = _measure(file, filled)
    # What is said of whole slices does not follow from what is said of their cells.
    rest = _measure(mended, filled) if cells else (albedo, reciprocity)
    findings = (
        *_of_normals(file),
        *luminance.findings,
        *_of_cells(file, cells),
        *_of_albedo(file, rest[0]),
        *(_of_colours(file, rest[0]) if file.bands.is_rgb else _of_bands(file, rest[0], negative_share)),
        *_of_incidences(file, rest[0].mean(axis=2), rest[1]),
    )
    return Consistency(albedo, reciprocity, negative_share, cells, findings)


def _measure(file: BsdfFile, filled: Mask) -> tuple[Array, Array]:
    """Return the albedo (P, T, B) at the incidences of a file, and reciprocity (P, T)."""
    brdf = MeasuredBRDF(file)
    elevations = np.minimum(file.theta_i_rad.astype(float), HORIZON)
    albedo = brdf.albedo(from_spherical(elevations, file.phi_i_rad[:, None]), resolution=32)
    return albedo, _reciprocity(file, brdf, filled)


def _reciprocity(file: BsdfFile, brdf: MeasuredBRDF, filled: Mask) -> Array:
    """Return the median of f(wi, wo) / f(wo, wi) over the filled cells of each slice, (P, T).

    Both polar angles of these cells are up to 75 degrees.
    """
    ratios = np.full(filled.shape[:2], np.nan)
    brdf = brdf.select_bands(list(evenly_spaced(file.bands.count, _MOST_BANDS)))
    least_cosine = np.cos(np.deg2rad(_STEEPEST_DEG))
    for p, t, cells in cells_of(file):
        if cells.wi[2] < least_cosine:
            continue
        wo = cells.wo[filled[p, t] & cells.is_above & (cells.wo[..., 2] > least_cosine)]
        f, exchanged = (brdf.eval(*pair).sum(axis=-1) for pair in ((cells.wi, wo), (wo, cells.wi)))
        bright = (f > 0.0) & (exchanged > 0.0)
        if np.any(bright):
            ratios[p, t] = np.exp(np.median(np.log(f[bright] / exchanged[bright])))
    return ratios


class _LuminanceComparison(NamedTuple):
    """A comparison of the luminance of cells with their values.

    Attributes:
        findings: about slices that disagree as a whole.
        implied: the value of each channel that agrees with the luminance and with the other two channels, in cells that
            disagree while their slice does not; NaN elsewhere, (P, T, B, H, W).
    """

    findings: tuple[str, ...]
    implied: Array


def _compare_luminance(file: BsdfFile) -> _LuminanceComparison:
    """Compare the values of a file whose warp is that of the visible normals with its `luminance`.

    In the database's RGB files, that is the luminance of `rgb` up to rounding. Spectral files may have it in another
    unit: each slice is compared with the others.
    """
    expected, is_rgb = file.luminance.astype(float), file.bands.is_rgb
    bright: Mask = expected > 0.1 * np.mean(expected, axis=(2, 3), keepdims=True)  # [P, T, H, W]
    unknown = np.broadcast_to(np.nan, file.spectra.shape)
    if not np.any(bright):
        return _LuminanceComparison((), unknown)
    weights = xyz_weights(file.bands)[:, 1]
    total = np.einsum("b,ptbhw->pthw", weights, file.spectra)
    if not is_rgb:
        expected *= np.median(total[bright] / expected[bright])
    agrees = _agree(total, expected, is_rgb)
    n_bright, n_agreeing = np.sum(bright, axis=(2, 3)), np.sum(agrees & bright, axis=(2, 3))
    is_changed: Mask = n_agreeing < 0.5 * n_bright  # [P, T]
    if not is_rgb and np.mean(is_changed) > 0.5:
        return _LuminanceComparison((), unknown)  # the file's luminance is not that under D65
    terms = weights[:, None, None] * file.spectra if is_rgb else total[:, :, None]
    parts = {f"values of {label}": terms[:, :, b] for b, label in enumerate(file.bands.labels) if is_rgb}
    findings, is_named = [], np.zeros_like(is_changed)
    single = (np.arange(is_changed.size).reshape(is_changed.shape) == k for k in np.flatnonzero(is_changed))
    for slices in (is_changed, *single):  # one change of all of them, else one of each
        slices = slices & ~is_named
        if not np.any(slices):
            continue
        change = _likeliest_change(
            {"values": total} | parts, total, expected, bright & slices[..., None, None]
        )
        if change.share < _LEAST_EXPLAINED and np.sum(slices) > 1:
            continue
        if change.share > 0.5:  # also in slices where it is too small to be seen
            slices |= (np.sum(change.agrees & bright, axis=(2, 3)) > n_agreeing) & ~is_named
        words = change.words if change.share > 0.5 else "values disagree with the field 'luminance'"
        findings.append(f"{words}, {_in_words(file, np.argwhere(slices))}")
        is_named |= slices
    if not is_rgb:
        return _LuminanceComparison(tuple(findings), unknown)
    others = terms[:, :, [1, 2, 0]] + terms[:, :, [2, 0, 1]]
    implied = (expected[:, :, None] - others) / weights[:, None, None]
    is_single = ~agrees & ~is_named[:, :, None, None]
    return _LuminanceComparison(tuple(findings), np.where(is_single[:, :, None], implied, np.nan))


class _Change(NamedTuple):
    """A factor on a part of some cells' luminance, the share of them that then agrees, and all that agree.

    The last is a mask (P, T, H, W).
    """

    words: str
    share: float
    agrees: Mask


def _likeliest_change(parts: dict[str, Array], total: Array, expected: Array, cells: Mask) -> _Change:
    """Return the change of one part of the luminance that explains the most cells (P, T, H, W)."""
    changes, is_rgb = [], len(parts) > 1
    for name, part in parts.items():
        rest = total - part
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = float(np.median((part / (expected - rest))[cells]))
            agrees = _agree(rest + part / factor, expected, is_rgb)
        words = f"{name} are {factor:.3g} times what the field 'luminance' implies"
        changes.append(_Change(words, float(np.mean(agrees[cells])), agrees))
    return max(changes, key=lambda change: change.share)


def _agree(total: Array, expected: Array, is_rgb: bool) -> Mask:
    """Return whether luminances of cells (P, T, H, W) agree within a tolerance and the noise of dark cells."""
    tolerance = _LUMINANCE_TOLERANCE if is_rgb else _SPECTRAL_LUMINANCE_TOLERANCE
    noise = 0.1 * tolerance * np.mean(np.abs(expected), axis=(2, 3), keepdims=True)
    largest = np.maximum(np.abs(total), np.abs(expected))
    return np.asarray(np.isfinite(total) & (np.abs(total - expected) <= tolerance * largest + noise))


def _has_warp_of_visible_normals(file: BsdfFile) -> bool:
    """Return whether `vndf` follows from `ndf`, as in measured files but not in files of this package."""
    nodes = file.ndf.shape[1]
    if file.vndf.shape[2:] != (nodes, nodes):
        return False
    normals = node_normals(nodes)
    for p, t in np.argwhere(_is_measured(file)):
        azimuth = 0.0 if file.is_isotropic else float(file.phi_i_rad[p])
        wi = from_spherical(float(file.theta_i_rad[t]), azimuth)
        expected, stored = visible_normals(file.ndf, normals @ wi), file.vndf[p, t].astype(float)
        if not np.any(expected):
            return False
        difference = np.abs(stored / stored.sum() - expected / expected.sum())
        if 0.5 * difference.sum() > _MOST_WARP_DIFFERENCE:
            return False
    return True


def _disagreeing_cells(file: BsdfFile, filled: Mask, implied: Array) -> tuple[tuple[Cell, ...], BsdfFile]:
    """Find values far from all their neighbours, and the likeliest value of each cell that disagrees.

    Return these cells, farthest first, and the file with values in their place that agree with the luminance.
    """
    disagreeing, spectra = [], file.spectra.copy(order="K")
    for p, t in np.argwhere(np.any(filled, axis=(2, 3))):
        values = file.spectra[p, t]
        floor = _DARK * float(np.median(np.abs(values[:, filled[p, t]])))  # the mean may be a damaged value
        low, high = _neighbour_range(values, filled[p, t])
        with np.errstate(over="ignore"):
            width = high - low + 0.1 * np.maximum(np.abs(low), np.abs(high)) + floor
            is_off: Mask = filled[p, t] & (np.maximum(values - high, low - values) > _MOST_DEPARTURE * width)
        for i, j in np.argwhere(np.isfinite(implied[p, t, 0])):
            around = _median_around(values, filled[p, t], i, j)
            is_off[_likeliest_channel(values[:, i, j], implied[p, t, :, i, j], around, floor), i, j] = True
        for b, i, j in np.argwhere(is_off):
            at = (int(p), int(t), int(b), int(i), int(j))
            expected = implied[at]
            if np.isnan(expected):
                expected = _median_around(values, filled[p, t], i, j)[b]
            numbers = (values[b, i, j], expected, low[b, i, j], high[b, i, j])
            disagreeing.append(Cell(at, *map(float, numbers)))
            spectra[at] = expected
    disagreeing.sort(key=lambda cell: -abs(cell.value - cell.expected))
    return tuple(disagreeing), replace(file, spectra=spectra)


def _likeliest_channel(values: Array, implied: Array, around: Array, floor: float) -> int:
    """Return the channel of a cell (3,) that moves closest to its neighbours if replaced by its implied value."""
    gain = np.abs(values - around) - np.abs(implied - around)
    return int(np.argmax(gain / (np.abs(around) + floor)))


def _median_around(values: Array, filled: Mask, i: int, j: int) -> Array:
    """Return the medians (B,) of the filled neighbours of a cell of values (B, H, W), else 0, as in empty cells."""
    near = np.s_[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
    is_neighbour = filled[near].copy()
    is_neighbour[min(i, 1), min(j, 1)] = False
    return (
        np.median(values[:, *near][:, is_neighbour], axis=1)
        if np.any(is_neighbour)
        else np.zeros(len(values))
    )


def _neighbour_range(values: Array, filled: Mask) -> tuple[Array, Array]:
    """Return the smallest and the largest filled neighbour of values (B, H, W); NaN for fewer than three."""
    H, W = filled.shape
    values, filled = np.pad(values, ((0, 0), (1, 1), (1, 1))), np.pad(filled, 1)
    for_low, for_high = np.where(filled, values, np.inf), np.where(filled, values, -np.inf)
    low, high = for_low[:, :H, :W].copy(), for_high[:, :H, :W].copy()
    count = np.zeros((H, W), dtype=int)
    for i, j in np.ndindex(3, 3):
        if (i, j) != (1, 1):
            near = np.s_[i : i + H, j : j + W]
            np.minimum(low, for_low[:, *near], out=low)
            np.maximum(high, for_high[:, *near], out=high)
            count += filled[near]
    few = count < 3
    low[:, few], high[:, few] = np.nan, np.nan
    return low, high


def _of_normals(file: BsdfFile) -> list[str]:
    """Return a sentence if `ndf` is zero everywhere, or if `sigma` is not the projected area of its normals."""
    if not file.jacobian:
        return []
    if not np.any(file.ndf):
        return ["the field 'ndf' is zero everywhere, and so is the BRDF"]
    x = np.linspace(0.0, 1.0, min(file.sigma.shape[1], WARP_NODES))
    y = np.array([0.0]) if file.is_isotropic else np.linspace(0.0, 1.0, _AZIMUTHS)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    area = _projected_area(file.ndf, from_spherical(u_to_theta(at[:, 0]), u_to_phi(at[:, 1])))
    with np.errstate(divide="ignore"):
        ratio = interpolate(file.sigma, at) / area
    worst = ratio[np.argmax(np.abs(np.log(ratio)))]
    if 1.0 / _MOST_AREA_RATIO <= worst <= _MOST_AREA_RATIO:
        return []
    where = "" if np.ptp(ratio) < _EVEN * worst else "up to " if worst > 1.0 else "down to "
    return [f"the field 'sigma' is {where}{worst:.3g} times the projected area that 'ndf' implies"]


def _projected_area(ndf: Array, w: Array) -> Array:
    """Return the projected area (K,) of the normals of a distribution (R, C) as seen from w (K, 3).

    Source: Dupuy & Jakob 2018, section 4; the midpoint rule on the unit square.
    """
    rows, columns = (min(count, _MOST_NODES) for count in ndf.shape)
    columns, rows = _QUADRATURE * (columns - 1), max(2 * rows, _LEAST_AZIMUTHS)
    x, y = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
    theta = u_to_theta(x)
    m = from_spherical(theta, u_to_phi(y)[:, None]).reshape(-1, 3)
    # d omega = sin(theta) d theta d phi, d theta = pi x dx and d phi = 2 pi dy
    measure = 2.0 * np.pi**2 * x * np.sin(theta) / (rows * columns)
    D = interpolate(ndf, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(rows, columns)
    area = np.empty(len(w))
    loops.project_facets(w, np.ascontiguousarray(m.T), (D * measure).reshape(-1), area)
    return area


def _of_cells(file: BsdfFile, cells: Sequence[Cell]) -> list[str]:
    """Return a sentence on values that disagree, with the farthest of them."""
    if not cells:
        return []
    p, t, b, row, column = cells[0].at
    where = f"{file.bands.labels[b]} {_in_words(file, np.array([(p, t)]))}, row {row}, column {column}"
    around = "" if np.isnan(cells[0].low) else f" (neighbours {cells[0].low:.3g} to {cells[0].high:.3g})"
    disagree = "disagrees" if len(cells) == 1 else "disagree"
    return [
        f"{counted(len(cells), 'stored value')} {disagree} with neighbours or with the field 'luminance', "
        f"farthest {where}: {cells[0].value:.3g}, expected {cells[0].expected:.3g}{around}"
    ]


def _of_albedo(file: BsdfFile, albedo: Array) -> list[str]:
    """Return a sentence if more light is reflected than arrives."""
    limits = np.where(_is_measured(file), _MOST_ALBEDO, _MOST_ALBEDO_GRAZING)
    is_off = albedo.max(axis=2) > limits
    if not np.any(is_off):
        return []
    p, t, b = np.unravel_index(int(np.argmax(np.where(is_off[..., None], albedo, 0.0))), albedo.shape)
    largest = f"{albedo[p, t, b]:.3g} in {file.bands.labels[b]} {_in_words(file, np.array([(p, t)]))}"
    return [f"albedo above 1 {_in_words(file, np.argwhere(is_off))}, up to {largest}"]


def _of_colours(file: BsdfFile, albedo: Array) -> list[str]:
    """Return a sentence if an albedo in RGB is a colour that no reflectance from 0 to 1 has."""
    beyond = beyond_reflectances(albedo)
    is_off = (beyond > BEYOND_COLOURS) & (np.linalg.norm(albedo, axis=2) > _DARK)
    if not np.any(is_off):
        return []
    worst = np.unravel_index(int(np.argmax(np.where(is_off, beyond, 0.0))), beyond.shape)
    colour = ", ".join(
        f"{label} {value:.3g}" for label, value in zip(file.bands.labels, albedo[worst], strict=True)
    )
    where = _in_words(file, np.argwhere(is_off))
    return [f"colours that no reflectance can have, such as an albedo of {colour}, {where}"]


def _of_bands(file: BsdfFile, albedo: Array, negative_share: Array) -> list[str]:
    """Return sentences on bands of a spectral file that are negative, or unlike the bands on both sides."""
    labels, sentences = file.bands.labels, []
    negative = negative_share.max(axis=(0, 1))
    if np.any(negative > MOST_NEGATIVE):
        named = [
            f"{percent(share)} at {labels[b]}" for b, share in enumerate(negative) if share > MOST_NEGATIVE
        ]
        sentences.append(f"negative values: {first_few(named, 3)}")
    nm = np.asarray(file.bands.wavelengths_nm)
    is_close = np.maximum(nm[1:-1] - nm[:-2], nm[2:] - nm[1:-1]) <= _BROAD_NM
    is_step = _is_step(albedo[..., :-2], albedo[..., 1:-1], albedo[..., 2:]) & is_close
    steps = np.flatnonzero(is_step.any(axis=(0, 1))) + 1
    if steps.size:
        named = []
        for b in steps:
            where = np.argwhere(is_step[..., b - 1])
            before, here, after = albedo[where[0, 0], where[0, 1], b - 1 : b + 2]
            named.append(
                f"{here:.3g} at {labels[b]} between {before:.3g} and {after:.3g}, {_in_words(file, where)}"
            )
        sentences.append(f"albedo differs from both neighbouring bands: {first_few(named, 3, '; ')}")
    return sentences


def _of_incidences(file: BsdfFile, albedo: Array, reciprocity: Array) -> list[str]:
    """Return sentences on incidences whose mean albedo (P, T) is unlike those on both sides, and on reciprocity."""
    sentences = []
    is_step = _is_step(albedo[:, :-2], albedo[:, 1:-1], albedo[:, 2:])
    for p, t in np.argwhere(is_step)[:3]:
        before, here, after = albedo[p, t : t + 3]
        where = _in_words(file, np.array([(p, t + 1)]))
        sentences.append(
            f"albedo of {here:.3g} {where}, between incidences with {before:.3g} and {after:.3g}"
        )
    distance = np.abs(np.log(np.where(np.isnan(reciprocity), 1.0, reciprocity)))
    if distance.max() > np.log(_MOST_NON_RECIPROCAL):
        worst = np.unravel_index(int(np.argmax(distance)), distance.shape)
        where = _in_words(file, np.array([worst]))
        sentences.append(
            f"not reciprocal: f(wi, wo) is {reciprocity[worst]:.2g} times f(wo, wi) {where} (median)"
        )
    return sentences


def _is_step(before: Array, here: Array, after: Array) -> Mask:
    """Return a mask of albedos far above or far below both neighbours; negative ones count as 0."""
    before, here, after = (np.maximum(albedo, 0.0) for albedo in (before, here, after))
    above = here > _MOST_STEP * np.maximum(before, after) + _DARK
    return np.asarray(above | (here < np.minimum(before, after) / _MOST_STEP - _DARK))


def _is_measured(file: BsdfFile) -> Mask:
    """Return whether slices are far enough from the horizon, (P, T)."""
    is_far = np.rad2deg(file.theta_i_rad) <= _STEEPEST_DEG
    return np.broadcast_to(is_far, file.spectra.shape[:2])


def _in_words(file: BsdfFile, slices: Indices) -> str:
    """Describe slices (p, t) by their incident directions."""
    if len(slices) == file.spectra.shape[0] * file.spectra.shape[1]:
        return "at all incidences"
    degrees, azimuths = np.rad2deg(file.theta_i_rad), np.rad2deg(file.phi_i_rad)
    words = [
        f"{degrees[t]:.1f}" + ("" if file.is_isotropic else f" (azimuth {azimuths[p]:.0f})")
        for p, t in slices
    ]
    return f"at {first_few(words, _MOST_SLICES)} degrees"
