"""Makes a material of a colour and a gloss: a rough dielectric coat over a Lambertian base.

A colour and a gloss do not determine a BRDF; most materials for which both are measured are paints, plastics and
prints. To change the gloss of a measured material, its coat is replaced, and the base below stays as it is.
"""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from manifold import __version__
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughDielectric
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.plausibility import Plausibility
from manifold.brdf.wrapper import WrappedBRDF
from manifold.colour import panel
from manifold.colour.ball_colours import Picture
from manifold.colour.conversion import luminance
from manifold.colour.difference import delta_e_2000_lab
from manifold.core import disk
from manifold.core.defaults import TINY
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.metrics import EXPECTED_BALL, Errors
from manifold.core.progress import Stages
from manifold.core.records import Array, Bands
from manifold.core.results import Result, derived, entry
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.attributes import (
    COLOUR_TOLERANCE,
    GLOSS_TOLERANCE,
    LEAST_GLOSS,
    factor_of,
    factor_of_colour,
    lab_of,
    lab_of_factor,
    readings_of_colour,
)
from manifold.estimate.completion import Completion
from manifold.estimate.completions import NextStep, atoms_of, colour_under_d65, draw_ball
from manifold.estimate.expected import CALIBRATION_VERSION, Calibration, cached, errors_of, typical
from manifold.estimate.gloss import gloss_meter, gloss_units
from manifold.estimate.inputs import safe_name
from manifold.estimate.suggestions import Suggested, directions_left, suggest
from manifold.formats import column_heads
from manifold.formats.column_heads import gloss_angle
from manifold.formats.readings import DAYLIGHT, GLOSS_ANGLES_DEG, GlossUnits, Viewing, gloss_fault
from manifold.formats.text import CORRECT_CELL, data_lines, decode, list_rows, number, with_whole_name
from manifold.formats.values import lightness_doubts
from manifold.library.store import Library
from manifold.model.decoding import integrating_sphere
from manifold.model.output_file import COMPLETION_OPTIONS, OutputOptions, require_bsdf_output, write_checked

_INDEX = 1.5  # refractive index of most varnishes and plastics
_INDEX_SPREAD = 0.3  # its standard deviation, which lets gloss of several angles decide
_INDICES, _ALPHAS = (1.05, 1.8), (0.01, 1.0)
_STARTS = (0.015, 0.03, 0.06, 0.12, 0.24, 0.5)  # roughness alpha at the start
_EVALUATIONS = 15
_ROUNDING = 0.02  # difference of log gloss that weighs as much as `COLOUR_TOLERANCE` in CIELAB


class DoubtfulColoursWarning(UserWarning):
    """A list of colours probably has another scale."""


@dataclass(frozen=True)
class ColourSample:
    """A measured colour and gloss.

    Attributes:
        lab: CIELAB in the geometry 45/0, under D65 and to the 2 degree observer.
        gloss: gloss units by angle in degrees.
    """

    name: str
    lab: tuple[float, float, float]
    gloss: GlossUnits

    def made_of(self) -> dict[str, Any]:
        """Return everything that the content depends on, as plain values."""
        return {"lab": list(self.lab), "gloss": {f"{angle:g}": units for angle, units in self.gloss.items()}}


@dataclass(frozen=True, eq=False)
class Coated(Result):
    """A coat over a Lambertian base that was written to a file.

    Attributes:
        sample: the requested colour and gloss.
        alpha, index: roughness and refractive index of the coat.
        lab: CIELAB colour of the written file, shape (3,).
        gloss: gloss units of the written file by angle in degrees.
        expected: expected errors, as colour and gloss do not determine the BRDF; the ball error includes the colour
            difference if the colour is not reached.
        plausibility: physical plausibility of the written file.
        suggested: the readings to take next; None if none were requested.
        diagnostics: sentences that a user should read.
    """

    path: Path = field(metadata=entry())
    sample: ColourSample = field(metadata=entry(json=lambda result: result.sample.name))
    alpha: float = field(
        metadata=entry(
            row="material",
            words=lambda result: (
                f"a dielectric coat (alpha {result.alpha:.3g}, index {result.index:.3g}) over a diffuse base"
            ),
        )
    )
    index: float = field(metadata=entry())
    lab: Array = field(
        metadata=entry(
            row="colour", json=lambda result: {"asked": result.sample.lab, "written": result.lab},
            words=lambda result: f"L,a,b {', '.join(f'{v:.1f}' for v in result.lab)} ({DAYLIGHT}, 45/0), "
            f"CIEDE2000 {result.ciede2000:.1f} from the requested one",
        )
    )  # fmt: skip
    gloss: GlossUnits = field(
        metadata=entry(
            row="gloss",
            words=lambda result: [
                f"{result.gloss[angle]:.3g} at {angle:g} degrees, {units:g} requested"
                for angle, units in result.sample.gloss.items()
            ],
            json=lambda result: {
                f"{angle:g}": {"asked": result.sample.gloss.get(angle), "written": units}
                for angle, units in result.gloss.items()
            },
        )
    )
    expected: Errors[float] = field(
        metadata=entry(
            row="expected error",
            words=lambda result: (*result.missed_in_words, *result.expected.words),
            columns={EXPECTED_BALL: ("ball",)},
        )
    )
    plausibility: Plausibility = field(metadata=entry(row="albedo", words="at most {.max_albedo:.2f}"))
    suggested: Suggested | None

    @property
    @derived()
    def suggested_deg(self) -> Array | None:
        """Angles of the next readings to take, in degrees."""
        return None if self.suggested is None else self.suggested.angles_deg

    diagnostics: tuple[str, ...] = field(metadata=entry())
    seconds: float = field(metadata=entry())

    @property
    def next_step(self) -> NextStep:
        """What to do next: a coat has no readings that could be in doubt."""
        return NextStep.EXPORT

    @property
    def missed_in_words(self) -> list[str]:
        """Return texts about the colour and the gloss values that were not reached.

        Expected errors do not cover the gloss.
        """
        off = [f"the colour, by CIEDE2000 {self.ciede2000:.1f} (D65)"] * (self.ciede2000 > COLOUR_TOLERANCE)
        off += [
            f"gloss at {angle:g} degrees ({self.gloss[angle]:.3g} instead of {asked:.3g})"
            for angle, asked in missed_gloss(self.sample, self.gloss).items()
        ]
        return [f"missed: {', '.join(off)}"] if off else []

    @property
    @derived()
    def ciede2000(self) -> float:
        """CIEDE2000 between the requested and the written colour."""
        return float(delta_e_2000_lab(np.array(self.sample.lab), self.lab))


def coat_of(lab: Array, gloss: GlossUnits, bands: Bands) -> tuple[Plastic, float]:
    """Return the coat over a Lambertian base that is nearest to a colour and to gloss units by angle, and its alpha.

    The colour is CIELAB (3,) at 45/0 under D65. The refractive index stays near 1.5 unless the gloss requires
    another.
    """
    target = factor_of_colour(lab, bands)

    def off(coat: Plastic) -> Array:
        reached = np.array(list(gloss_units(coat, gloss).values()))
        return np.append(gloss_misfits(reached, gloss), (lab_of(coat) - lab) / COLOUR_TOLERANCE)

    return nearest_coat(lambda surface: target - surface, bands, off)


def gloss_misfits(units: Array, wanted: GlossUnits) -> Array:
    """Return the logarithmic differences from the requested gloss units (G,), divided by the tolerance."""
    logs = [np.log(np.maximum(some, LEAST_GLOSS)) for some in (units, list(wanted.values()))]
    return np.asarray((logs[0] - logs[1]) / _ROUNDING)


def nearest_coat(
    below: Callable[[Array], Array], bands: Bands, off: Callable[[Plastic], Array], index: float = _INDEX
) -> tuple[Plastic, float]:
    """Find the coat over a Lambertian base that minimises the sum of squared residuals; return it with its alpha.

    Args:
        below: function of the surface's share of the reflectance factor at 45/0, (B,), that returns the share that
            the base must contribute, (B,). The base's reflectance is limited to 0 to 1.
        bands: bands of the coat.
        off: function that returns the residuals (n,) of a coat.
        index: refractive index near which the index of the coat stays.
    """

    def coat(x: Array) -> Plastic:
        bare = Plastic(GGX.isotropic(float(np.exp(x[0]))), np.array(x[1]), np.zeros(bands.count), bands)
        white = Plastic(bare.ggx, bare.eta, np.ones(bands.count), bands)
        of_coat, of_base = factor_of(bare), factor_of(white)
        return Plastic(bare.ggx, bare.eta, np.clip(below(of_coat) / (of_base - of_coat), 0.0, 1.0), bands)

    def residuals(x: Array) -> Array:
        return np.append(off(coat(x)), (x[1] - index) / _INDEX_SPREAD)

    low, high = np.array([np.log(_ALPHAS[0]), _INDICES[0]]), np.array([np.log(_ALPHAS[1]), _INDICES[1]])
    starts = [np.array([np.log(alpha), index]) for alpha in _STARTS]
    start = np.clip(min(starts, key=lambda x: float(np.sum(residuals(x) ** 2))), low + 1e-6, high - 1e-6)
    best = least_squares(residuals, start, bounds=(low, high), x_scale=[0.3, 0.1], max_nfev=_EVALUATIONS).x
    return coat(best), float(np.exp(best[0]))


def complete(
    library: Path,
    sample: ColourSample,
    output: Path,
    *,
    picture: Path | None = None,
    count: int = 0,
    instrument: str | None = None,
    options: OutputOptions = COMPLETION_OPTIONS,
) -> Coated:
    """Write an RGL file of a coat over a Lambertian base with a colour and gloss; the material is named after the file.

    Args:
        library: library whose bands the file has, and on whose materials the expected error is measured.
        sample: the colour and gloss.
        output: the `.bsdf` file to write.
        picture: file for a picture of the ball; None renders none.
        count: number of directions to suggest for the next readings.
        instrument: instrument whose directions are suggested; None allows any direction.
        options: options of the file.
    """
    start = time.perf_counter()
    require_bsdf_output(output)
    for angle, units in sample.gloss.items():
        if (fault := gloss_fault(angle, units)) is not None:
            raise UsageError(fault)
    stages = Stages({"reading materials": 4, "expected error": 2, "writing": 1, "rendering": 2})
    opened = Library(library)
    readings = readings_of_colour(np.array(sample.lab), sample.gloss, opened.bands)
    if count:
        directions_left(count, readings, instrument)
    stages.begin("reading materials")
    atoms = atoms_of(opened)
    coat, alpha = coat_of(np.array(sample.lab), sample.gloss, atoms.bands)
    stages.begin("expected error")
    expected = expected_errors(atoms, tuple(sample.gloss), opened)
    stages.begin("writing")
    index = float(np.mean(coat.eta))
    written = write_checked(
        output, coat, options,
        description=f"A dielectric coat (alpha {alpha:.3g}, index {index:.3g}) over a Lambertian, of the "
        f"colour and gloss of {sample.name}, by manifold {__version__}",
        remedy="ask for a darker colour or less gloss", keeps_hue=True, expected_error=expected.cube_root,
    )  # fmt: skip
    if picture is not None:
        stages.begin("rendering")
        draw_ball(output, picture)
    brdf = coat if written.file is None else MeasuredBRDF(written.file)
    lab, gloss = lab_of(brdf), gloss_units(brdf, GLOSS_ANGLES_DEG)
    off = float(delta_e_2000_lab(np.array(sample.lab), lab))
    if off > COLOUR_TOLERANCE:
        expected = expected.beside(Errors(ball=off))
    # The mixtures that explain colour and gloss differ most where the next readings decide between them.
    suggested = suggest(atoms, count, Completion.of(atoms, readings), instrument) if count else None
    return Coated(
        output, sample, alpha, index, lab, gloss, expected, written.plausibility, suggested,
        (*_missed(sample, lab, gloss), *written.notes),
        time.perf_counter() - start,
    )  # fmt: skip


def missed_gloss(sample: ColourSample, gloss: GlossUnits) -> dict[float, float]:
    """Return the requested gloss units that a file's gloss did not reach, by angle in degrees."""
    return {
        angle: asked
        for angle, asked in sample.gloss.items()
        if abs(gloss[angle] - asked) > GLOSS_TOLERANCE * asked
    }


def _missed(sample: ColourSample, lab: Array, gloss: GlossUnits) -> list[str]:
    """Return sentences on the values that were not reached."""
    missed = missed_gloss(sample, gloss)
    is_more = [gloss[angle] > asked for angle, asked in missed.items()]
    if any(is_more) and len(sample.gloss) > 1:
        why = "these gloss values contradict each other: no coat has all of them"
    elif any(is_more):
        why = "every coat of this colour has more; --mixture searches the library's materials"
    else:
        why = (
            "dielectric coats of this colour have less, metals may have more; --mixture searches the library's "
            "materials"
        )
    notes = [
        f"gloss at {angle:g} degrees: {gloss[angle]:.3g} reached, {asked:.3g} requested; {why}"
        for angle, asked in missed.items()
    ]
    difference = float(delta_e_2000_lab(np.array(sample.lab), lab))
    if difference > COLOUR_TOLERANCE:
        reached = ", ".join(f"{v:.1f}" for v in lab)
        notes.append(
            f"colour: L,a,b {reached} reached, CIEDE2000 {difference:.1f} ({DAYLIGHT}, 45/0) from the "
            "requested one; the "
            "coat's own light or the base's largest reflectance, 1, does not allow it"
        )
    return notes


def expected_errors(atoms: LibraryAtoms, angles_deg: tuple[float, ...], library: Library) -> Errors[float]:
    """Return the expected errors of a coat: errors of coats with the colour and gloss of a library's materials.

    They are cached in the library.
    """
    axes = (CALIBRATION_VERSION, library.content_hash, atoms.names, angles_deg)
    key = hashlib.sha256(f"coats {axes}".encode()).hexdigest()
    return cached(library, key, lambda: _calibrated(atoms, angles_deg)).errors.over(typical)


def _calibrated(atoms: LibraryAtoms, angles_deg: tuple[float, ...]) -> Calibration:
    bands, grid, lights = atoms.band_axis, atoms.grid, panel.judged()

    def method(m: int) -> tuple[Errors[float], Errors[float], float]:
        material = atoms.materials[m]
        coat, _ = coat_of(lab_of(material), gloss_units(material, angles_deg), bands)
        on_grid, on_ball = (coat.eval(pairs.wi, pairs.wo) for pairs in (grid, lights))
        return errors_of(atoms, m, on_grid, on_ball), Errors(), 0.0

    return Calibration.leave_out(method, range(len(atoms.names)))


_EXPECTED = "expected name, L, a, b, such as red,50,60,40, or a header that names the columns"


def read_colours(path: Path, gloss: GlossUnits, viewing: Viewing | None = None) -> list[ColourSample]:
    """Read the colours of a text or CSV file with lines `[name] L a b`.

    A header may order the columns (`name`, `L`, `a`, `b`), name the light and observer (`L* (D50/2)`, also allowed in
    a comment), and add columns of gloss (`gloss_60`).

    Args:
        path: the file.
        gloss: gloss units by angle in degrees, for all samples without a gloss column.
        viewing: light and observer of a file that names none; None means D65/2.

    Raises:
        FileFormatError: a line is not a colour, or a name occurs twice.
        UsageError: the header, or a comment, names another light or observer than `viewing`.
    """
    text = decode(disk.read_bytes(path, advice="name a text of lines of name, L, a, b", most=disk.MOST_TEXT))
    lines = text.split("\n")
    rows = list_rows(data_lines(lines, marks=("#",)))
    if not rows:
        raise FileFormatError(f"{path}: no colours, {_EXPECTED}")
    head = rows.pop(0)[1] if not any(number(cell) is not None for cell in rows[0][1]) else None
    width = 4 if head is None else len(head)
    comments = [line for line in lines if line.lstrip().startswith("#")]
    axes, seen = _lab_of_header(path, head, column_heads.viewing_of_lines(comments), viewing)
    names = {"sample": 0} if head is None else column_heads.name_columns(head)
    samples: dict[str, ColourSample] = {}
    for n, given in rows:
        cells = with_whole_name(given, width)
        if head is None and len(cells) == 3:
            cells = ["", *cells]
        if len(cells) != width or (head is None and number(cells[0]) is not None):
            raise FileFormatError(f"{path}, line {n}: found '{' '.join(given)[:40]}', {_EXPECTED}")
        (called,) = column_heads.sample_names([{what: cells[k] for what, k in names.items()}], f"colour_{n}")
        name = safe_name(called)
        if name in samples:
            raise FileFormatError(f"{path}, line {n}: the name '{name}' occurs twice, expected each once")
        own = {
            angle: _number(path, n, cells[k]) for k, h in enumerate(head or ()) if (angle := gloss_angle(h))
        }
        for angle, units in own.items():
            if (fault := gloss_fault(angle, units)) is not None:
                raise FileFormatError(f"{path}, line {n}: {fault}")
        try:
            lab = colour_under_d65(np.array([_number(path, n, cells[k]) for k in axes]), seen)
        except UsageError as error:
            raise FileFormatError(f"{path}, line {n}: {error}") from None
        samples[name] = ColourSample(name, (float(lab[0]), float(lab[1]), float(lab[2])), {**gloss, **own})
    if not samples:
        raise FileFormatError(f"{path}: no colours below the header, {_EXPECTED}")
    for doubt in lightness_doubts(max(sample.lab[0] for sample in samples.values())):
        warnings.warn(f"{path}: {doubt}", DoubtfulColoursWarning, stacklevel=2)
    return list(samples.values())


def _lab_of_header(
    path: Path, head: list[str] | None, commented: Viewing | None, viewing: Viewing | None
) -> tuple[list[int], Viewing]:
    """Return the columns of L, a and b, and the light and observer of these values."""
    columns = ([1, 2, 3], None) if head is None else column_heads.lab_columns(head, viewing)
    if columns is None:
        raise FileFormatError(f"{path}: found the header {', '.join(head or ())[:60]}, {_EXPECTED}")
    axes, said = columns[0], columns[1] or commented
    if said is not None and viewing is not None and said != viewing:
        raise UsageError(
            f"{path}: the file says {said}, the options say {viewing}; leave --illuminant and --observer out"
        )
    return axes, said or viewing or DAYLIGHT


def _number(path: Path, line: int, cell: str) -> float:
    value = number(cell)
    if value is None:
        raise FileFormatError(f"{path}, line {line}: found '{cell[:24]}', expected a number; {CORRECT_CELL}")
    return value


class RecoatedBRDF(WrappedBRDF):
    """A BRDF whose coat is replaced by another, see `exchanged`."""

    def __init__(self, brdf: BRDF, old: Plastic, new: Plastic, strength: Array, tint: Array | float = 1.0):
        """Exchange coats over a Lambertian; the highlight is `strength` (B,) times the old coat's.

        `tint` (B,) multiplies the highlight.
        """
        super().__init__(brdf)
        self._old, self._new, self._strength, self._tint = old, new, strength, tint

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B)."""
        f = np.maximum(self._brdf.eval(wi, wo), 0.0)
        parts = [_parts(coat, wi, wo) for coat in (self._old, self._new)]
        most = _most_strength(self._new, wi, wo, self._strength)
        above, share = _highlight(f, parts[0], parts[1][0], most)
        return np.asarray(self._tint * above + share * parts[1][1])


def _most_strength(coat: Plastic, wi: Array, wo: Array, strength: Array) -> Array:
    """Limit how many times the coat's highlight is multiplied: no facet reflects more than all light, (..., B)."""
    cosines = np.sqrt(np.maximum(0.5 + 0.5 * np.sum(wi * wo, axis=-1), 0.0))  # from the half vector
    facets = coat.boundary.reflectance(cosines.ravel())
    return np.minimum(strength, 1.0 / np.maximum(facets, TINY).reshape(*cosines.shape, -1))


def _parts(coat: Plastic, wi: Array, wo: Array) -> tuple[Array, Array]:
    """Return the light reflected by the surface of a coat, and the light from below it, in 1/sr, each (..., B)."""
    surface = coat.boundary.eval(wi, wo)
    return surface, coat.eval(wi, wo) - surface


def exchanged(f: Array, old: tuple[Array, Array], new: tuple[Array, Array], strength: Array) -> Array:
    """Return the values f >= 0 of a material whose old coat is replaced by a new one, in 1/sr, shape (..., B).

    The part of f that the old coat's base explains is scaled by the ratio of the two bases. The rest, the highlight,
    is replaced by the new coat's highlight, multiplied by the ratio of the material's highlight to the old coat's, up
    to `strength` (..., B) >= 1; the highlight of a metal therefore stays coloured. For coats see `_parts`.
    """
    above, share = _highlight(f, old, new[0], strength)
    return np.asarray(above + share * new[1])


def _highlight(
    f: Array, old: tuple[Array, Array], new_surface: Array, strength: Array
) -> tuple[Array, Array]:
    """Return the highlight of values f (..., B) under a new surface, and the share of the old base in them."""
    surface, base = old
    rest = f - np.minimum(f, base)
    ratio = rest / np.maximum(surface, TINY)
    ratio = np.where(new_surface > surface, np.clip(ratio, 1.0, strength), ratio)
    share = np.minimum(f / np.maximum(base, TINY), 1.0)
    return rest + ratio * (new_surface - surface), share


def with_gloss(brdf: BRDF, gloss: GlossUnits) -> RecoatedBRDF:
    """Return a material with another coat, which gives it other gloss units (> 0) by angle in degrees.

    Its colour at 45/0 changes only if the light of the new coat, or a base that reflects all light, does not allow it.
    The coat that is replaced is the coat over a Lambertian base with the material's gloss at 20, 60 and 85 degrees.
    """
    bands, meters = brdf.bands, [gloss_meter(angle) for angle in gloss]
    old, _ = coat_of(lab_of(brdf), gloss_units(brdf, GLOSS_ANGLES_DEG), bands)
    values = [(np.maximum(values_at(brdf, m), 0.0), _parts(old, m.wi, m.wo)) for m in meters]
    highlights = [
        m.of(np.maximum(f - base, 0.0))[0] / m.of(surface)[0]
        for m, (f, (surface, base)) in zip(meters, values, strict=True)
    ]
    strength = np.maximum(np.mean(highlights, axis=0), 1.0)
    colour, factor, of_old = lab_of(brdf), factor_of(brdf), _factors(old)

    def off(new: Plastic) -> Array:
        made = [
            float(m.of(luminance(exchanged(f, parts, _parts(new, m.wi, m.wo), most), bands))[0])
            for m, (f, parts) in zip(meters, values, strict=True)
            for most in [_most_strength(new, m.wi, m.wo, strength)]
        ]
        seen = lab_of_factor(exchanged(factor, of_old, _factors(new), strength), bands)
        return np.append(gloss_misfits(np.array(made), gloss), (seen - colour) / COLOUR_TOLERANCE)

    def below(surface: Array) -> Array:
        """Keep the colour: replace the light that the new surface's highlight lacks."""
        above, share = _highlight(factor, of_old, surface, strength)
        return (factor - above) / np.maximum(share, TINY)

    new, _ = nearest_coat(below, bands, off, float(np.mean(old.eta)))
    return RecoatedBRDF(brdf, old, new, strength)


def with_factor(brdf: BRDF, factor: Array, meter: Picture) -> RecoatedBRDF:
    """Return a material with another reflectance factor (B,), as `meter` measures it, and the same surface.

    The base below the coat changes. The highlight changes only if it reflects more light than any dielectric coat, as
    the coloured highlight of a metal does.
    """
    bands = brdf.bands
    old, _ = coat_of(lab_of(brdf), gloss_units(brdf, GLOSS_ANGLES_DEG), bands)
    sphere = integrating_sphere()
    (f, of_old), (inside, (_, base)) = (
        (np.maximum(values_at(brdf, m), 0.0), _parts(old, m.wi, m.wo)) for m in (meter, sphere)
    )
    surface = RoughDielectric(old.ggx, np.array(_INDICES[1]), bands).eval(sphere.wi, sphere.wo)
    light = sphere.light
    of_coat = np.minimum(light @ surface / np.maximum(light @ np.maximum(inside - base, 0.0), TINY), 1.0)
    tint = of_coat + (1.0 - of_coat) * factor / np.maximum(meter.of(f)[0], TINY)
    white = Plastic(old.ggx, old.eta, np.ones(bands.count), bands)
    above, share = _highlight(f, of_old, of_old[0], np.ones(bands.count))
    of_white = meter.of(share * _parts(white, meter.wi, meter.wo)[1])[0]
    base = (factor - meter.of(tint * above)[0]) / np.maximum(of_white, TINY)
    new = Plastic(old.ggx, old.eta, np.clip(base, 0.0, 1.0), bands)
    return RecoatedBRDF(brdf, old, new, np.ones(bands.count), tint)


def _factors(coat: Plastic) -> tuple[Array, Array]:
    surface = factor_of(coat.boundary)
    return surface, factor_of(coat) - surface
