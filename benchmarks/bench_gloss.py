"""Glossy paints completed from 14 readings through a library without gloss, beside `principled` fitted to the same.

    python benchmarks/bench_gloss.py library.zarr

The paints are simulated: a rough dielectric of index 1.4 to 1.6, of one roughness or of two (haze), over a coloured
base. Materials of the library with more than 10 gloss units at 60 degrees are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from manifold.analytic.ggx import GGX, GGXMixture
from manifold.analytic.microfacet import Plastic
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import panel
from manifold.colour.conversion import to_srgb
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.metrics import cube_root_error, relative_error
from manifold.core.records import Array, Bands
from manifold.estimate import Completion, LibraryAtoms
from manifold.estimate.gloss import gloss_units
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import fit_bsdf
from manifold.formats.readings import Readings
from manifold.library.store import Library

MATT = 10.0  # gloss units at 60 degrees
NOISE = 0.02
DIRECTIONS_DEG = {
    "every 20 degrees": {20: (-60, -40, -20, 0, 20, 40, 60), 40: (-60, -40, -20, 0, 20, 40, 60)},
    "denser near the mirror direction": {20: (-30, 0, 10, 15, 20, 30, 60), 40: (-30, 0, 20, 35, 40, 50, 70)},
}
"""Outgoing elevations, positive on the side of the mirror direction, by incidence."""


def paints(count: int, rng: np.random.Generator) -> list[BRDF]:
    """Glossy paints, alpha from 0.02 to 0.2 in equal ratios; every second one has haze."""
    nm = np.arange(400.0, 701.0, 10.0)
    names = [name for name in diffuse_reflectance_names() if name.startswith(("tcs", "vs", "babel"))]
    made = []
    for k, alpha in enumerate(np.geomspace(0.02, 0.2, count)):
        base = to_srgb(diffuse_reflectance(str(rng.choice(names)), nm)[None], Bands(tuple(nm)))[0]
        haze = float(rng.uniform(0.1, 0.4))
        ggx = GGXMixture([(1.0 - haze, alpha), (haze, 3.0 * alpha)]) if k % 2 else GGX.isotropic(alpha)
        made.append(Plastic(ggx, rng.uniform(1.4, 1.6, 1), np.clip(base, 0.0, 1.0), Bands(None)))
    return made


def pairs(angles_deg: dict[int, tuple[int, ...]]) -> tuple[Array, Array]:
    """Direction pairs in the plane of incidence, shape (P, 3) each."""
    theta = np.deg2rad([(i, o) for i, outgoing in angles_deg.items() for o in outgoing])
    return from_spherical(theta[:, 0], np.pi), from_spherical(theta[:, 1], 0.0)


def errors(truth: BRDF, made: BRDF, atoms: LibraryAtoms) -> tuple[float, float, float]:
    """Cube-root, linear and ball error."""
    grid, lights = atoms.grid, panel.judged()
    f, made_f = truth.eval(grid.wi, grid.wo), made.eval(grid.wi, grid.wo)
    lit, made_lit = (brdf.eval(lights.wi, lights.wo) for brdf in (truth, made))
    on_ball = lights.errors(lit, made_lit, Bands(None)).ball
    return cube_root_error(f, made_f, grid.cosines), relative_error(f, made_f, grid.cosines), on_ball


def principled(read: Readings) -> BRDF:
    """Mitsuba's principled BSDF fitted to readings."""
    fitted = fit_bsdf(FitSamples.from_arrays(read.wi, read.wo, read.values, bands=read.bands))
    return fitted.brdf


def main() -> None:
    """Print what was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path, help="of RGB materials")
    parser.add_argument("--paints", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-principled", action="store_true")
    given = parser.parse_args()
    library = Library.open(given.library)
    atoms = LibraryAtoms.of_library(library)
    for name in library.names:
        if gloss_units(MeasuredBRDF(library.read(name)), [60])[60] > MATT:
            atoms = atoms.without(atoms.names.index(name))
    print(f"{len(library.names)} materials, {len(library.names) - len(atoms.names)} with gloss left out")
    for title, angles in DIRECTIONS_DEG.items():
        rng = np.random.default_rng(given.seed)
        wi, wo = pairs(angles)
        found: dict[str, list[tuple[float, float, float]]] = {"completion": [], "principled": []}
        for k, paint in enumerate(paints(given.paints, rng)):
            values = paint.eval(wi, wo) * (1.0 + NOISE * rng.standard_normal((len(wi), 1)))
            read = Readings(f"paint {k}", "simulated", wi, wo, None, values)
            found["completion"].append(errors(paint, Completion.of(atoms, read).brdf, atoms))
            if given.no_principled:
                continue
            try:
                found["principled"].append(errors(paint, principled(read), atoms))
            except UsageError as error:
                print(f"{read.name}: {error}")
        print(f"{len(wi)} readings, {title}; median / 90th percentile of cube root, linear, ball CIEDE2000")
        for method, of_paints in found.items():
            if of_paints:
                columns = np.array(of_paints).T
                print(
                    f"  {method}: "
                    + ", ".join(f"{np.median(c):.3f} / {np.percentile(c, 90):.3f}" for c in columns)
                )


if __name__ == "__main__":
    main()
