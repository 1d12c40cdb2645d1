"""Merging of two instruments' readings of one sample: a goniometer, corrected to a spectrophotometer.

A colour correction is learned at the directions that both instruments read, and applied to all readings of the
goniometer. For these directions its values are interpolated in half and difference angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import QhullError

from manifold.colour.correction import ColourCorrection, learn_correction
from manifold.directions import to_rusinkiewicz
from manifold.errors import BandMismatchError, UsageError
from manifold.formats.readings import Readings
from manifold.records import Array, Bands

_CAMERA_BANDS = 3
_MOST = 2000  # readings of a goniometer that are used
_ONE_SAMPLE = (
    0.2  # error of a correction; in the corpus always less for one sample, and more for 4 in 5 pairs of two
)
_SIMPLEX = 4  # points needed to interpolate in three coordinates


@dataclass(frozen=True, eq=False)
class InstrumentCorrection:
    """A correction from the three bands of an instrument to the bands of another.

    Attributes:
        colours: the correction of values.
        source: the bands that are corrected.
        target: the bands of the reference.
    """

    colours: ColourCorrection
    source: Bands
    target: Bands


@dataclass(frozen=True, eq=False)
class Hybrid:
    """Readings of two instruments, corrected.

    Attributes:
        readings: of both, in the bands of the reference.
        correction: that was learned; None where bands were the same.
        shared: number of directions that both read.
    """

    readings: Readings
    correction: ColourCorrection | None
    shared: int


def shared_values(reference: Readings, other: Readings) -> tuple[Array, Array]:
    """Values of another instrument (S, 3) and of the reference (S, B) where both read a sample.

    Raises:
        BandMismatchError: the other instrument has not three bands.
    """
    if other.values.shape[1] != _CAMERA_BANDS:
        raise BandMismatchError(
            f"{other.name}: {other.bands}, expected three bands, to be corrected by the {reference.bands} of "
            f"{reference.name}; give the spectrophotometer's file first"
        )
    at_reference = interpolated(other, reference.wi, reference.wo)
    is_shared = np.isfinite(at_reference).all(axis=1) & reference.measured.all(axis=1)
    return at_reference[is_shared], reference.values[is_shared]


def learn_across(pairs: Sequence[tuple[Readings, Readings]]) -> InstrumentCorrection:
    """The correction of an instrument by another, from samples that both read.

    Args:
        pairs: of every sample the reference's readings and the other's, all in the same bands.
    Raises:
        BandMismatchError: bands differ between samples, or the other instrument has not three.
        UsageError: too few directions are shared.
    """
    for reference, other in pairs[1:]:
        for one, first in ((reference, pairs[0][0]), (other, pairs[0][1])):
            first.bands.require_same(
                one.bands, one.name, "calibrate from readings of the same two instruments"
            )
    values = [shared_values(*pair) for pair in pairs]
    groups = np.repeat(np.arange(len(pairs)), [len(x) for x, _ in values])
    learned = learn_correction(
        np.vstack([x for x, _ in values]), np.vstack([y for _, y in values]),
        groups=groups if len(pairs) > 1 else None,
    )  # fmt: skip
    return InstrumentCorrection(learned, pairs[0][1].bands, pairs[0][0].bands)


def corrected(readings: Readings, correction: InstrumentCorrection) -> Readings:
    """Readings in the bands of the reference that a correction was learned from.

    Raises:
        BandMismatchError: they have other bands than those that are corrected.
    """
    correction.source.require_same(
        readings.bands, readings.name, "the colour correction was learned from another instrument's"
    )
    colours, nm = correction.colours, correction.target.wavelengths_nm
    known = readings.measured.all(axis=1)
    values = np.full((len(readings), colours.matrix.shape[1]), np.nan)
    values[known] = colours.apply(readings.values[known])
    beyond = 100.0 * float(np.mean(colours.is_beyond(readings.values[known]))) if known.any() else 0.0
    made = replace(readings, wavelengths_nm=None if nm is None else np.array(nm), values=values)
    note = f"colours corrected: {colours.form}"
    if beyond > 0.0:
        note += f"; {beyond:.0f} % of the readings are brighter than any it was learned at, corrected in proportion"
    return made.with_note(note)


def combine(reference: Readings, other: Readings) -> Hybrid:
    """One set of readings in the bands of `reference`.

    Args:
        reference: of a spectrophotometer, to whose colours the other is corrected.
        other: a goniometer's, in the same bands, or in three.
    Raises:
        BandMismatchError: it has other bands, and not three.
        UsageError: too few directions are shared.
    """
    if reference.bands == other.bands:
        return Hybrid(_joined(reference, other), None, 0)
    x, y = shared_values(reference, other)
    correction = learn_correction(x, y)
    taken = corrected(_evenly_chosen(other), InstrumentCorrection(correction, other.bands, reference.bands))
    error = correction.errors[correction.form]
    note = f"{other.instrument} corrected by {reference.instrument} at {len(x)} directions that both read"
    if np.isfinite(error):
        note += f", with a leave-one-out error of {100.0 * error:.0f} %"
    if error > _ONE_SAMPLE:
        note += f": do both files read one sample, {reference.name} and {other.name}?"
    return Hybrid(_joined(reference, taken).with_note(note), correction, len(x))


def interpolated(readings: Readings, wi: Array, wo: Array) -> Array:
    """Values of an isotropic sample interpolated at direction pairs (P, 3): (P, B), NaN outside its readings' hull."""
    known = readings.measured.all(axis=1)
    at, roots = _coordinates(readings.wi[known], readings.wo[known]), np.cbrt(readings.values[known])
    _, first = np.unique(at.round(4), axis=0, return_index=True)
    if len(first) < _SIMPLEX:
        return np.full((len(wi), readings.values.shape[1]), np.nan)
    try:
        found = LinearNDInterpolator(at[first], roots[first])(_coordinates(wi, wo))
    except QhullError as error:  # points in a plane
        raise UsageError(
            f"{readings.name}: its directions lie in one plane, expected several incidences to interpolate between"
        ) from error
    return np.asarray(found) ** 3


def _coordinates(wi: Array, wo: Array) -> Array:
    """Half and difference angles of an isotropic, reciprocal BRDF: `sqrt(theta_h)`, theta_d by phi_d; (P, 3)."""
    theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
    folded = np.abs(np.mod(phi_d + 0.5 * np.pi, np.pi) - 0.5 * np.pi)  # [0, pi / 2]
    return np.column_stack([np.sqrt(theta_h), theta_d * np.cos(folded), theta_d * np.sin(folded)])


def _evenly_chosen(readings: Readings) -> Readings:
    """At most `_MOST` readings, at even steps."""
    step = -(-len(readings) // _MOST)
    return readings.select_pairs(np.arange(0, len(readings), step)) if step > 1 else readings


def _joined(reference: Readings, other: Readings) -> Readings:
    """The readings of both, weighted so that those of the reference count at least as much as the other's together."""
    share = max(len(other) / len(reference), 1.0)
    return replace(
        reference,
        instrument=f"{reference.instrument} + {other.instrument}",
        wi=np.vstack([reference.wi, other.wi]),
        wo=np.vstack([reference.wo, other.wo]),
        values=np.vstack([reference.values, other.values]),
        weights=np.concatenate([reference.weights, other.weights / share]),
        notes=tuple(dict.fromkeys((*reference.notes, *other.notes))),
        gloss={**other.gloss, **reference.gloss},
    )
